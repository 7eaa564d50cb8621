"""Iron in the frame of the instrument: the selected ellipsoid, rotated as far as tilts and logged heading determine."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from compasslib import angles, compass
from compasslib.calibrations.magnetometer import ellipsoid
from compasslib.calibrations.magnetometer.ellipsoid import FittedEllipsoid, ModelChoice, ScaledReadings
from compasslib.calibrations.magnetometer.log import Axes, Log, about_down, level_heading, mean_and_scatter
from compasslib.calibrations.result import DeviationTable
from compasslib.deviation.series import series_design
from compasslib.types import Floats

TABLE_DEG = np.arange(0.0, 360.0, 10.0)
GRID_DEG = np.arange(0.0, 360.0, 5.0)
MAX_SCATTER_RATIO = 0.5  # of logged minus corrected headings to logged minus raw ones
ROUNDS = 3  # linearized steps for the misalignment
MAX_DILUTION = 10.0  # radians of misalignment per relative error of the field: 0.3 % then cause 1.7 degrees


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
    return np.linalg.lstsq(series_design(GRID_DEG), exact_deviation(coefficients, GRID_DEG), rcond=None)[0]


def deviation_table(coefficients: Floats, replicates: Floats, moved: Floats) -> DeviationTable:
    """Tabulate the exact deviation every 10 degrees of the recorded heading.

    Its uncertainty follows from the jackknife replicates of the coefficients, (blocks, 5), and from ``moved``, the
    coefficients changed by one standard deviation of the unobservable vertical iron, (5,).
    """
    value = exact_deviation(coefficients, TABLE_DEG)
    off = np.array([angles.difference(exact_deviation(each, TABLE_DEG), value) for each in (moved, *replicates)])
    return DeviationTable(TABLE_DEG, value, ellipsoid.sigma(off[1:], off[0]))


def modulus_harmonics(modulus: Floats, heading_deg: Floats) -> tuple[float, float]:
    """Fit the first and second harmonic of a modulus against the heading, percent of its mean."""
    k = np.linalg.lstsq(series_design(heading_deg), modulus, rcond=None)[0]
    return float(100.0 * np.hypot(k[1], k[2]) / k[0]), float(100.0 * np.hypot(k[3], k[4]) / k[0])


def estimate_tilt_misalignment(iron: Floats, readings: ScaledReadings, down: Floats) -> tuple[Floats, float, Floats]:
    """Estimate the small rotation from magnetometer to tilt sensor that makes the vertical field constant.

    With the downward direction t, the vertical field t . (h + e x h) is a constant c in every orientation, so
    t . h = c - e . (h x t) is linear in the rotation e about forward, starboard and down.

    Returns:
        The rotation (3,) in degrees, NaN about axes that the tilts do not determine; c, the sine of the dip; and the
        iron with the rotation included in G.
    """
    field = ellipsoid.corrected(iron, readings)
    turn, wide = np.eye(3), np.zeros(3, dtype=bool)
    for _ in range(ROUNDS):
        turned = field @ turn.T
        columns = np.column_stack([np.ones(len(field)), -np.cross(turned, down)])
        if not wide.any():
            values, vectors = np.linalg.eigh(columns.T @ columns / len(columns))
            inverse = (vectors / np.maximum(values, 1e-14)) @ vectors.T
            wide = np.sqrt(np.diag(inverse))[1:] > MAX_DILUTION
        columns[:, 1:] *= ~wide
        solved = np.linalg.lstsq(columns, np.sum(turned * down, axis=1), rcond=None)[0]
        turn = _rotation(solved[1:]) @ turn
    vector = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2.0
    matrix = turn @ iron[3:].reshape(3, 3)
    return np.where(wide, np.nan, vector / angles.DEGREE), float(solved[0]), np.append(iron[:3], matrix.ravel())


def _rotation(vector: Floats) -> Floats:
    """Build the rotation about a vector by its length in radians (Rodrigues), (3, 3)."""
    length = float(np.linalg.norm(vector))
    x, y, z = vector / max(length, 1e-300)
    across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, cosine = (float(v) for v in angles.sin_cos(length / angles.DEGREE))
    return np.eye(3) + sine * across + (1.0 - cosine) * across @ across


@dataclass(frozen=True)
class SolvedIron:
    """Iron with everything needed to compute headings; replicates leave out one block of the readings each."""

    log: Log
    axes: Axes
    choice: ModelChoice
    fitted: FittedEllipsoid
    readings: ScaledReadings
    iron: Floats  # (12,) centre and G, for the scaled readings
    replicates: Floats  # (blocks, 12)
    levelling: Floats  # (n, 3, 3)
    dip_ratio: float  # downward over horizontal field; 0 on a level platform, NaN where unknown
    dip_replicates: Floats  # (blocks,)
    turn_deg: Floats  # (3,) from magnetometer to instrument about forward, starboard, down; NaN where undetermined
    turn_sigma_deg: Floats  # (3,)
    turn_replicates_deg: Floats  # (blocks, 3) part of the rotation determined by tilts, 0 where none
    logged_is_correct: bool = False  # whether the logged heading follows the corrected axes

    @property
    def headed(self) -> bool:
        """Whether headings can be computed: tilts were logged, or the platform is level."""
        return self.log.tilted or self.choice.level

    @property
    def down(self) -> Floats:
        """Downward direction in the body frame, (n, 3)."""
        return self.levelling[:, 2, :]

    @property
    def moved(self) -> Floats:
        """Iron changed by one standard deviation of the unobservable vertical hard iron, (12,).

        On a level platform with a mean tilt, vertical iron looks like horizontal iron; it is assumed equally strong.
        """
        if not (self.choice.level and self.log.tilted):
            return self.iron
        hard = float(np.hypot(*self.iron[:2]))
        return self.iron + np.append(hard * self.down[:, :2].mean(axis=0), np.zeros(10))

    def corrected(self) -> Floats:
        """Correct the readings for the iron: the normalized field, (n, 3)."""
        return ellipsoid.corrected(self.iron, self.readings)

    def headings(self) -> tuple[Floats, Floats]:
        """Compute recorded and corrected headings, (n,) degrees each."""
        return level_heading(self.readings.field, self.levelling), level_heading(self.corrected(), self.levelling)

    def gain(self, iron: Floats) -> float:
        """Compute the field's modulus in scaled readings: the mean diagonal of the observed axes."""
        soft = np.linalg.inv(iron[3:].reshape(3, 3))
        return float(np.mean(np.diag(soft)[: 2 if self.choice.level else 3]))

    def soft(self, iron: Floats) -> Floats:
        """Compute the soft iron relative to the mean diagonal of the observed axes, body frame, (3, 3)."""
        return np.linalg.inv(iron[3:].reshape(3, 3)) / self.gain(iron)


def solve_iron(log: Log, axes: Axes, choice: ModelChoice, field: Mapping[str, float] | None) -> SolvedIron | None:
    """Express the iron in the frame of the instrument; None if no model was fitted.

    The earth's field {horizontal_nT, vertical_nT} gives the dip without tilts; it is None if unknown.
    """
    if choice.fitted is None or choice.readings is None:
        return None
    iron, replicates = choice.fitted.iron()
    dip = 0.0 if choice.level else np.nan if field is None else field["vertical_nT"] / field["horizontal_nT"]
    turn, sigma = np.array([np.nan, np.nan, axes.vertical_deg]), np.array([np.nan, np.nan, axes.vertical_sigma_deg])
    levelling, dips = log.levelling(), np.full(len(replicates), dip)
    parts = (log, axes, choice, choice.fitted, choice.readings, iron, replicates, levelling, dip, dips, turn, sigma)
    solved = SolvedIron(*parts, np.zeros((len(replicates), 3)))
    if log.tilted and not choice.level:
        solved = _align_to_tilts(solved)
    return _align_to_heading(solved)


def _align_to_tilts(solved: SolvedIron) -> SolvedIron:
    """Rotate the iron into the frame of the tilt sensor, where the vertical field is constant and gives the dip."""
    readings, down, block = solved.readings, solved.down, ellipsoid.blocks(len(solved.readings))
    turn, sine, turned = estimate_tilt_misalignment(solved.iron, readings, down)
    parts = [(each, block != k) for k, each in enumerate(solved.replicates)]
    each = [estimate_tilt_misalignment(iron, readings.take(kept), down[kept]) for iron, kept in parts]
    turns = np.array([replicate[0] for replicate in each])
    sigma = ellipsoid.sigma(turns)
    by_heading = np.isfinite(solved.turn_deg)
    return replace(
        solved,
        iron=turned,
        replicates=np.array([replicate[2] for replicate in each]),
        dip_ratio=_dip_ratio(sine),
        dip_replicates=np.array([_dip_ratio(replicate[1]) for replicate in each]),
        turn_deg=np.where(by_heading, solved.turn_deg + np.nan_to_num(turn), turn),
        turn_sigma_deg=np.where(by_heading, np.hypot(solved.turn_sigma_deg, np.nan_to_num(sigma)), sigma),
        turn_replicates_deg=np.nan_to_num(turns),
    )


def _dip_ratio(sine: float) -> float:
    return sine / float(np.sqrt(max(1.0 - sine**2, 1e-6)))


def _align_to_heading(solved: SolvedIron) -> SolvedIron:
    """Rotate the iron about the vertical to a logged heading that follows the corrected axes better than the raw ones.

    Such a heading has been corrected for iron already, so it determines how the magnetometer is mounted.
    """
    logged = solved.log.heading_deg
    if logged is None or not solved.headed:
        return solved
    recorded, corrected = solved.headings()
    centre, scatter = mean_and_scatter(angles.difference(logged, corrected))
    if scatter > MAX_SCATTER_RATIO * mean_and_scatter(angles.difference(logged, recorded))[1]:
        return solved
    block, turns_deg = ellipsoid.blocks(len(logged)), np.zeros(len(solved.replicates))
    for k, replicate in enumerate(solved.replicates):  # each with the readings that it was fitted to
        kept = block != k
        field = ellipsoid.corrected(replicate, solved.readings.take(kept))
        off = angles.difference(logged[kept], level_heading(field, solved.levelling[kept]))
        turns_deg[k], _ = mean_and_scatter(off)
    sigma = float(ellipsoid.sigma(angles.difference(turns_deg, centre) + solved.turn_replicates_deg[:, 2]))
    turns = zip(solved.replicates, turns_deg, strict=True)
    return replace(
        solved,
        iron=_about_down(solved.iron, centre),
        replicates=np.array([_about_down(replicate, float(angle)) for replicate, angle in turns]),
        turn_deg=np.append(solved.turn_deg[:2], np.nan_to_num(solved.turn_deg[2]) + centre),
        turn_sigma_deg=np.append(solved.turn_sigma_deg[:2], sigma),
        logged_is_correct=True,
    )


def _about_down(iron: Floats, angle_deg: float) -> Floats:
    """Rotate iron about the vertical so that corrected headings increase by an angle."""
    return np.append(iron[:3], (about_down(angle_deg) @ iron[3:].reshape(3, 3)).ravel())
