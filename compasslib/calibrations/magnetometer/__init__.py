"""Calibration of a compass from the raw axes of its magnetometer: hard and soft iron, and their effect on the heading.

Le Menn et al. 2023, eqs. (1), (2) and section 6. An ellipsoid determines G^T G only: the rotation between magnetometer
and instrument is known as far as tilts and heading determine it. What the orientations do not determine is not fitted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import angles, compass
from compasslib.calibrations.curves import CIRCLE_DEG, count_sectors
from compasslib.calibrations.magnetometer import ellipsoid
from compasslib.calibrations.magnetometer import log as magnetometer_log
from compasslib.calibrations.magnetometer.ellipsoid import ModelChoice, ScaledReadings
from compasslib.calibrations.magnetometer.log import Axes, Log, about_down, level_heading, mean_and_scatter
from compasslib.calibrations.result import Calibration, DeviationTable, Source
from compasslib.deviation.series import series_design, series_deviation
from compasslib.errors import applicable
from compasslib.records import take
from compasslib.types import Bools, Floats

KIND = "magnetometer"
UNITS_NT = {"nt": 1.0, "ut": 1e3, "mg": 1e2, "g": 1e5, "gauss": 1e5}
MOST_SCALE_ERROR = 0.2  # beyond the gain errors of magnetometers (HMC5883L: 5 %) and the mean soft iron
NO_DIP = (
    "Hard and soft iron are determined, but their effect on the heading depends on the dip: log the tilts, or give "
    "latitude, longitude and date."
)
FOLDED = (
    "The iron is stronger than the earth's horizontal field: two correct headings give the same reading and no table "
    "can correct it; subtract hard_iron from the raw axes instead."
)
TURNS = ("forward", "starboard", "vertical")
OPEN_TURN = "an ellipsoid does not depend on how the sensor is turned; only tilts and a logged heading determine it"
TABLE_DEG = np.arange(0.0, 360.0, 10.0)


@dataclass(frozen=True)
class SolvedIron:
    """Iron with everything needed to compute headings: of all readings, then without one block of them each."""

    log: Log
    axes: Axes
    choice: ModelChoice
    irons: Floats  # (1 + blocks, 12) centre and G, for the scaled readings
    dip_ratios: Floats  # (1 + blocks,) downward over horizontal field; 0 on a level platform, NaN where unknown
    turned: Bools  # (3,) whether the turn from magnetometer to instrument about forward, starboard, down is determined
    logged_is_correct: bool = False  # whether the logged heading follows the corrected axes

    @property
    def iron(self) -> Floats:
        """Centre and G by all readings, (12,)."""
        return self.irons[0]

    @property
    def parts(self) -> list[Bools]:
        """Masks (n,) of the readings from which each of ``irons`` comes."""
        block = ellipsoid.blocks(len(self.choice.readings))
        return [block != k for k in range(-1, len(self.irons) - 1)]

    @property
    def headed(self) -> bool:
        """Whether headings can be computed: tilts were logged, or the platform is level."""
        return self.log.tilted or self.choice.level

    @cached_property
    def levelling(self) -> Floats:
        """Matrices from the body frame to the level frame, (n, 3, 3)."""
        return self.log.levelling()

    @property
    def down(self) -> Floats:
        """Downward direction in the body frame, (n, 3)."""
        return self.levelling[:, 2, :]

    @property
    def moved(self) -> Floats:
        """Iron changed by one standard deviation of the vertical hard iron, (12,), which a mean tilt does not show.

        It is assumed as strong as the horizontal iron.
        """
        if not (self.choice.level and self.log.tilted):
            return self.iron
        hard = float(np.hypot(*self.iron[:2]))
        return self.iron + np.append(hard * self.down[:, :2].mean(axis=0), np.zeros(10))

    def corrected(self) -> Floats:
        """Correct the readings for the iron: the normalized field, (n, 3)."""
        return ellipsoid.corrected(self.iron, self.choice.readings)

    def headings(self) -> tuple[Floats, Floats]:
        """Compute recorded and corrected headings, (n,) degrees each."""
        return level_heading(self.choice.readings.field, self.levelling), level_heading(
            self.corrected(), self.levelling
        )

    def moduli(self) -> tuple[Floats, Floats]:
        """Compute the modulus before and after the correction, (n,) each, of scaled readings."""
        down = self.choice.readings.down
        return ellipsoid.modulus(self.choice.readings.field, down), ellipsoid.modulus(self.corrected(), down)

    def gain(self, iron: Floats) -> float:
        """Compute the field's modulus in scaled readings: the mean diagonal of the observed axes."""
        soft = np.linalg.inv(iron[3:].reshape(3, 3))
        return float(np.mean(np.diag(soft)[: 2 if self.choice.level else 3]))

    def soft(self, iron: Floats) -> Floats:
        """Compute the soft iron relative to the mean diagonal of the observed axes, body frame, (3, 3)."""
        return np.linalg.inv(iron[3:].reshape(3, 3)) / self.gain(iron)


def calibrate(files: Sequence[str | Path], settings: Mapping[str, Any]) -> Calibration:
    """Calibrate a magnetometer from CSV files with x, y and perhaps z, pitch_deg, roll_deg, heading_deg, time_utc."""
    log = magnetometer_log.read(files, settings)
    choice: ModelChoice | str = magnetometer_log.unusable_reason(log)
    if not choice:
        axes, said = magnetometer_log.determine_axes(log)
        choice = ellipsoid.choose_model(log, log.raw @ axes.matrix.T)
    if isinstance(choice, ModelChoice) and (far := ellipsoid.find_outliers(choice)).any():
        log = log.take(~far, f"{far.sum()} of {far.size} readings are outliers of the fitted modulus and excluded.")
        choice = ellipsoid.choose_model(log, log.raw @ axes.matrix.T)
    if isinstance(choice, str):
        undetermined = [*ellipsoid.PARAMETERS]
        details = {"hard_iron": None, "soft_iron": None, "undetermined": undetermined, "left_out": log.left_out}
        return Calibration(KIND, "none", len(log.raw), 0, details=details, why=choice, warnings=log.warnings)
    solved = _solve_iron(log, axes, choice, settings.get("field"))
    exact = np.array([*map(exact_coefficients, solved.irons, solved.dip_ratios.tolist())])
    known = bool(np.isfinite(exact[0]).all())
    folded = known and not compass.turns_full_circle(exact[0])
    return Calibration(
        kind=KIND,
        model=choice.fitted.name,
        n=len(log.raw),
        coverage=count_sectors(solved.headings()[0]),
        points=_points(solved),
        details=_details(solved),
        why=FOLDED if folded else "" if known else NO_DIP,
        warnings=(*log.warnings, *said, *_strength_warnings(solved, settings), *_warnings(solved)),
        **(_correction(solved, exact, folded=folded) if known else {}),
    )


def _correction(solved: SolvedIron, all_exact: Floats, *, folded: bool) -> dict[str, Any]:
    """Compute coefficients, table and budget of the deviation by the iron; only the exact coefficients if folded."""
    exact, moved = all_exact[0], exact_coefficients(solved.moved, solved.dip_ratios[0])
    covariance = ellipsoid.covariance(all_exact[1:], moved - exact)
    correction: dict[str, Any] = {"exact": exact, "exact_covariance": covariance}
    if folded:
        return correction
    series, *each_series = (series_coefficients(each) for each in all_exact)
    value = exact_deviation(exact, TABLE_DEG)
    off = np.array([angles.difference(exact_deviation(each, TABLE_DEG), value) for each in (moved, *all_exact[1:])])
    table = DeviationTable(TABLE_DEG, value, ellipsoid.sigma(off[1:], off[0]))
    # Misfit of the series: over the readings, or around the circle if these have no headings.
    recorded, deviation = CIRCLE_DEG, exact_deviation(exact, CIRCLE_DEG)
    if solved.headed:
        recorded, corrected = solved.headings()
        deviation = angles.difference(corrected, recorded)
    return correction | {
        "coefficients": series,
        "covariance": ellipsoid.covariance(np.array(each_series), series_coefficients(moved) - series),
        "residual_rms_deg": angles.rms(deviation - series_deviation(series, recorded)),
        "sources": _sources(solved, table, series),
        "table": table,
    }


def _points(solved: SolvedIron) -> dict[str, Floats]:
    """Tabulate readings and corrected readings, (n,) each, in the file's unit and axes."""
    scale, log = solved.choice.scale, solved.log
    size, corrected = scale * solved.gain(solved.iron), solved.corrected() @ solved.axes.matrix
    before, after = solved.moduli()
    axes = "xyz" if log.has_z else "xy"
    columns = {name: log.raw[:, k] for k, name in enumerate(axes)}
    columns |= {f"{name}_corrected": size * corrected[:, k] for k, name in enumerate(axes)}
    columns |= {"modulus": scale * before, "modulus_corrected": size * after}
    if solved.headed:
        recorded, correct = solved.headings()
        columns |= {"recorded_deg": recorded, "corrected_deg": correct}
        columns["deviation_deg"] = angles.difference(correct, recorded)
    extra = {"pitch_deg": log.pitch_deg, "roll_deg": log.roll_deg, "logged_deg": log.heading_deg, "time_s": log.time_s}
    return columns | {name: values for name, values in extra.items() if values is not None}


def _details(solved: SolvedIron) -> dict[str, Any]:
    """Collect the details specific to a magnetometer, ready for JSON; null where undetermined."""
    choice, size, to_body = solved.choice, solved.choice.scale * solved.gain(solved.iron), solved.axes.matrix
    open_turns = [name for name, known in zip(TURNS, solved.turned, strict=True) if not known]
    undetermined = choice.undetermined | {f"turn about {name}": OPEN_TURN for name in open_turns}
    # Iron in the file's axes.
    shift = choice.scale * to_body.T @ (solved.moved - solved.iron)[:3]
    soft = np.array([to_body.T @ solved.soft(replicate) @ to_body for replicate in solved.irons[1:]])
    unknown = np.zeros(12, dtype=bool)
    for name in choice.undetermined:
        unknown[ellipsoid.ENTRIES[name]] = True
    null, of_soft = np.array(None), unknown[3:].reshape(3, 3)
    hard_sigma = ellipsoid.sigma(choice.scale * solved.irons[1:, :3] @ to_body, shift)
    moduli = dict(zip(("before", "after"), solved.moduli(), strict=True))
    return {
        "model": choice.fitted.name,
        "axes": solved.axes.text,
        "hard_iron": np.where(unknown[:3], null, choice.scale * to_body.T @ solved.iron[:3]).tolist(),
        "hard_iron_sigma": np.where(unknown[:3], null, hard_sigma).tolist(),
        "soft_iron": np.where(of_soft, null, to_body.T @ solved.soft(solved.iron) @ to_body).tolist(),
        "soft_iron_sigma": np.where(of_soft, null, ellipsoid.sigma(soft)).tolist(),
        "undetermined": list(undetermined),
        "undetermined_why": undetermined,
        "noise": size * choice.fitted.noise,
        "field_in_file_unit": size,
        "field_is": "horizontal" if choice.level else "total",
        "modulus_residual_percent": {when: float(100.0 * x.std() / x.mean()) for when, x in moduli.items()},
        "left_out": solved.log.left_out,
    }


def _strength_warnings(solved: SolvedIron, settings: Mapping[str, Any]) -> list[str]:
    """Compare the modulus with that of IGRF, if the header of x states a unit."""
    header, field = str((settings.get("columns") or {}).get("x", "")), settings.get("field")
    unit = header.rpartition("_")[2].lower()
    if unit not in UNITS_NT or field is None:
        return []
    level = solved.choice.level
    logged = solved.choice.scale * solved.gain(solved.iron) * UNITS_NT[unit]
    model = field["horizontal_nT"] if level else float(np.hypot(field["horizontal_nT"], field["vertical_nT"]))
    if abs(logged / model - 1.0) < MOST_SCALE_ERROR:
        return []
    what = "horizontal" if level else "total"
    return [f"The {what} field is {logged:.0f} nT by the log and {model:.0f} nT by IGRF: correct place, date or unit."]


def _warnings(solved: SolvedIron) -> list[str]:
    level, tilted = solved.choice.level, solved.log.tilted
    return applicable(
        {
            "The logged heading agrees with the corrected axes: it is taken as correct and gives the mounting, A.": (
                solved.logged_is_correct
            ),
            "A is zero by convention: a magnetometer does not observe how it is mounted about the vertical.": (
                not solved.logged_is_correct
            ),
            "No tilts: the readings are taken as level, and the correction is for a level instrument.": level
            and not tilted,
            "Hard iron in x and y includes what the vertical field induces there; it changes with the dip.": level,
            "Soft iron is not determined: hard iron and headings assume that there is none.": (
                "S11" in solved.choice.undetermined
            ),
            "No tilts are logged: a misalignment of the magnetometer is not detected.": not (level or tilted),
        }
    )


def _sources(solved: SolvedIron, table: DeviationTable, series: Floats) -> tuple[Source, ...]:
    horizontal = 1.0 / float(np.hypot(1.0, solved.dip_ratios[0]))
    off = table.deviation_deg - series_deviation(series, table.heading_deg)
    how = "block jackknife, with what a mean tilt hides of vertical iron, rms over the table"
    reading_deg = solved.choice.fitted.noise / horizontal / angles.DEGREE
    sources = [
        Source("fit", float(np.sqrt(np.mean(table.sigma_deg**2))), how),
        Source("series", angles.rms(off), "rms of the five terms about the exact deviation"),
        Source("one reading", reading_deg, "scatter of the modulus, one axis"),
    ]
    if solved.log.tilted:
        ratio = abs(solved.dip_ratios[0])
        if solved.choice.level:
            ratio = float(np.mean(np.abs(np.sum(solved.corrected() * solved.down, axis=1))))
        how = "0.40° expanded (Le Menn et al. 2023, section 2) times vertical over horizontal field"
        sources.append(Source("tilt sensor", 0.20 * ratio, how))
    if solved.log.tilted and solved.choice.level:
        tilt = float(np.sqrt(np.mean(np.var(solved.down[:, :2], axis=0))))
        hard = float(np.hypot(*solved.iron[:2]))
        how = "tilt about its mean times a vertical iron as strong as the horizontal one; the tilts do not determine it"
        sources.append(Source("vertical iron", hard * tilt / angles.DEGREE, how))
    return tuple(sources)


def exact_coefficients(iron: Floats, dip_ratio: float) -> Floats:
    """Compute A..E of the exact compass of a level instrument, (5,).

    ``dip_ratio`` is the downward over the horizontal field; 0 if the modulus is that of the horizontal field alone.
    """
    horizontal = 1.0 / np.hypot(1.0, dip_ratio)
    soft = np.linalg.inv(iron[3:].reshape(3, 3))
    return compass.level_coefficients(soft, iron[:3], horizontal_nT=horizontal, vertical_nT=dip_ratio * horizontal)


def exact_deviation(coefficients: Floats, recorded_deg: Floats) -> Floats:
    """Compute beta - gamma of an exact compass A..E (5,) at recorded headings, root of larger slope, (n,) degrees."""
    return angles.difference(compass.inverse(coefficients, recorded_deg)[:, 0], recorded_deg)


def series_coefficients(coefficients: Floats) -> Floats:
    """Fit A..E (5,), degrees, of the series in the recorded heading to an exact compass over the full circle."""
    return np.linalg.lstsq(series_design(CIRCLE_DEG), exact_deviation(coefficients, CIRCLE_DEG), rcond=None)[0]


# Iron in the frame of the instrument: the selected ellipsoid, rotated as far as tilts and logged heading determine.


def _solve_iron(log: Log, axes: Axes, choice: ModelChoice, field: Mapping[str, float] | None) -> SolvedIron:
    """Express the iron in the frame of the instrument; the earth's field gives the dip where there are no tilts."""
    irons = np.vstack([choice.fitted.iron, choice.fitted.replicates])
    dip = 0.0 if choice.level else np.nan if field is None else field["vertical_nT"] / field["horizontal_nT"]
    turned = np.array([False, False, axes.turned])
    solved = SolvedIron(log, axes, choice, irons, np.full(len(irons), dip), turned)
    if log.tilted and not choice.level:  # into the frame of the tilt sensor
        readings, down = choice.readings, solved.down
        each = [
            align_vertical(iron, take(readings, part), down[part])
            for iron, part in zip(irons, solved.parts, strict=True)
        ]
        known, dips, aligned = (np.array(column) for column in zip(*each, strict=True))
        solved = replace(solved, irons=aligned, dip_ratios=dips, turned=turned | known[0])
    return _align_to_heading(solved)


def align_vertical(iron: Floats, readings: ScaledReadings, down: Floats) -> tuple[Bools, float, Floats]:
    """Apply the small rotation from magnetometer to tilt sensor that makes the vertical field constant.

    With the downward direction t, the vertical field t . (h + e x h) is a constant c in every orientation, so
    t . h = c - e . (h x t) is linear in the rotation e about forward, starboard and down.

    The result is whether the tilts determine the turn about each axis, (3,); downward over horizontal field; and the
    iron with the rotation included in G.
    """
    from scipy.spatial.transform import Rotation  # imported late: only needed for logs with tilts

    field = ellipsoid.corrected(iron, readings)
    turn, wide = np.eye(3), np.zeros(3, dtype=bool)
    for _ in range(3):
        turned = field @ turn.T
        columns = np.column_stack([np.ones(len(field)), -np.cross(turned, down)])
        if not wide.any():
            values, vectors = np.linalg.eigh(columns.T @ columns / len(columns))
            inverse = (vectors / np.maximum(values, 1e-14)) @ vectors.T
            # Radians per relative error of the field: 0.3 % of it then cause 1.7 degrees.
            wide = np.sqrt(np.diag(inverse))[1:] > 10.0
        columns[:, 1:] *= ~wide
        solved = np.linalg.lstsq(columns, np.sum(turned * down, axis=1), rcond=None)[0]
        turn = Rotation.from_rotvec(solved[1:]).as_matrix() @ turn
    sine = float(solved[0])  # of the dip
    dip_ratio = sine / float(np.sqrt(max(1.0 - sine**2, 1e-6)))
    return ~wide, dip_ratio, np.append(iron[:3], (turn @ iron[3:].reshape(3, 3)).ravel())


def _align_to_heading(solved: SolvedIron) -> SolvedIron:
    """Rotate the iron about the vertical to a logged heading that follows the corrected axes better than raw ones."""
    logged = solved.log.heading_deg
    if logged is None or not solved.headed:
        return solved
    recorded, corrected = solved.headings()
    if (
        mean_and_scatter(angles.difference(logged, corrected))[1]
        > 0.5 * mean_and_scatter(angles.difference(logged, recorded))[1]
    ):
        return solved
    irons = []
    for iron, part in zip(solved.irons, solved.parts, strict=True):
        field = ellipsoid.corrected(iron, take(solved.choice.readings, part))
        turn_deg, _ = mean_and_scatter(angles.difference(logged[part], level_heading(field, solved.levelling[part])))
        irons.append(np.append(iron[:3], (about_down(turn_deg) @ iron[3:].reshape(3, 3)).ravel()))
    turned = np.append(solved.turned[:2], True)
    return replace(solved, irons=np.array(irons), turned=turned, logged_is_correct=True)
