"""Calibration of a compass from the raw axes of its magnetometer: hard and soft iron, and their effect on the heading.

Le Menn et al. 2023, eqs. (1), (2) and section 6. The axes are forward, starboard, down unless a logged heading shows
otherwise. An ellipsoid determines G^T G only: the rotation between magnetometer and instrument is known only as far as
tilts and heading determine it. Parameters that the orientations do not determine are reported and not fitted.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from math import log10
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import angles, compass
from compasslib.calibrations.budget import Source
from compasslib.calibrations.magnetometer import ellipsoid, iron
from compasslib.calibrations.magnetometer import log as magnetometer_log
from compasslib.calibrations.magnetometer.iron import SolvedIron
from compasslib.calibrations.magnetometer.log import Log
from compasslib.calibrations.result import Calibration, DeviationTable, check_date
from compasslib.deviation.series import series_deviation
from compasslib.errors import applicable
from compasslib.types import Floats

KIND, NO_MODEL = "magnetometer", "none"
SECTOR_DEG = 10.0
NO_DIP = (
    "Hard and soft iron are determined, but their effect on the heading depends on the dip: log the tilts, or give "
    "latitude, longitude and date."
)
FOLDED = (
    "The iron is stronger than the earth's horizontal field: two correct headings give the same reading and no table "
    "can correct it; subtract hard_iron from the raw axes instead."
)
TILT_SENSOR_DEG = 0.20  # standard uncertainty; Le Menn et al. 2023, section 2, gives 0.40 degrees expanded
MAX_RESIDUAL_PERCENT = 5.0  # of the modulus: largest residual of a compass with iron fixed to it
MAX_AXIS_RATIO = 1.4  # of the largest to the smallest sensitivity of an axis; sensors differ by a quarter, iron by less
TURNS = ("forward", "starboard", "vertical")
OPEN_TURN = "an ellipsoid does not depend on how the sensor is turned; only tilts and a logged heading determine it"
MAX_UNIT_ERROR = 0.12  # exceeds errors by sensor, crust and daily variation; one in nine arbitrary scales passes
NANOTESLA = {"nT": 1.0, "uT": 1e3, "µT": 1e3, "mT": 1e6, "mG": 100.0, "G": 1e5, "Gauss": 1e5}
UNIT_SUFFIX = re.compile(rf"[_ .\[(]({'|'.join(NANOTESLA)})[\])]?$")
Field = Mapping[str, float] | None


def calibrate(files: Sequence[str | Path], settings: Mapping[str, Any]) -> Calibration:
    """Calibrate a magnetometer from its log.

    Args:
        files: CSV files with x, y and perhaps z, pitch_deg, roll_deg, heading_deg, time_utc.
        settings: ``columns``, ``withhold`` and ``field`` {horizontal_nT, vertical_nT, ...} or None.

    Raises:
        InputError: a column is absent or a cell is not a number.
    """
    log = magnetometer_log.repair_counts(magnetometer_log.read(files, settings))
    why = magnetometer_log.unusable_reason(log)
    if why:
        return _refused(log, why)
    field = settings.get("field")
    axes, warnings = magnetometer_log.determine_axes(log)
    choice = ellipsoid.choose_model(log, log.raw @ axes.matrix.T)
    far = ellipsoid.find_outliers(choice)
    if far.any():
        log = log.take(~far, f"{far.sum()} of {far.size} readings are outliers of the fitted modulus and excluded.")
        choice = ellipsoid.choose_model(log, log.raw @ axes.matrix.T)
    solved = iron.solve_iron(log, axes, choice, field)
    if solved is None:
        return _refused(log, choice.why)
    exact = iron.exact_coefficients(solved.iron, solved.dip_ratio)
    known = bool(np.isfinite(exact).all())
    folded = known and not compass.turns_full_circle(exact)
    misfits = _misfits(solved)
    warnings = [*log.warnings, *warnings, *check_date(log.time_s, settings.get("date_s"))]
    return Calibration(
        kind=KIND,
        model=solved.fitted.model.name,
        n=len(solved.log.raw),
        coverage=len(np.unique(solved.headings()[0] // SECTOR_DEG)),
        points=_points(solved),
        details={**_details(solved, field), "doubts": misfits},
        why=FOLDED if folded else "" if known else NO_DIP,
        warnings=(*warnings, *_warnings(solved, field, settings.get("columns") or {}), *misfits),
        **(_correction(solved, exact, folded=folded) if known else {}),
    )


def _refused(log: Log, why: str) -> Calibration:
    details = {"hard_iron": None, "soft_iron": None, "undetermined": [*ellipsoid.PARAMETERS], "left_out": log.left_out}
    return Calibration(KIND, NO_MODEL, len(log.raw), 0, details=details, why=why, warnings=log.warnings)


def _correction(solved: SolvedIron, exact: Floats, *, folded: bool) -> dict[str, Any]:
    """Compute coefficients, table and budget of the deviation by the iron; only the exact coefficients if folded."""
    dips = solved.dip_replicates.tolist()
    replicates = np.array([*map(iron.exact_coefficients, solved.replicates, dips)])
    moved = iron.exact_coefficients(solved.moved, solved.dip_ratio)
    correction: dict[str, Any] = {"exact": exact, "exact_covariance": ellipsoid.covariance(replicates, moved - exact)}
    if folded:
        return correction
    series, table = iron.series_coefficients(exact), iron.deviation_table(exact, replicates, moved)
    each_series = np.array([iron.series_coefficients(replicate) for replicate in replicates])
    # Misfit of the series: over the readings, or around the circle if these have no headings.
    if solved.headed:
        recorded, corrected = solved.headings()
        deviation = angles.difference(corrected, recorded)
    else:
        recorded = iron.GRID_DEG
        deviation = iron.exact_deviation(exact, recorded)
    return correction | {
        "coefficients": series,
        "covariance": ellipsoid.covariance(each_series, iron.series_coefficients(moved) - series),
        "residual_rms_deg": angles.rms(deviation - series_deviation(series, recorded)),
        "sources": _sources(solved, table, series),
        "table": table,
    }


def _points(solved: SolvedIron) -> dict[str, Floats]:
    """Tabulate readings and corrected readings, (n,) each, in the file's unit and axes."""
    scale, field, log = solved.choice.scale, solved.corrected(), solved.log
    size, down = scale * solved.gain(solved.iron), solved.readings.down
    axes = "xyz" if log.has_z else "xy"
    columns = {name: log.raw[:, k] for k, name in enumerate(axes)}
    columns |= {f"{name}_corrected": size * (field @ solved.axes.matrix)[:, k] for k, name in enumerate(axes)}
    columns["modulus"] = scale * ellipsoid.modulus(solved.readings.field, down)
    columns["modulus_corrected"] = size * ellipsoid.modulus(field, down)
    if solved.headed:
        recorded, corrected = solved.headings()
        columns |= {"recorded_deg": recorded, "corrected_deg": corrected}
        columns["deviation_deg"] = angles.difference(corrected, recorded)
    extra = {"pitch_deg": log.pitch_deg, "roll_deg": log.roll_deg, "logged_deg": log.heading_deg, "time_s": log.time_s}
    return columns | {name: values for name, values in extra.items() if values is not None}


def _details(solved: SolvedIron, field: Field) -> dict[str, Any]:
    """Collect the details specific to a magnetometer, ready for JSON; null where undetermined."""
    choice, size = solved.choice, solved.choice.scale * solved.gain(solved.iron)
    misalignment = {
        name: {"value": float(angle), "sigma": float(sigma)} if np.isfinite(angle) else None
        for name, angle, sigma in zip(TURNS, solved.turn_deg, solved.turn_sigma_deg, strict=True)
    }
    open_turns = {f"turn about {name}": OPEN_TURN for name, angle in misalignment.items() if angle is None}
    undetermined = {**choice.undetermined, **open_turns}
    harmonics = None
    if solved.headed:
        recorded, corrected = solved.headings()
        fields = {"before": (solved.readings.field, recorded), "after": (solved.corrected(), corrected)}
        harmonics = {
            when: dict(zip(("first", "second"), iron.modulus_harmonics(modulus, heading), strict=True))
            for when, (each, heading) in fields.items()
            for modulus in [ellipsoid.modulus(each, solved.down)]
        }
    details: dict[str, Any] = {
        "model": solved.fitted.model.name,
        "axes": solved.axes.text,
        **_iron(solved),
        "undetermined": list(undetermined),
        "undetermined_why": undetermined,
        "standard_error_of_field": choice.weakest,
        "scores": choice.scores,
        "noise": size * solved.fitted.noise,
        "field_in_file_unit": size,
        "field_is": "horizontal" if choice.level else "total",
        "modulus_residual_percent": _residuals(solved),
        "harmonics_percent": harmonics,
        "misalignment_deg": misalignment,
        "left_out": solved.log.left_out,
    }
    if field is not None:
        details["counts_per_nT"] = size / _strength(solved, field)
    return details


def _strength(solved: SolvedIron, field: Mapping[str, float]) -> float:
    """Compute the modulus of the earth's field, nT, horizontal for a level platform, else total."""
    level = field["horizontal_nT"]
    return float(level if solved.choice.level else np.hypot(level, field["vertical_nT"]))


def _iron(solved: SolvedIron) -> dict[str, Any]:
    """Describe hard and soft iron in the file's axes with one standard deviation.

    If the selected model has no soft iron, its uncertainty is taken from the largest model that is determined.
    """
    choice, to_body = solved.choice, solved.axes.matrix
    largest = choice.full.iron()[1] if choice.full and choice.full is not choice.fitted else solved.replicates
    shift = choice.scale * to_body.T @ (solved.moved - solved.iron)[:3]
    soft = np.array([to_body.T @ solved.soft(replicate) @ to_body for replicate in largest])
    arrays = {
        "hard_iron": choice.scale * to_body.T @ solved.iron[:3],
        "hard_iron_sigma": ellipsoid.sigma(choice.scale * solved.replicates[:, :3] @ to_body, shift),
        "soft_iron": to_body.T @ solved.soft(solved.iron) @ to_body,
        "soft_iron_sigma": ellipsoid.sigma(soft),
    }
    shown = {name: values.astype(object) for name, values in arrays.items()}
    for name in choice.undetermined:
        for values in shown.values():
            if name in ellipsoid.CENTRE and values.ndim == 1:
                values[ellipsoid.CENTRE.index(name)] = None
            elif name in ellipsoid.PLACES and values.ndim == 2:
                i, j = ellipsoid.PLACES[name]
                values[i, j] = values[j, i] = None
    return {name: values.tolist() for name, values in shown.items()}


def _residuals(solved: SolvedIron) -> dict[str, float]:
    """Compute the scatter of the modulus about its mean before and after correction, percent."""
    down = solved.readings.down
    moduli = {"before": ellipsoid.modulus(solved.readings.field, down)}
    moduli["after"] = ellipsoid.modulus(solved.corrected(), down)
    return {when: float(100.0 * modulus.std() / modulus.mean()) for when, modulus in moduli.items()}


def _warnings(solved: SolvedIron, field: Field, columns: Mapping[str, str]) -> list[str]:
    """List the conditions under which the correction holds, in sentences."""
    level, tilted = solved.choice.level, solved.log.tilted
    sentences_where = {
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
    return applicable(sentences_where) + ([] if field is None else _unit_warnings(solved, field, columns))


def _misfits(solved: SolvedIron) -> list[str]:
    """List misfits that iron fixed to a compass cannot cause and that make the coefficients doubtful."""
    residual, dimensions = _residuals(solved)["after"], 2 if solved.choice.level else 3
    strengths = np.linalg.svd(solved.soft(solved.iron)[:dimensions, :dimensions], compute_uv=False)
    texts = []
    if residual > MAX_RESIDUAL_PERCENT:
        texts.append(
            f"the modulus varies by {residual:.0f} % after correction for hard and soft iron: iron that moved, axes "
            "exchanged or of another sign than the tilts', an axis that failed, or readings beyond the scale"
        )
    if strengths[0] > MAX_AXIS_RATIO * strengths[-1]:
        texts.append(
            f"one axis measures {strengths[0] / strengths[-1]:.1f} times the field of another: axes in different "
            "units, or one that is failing; the logged heading may not have this error"
        )
    return texts


def _sources(solved: SolvedIron, table: DeviationTable, series: Floats) -> tuple[Source, ...]:
    """Make the uncertainty budget of a corrected heading."""
    horizontal = 1.0 / float(np.hypot(1.0, solved.dip_ratio))
    off = table.deviation_deg - series_deviation(series, table.heading_deg)
    how = "block jackknife, with what a mean tilt hides of vertical iron, rms over the table"
    reading_deg = solved.fitted.noise / horizontal / angles.DEGREE
    sources = [
        Source("fit", float(np.sqrt(np.mean(table.sigma_deg**2))), how),
        Source("series", angles.rms(off), "rms of the five terms about the exact deviation"),
        Source("one reading", reading_deg, "scatter of the modulus, one axis"),
    ]
    if solved.log.tilted:
        ratio = abs(solved.dip_ratio)
        if solved.choice.level:
            ratio = float(np.mean(np.abs(np.sum(solved.corrected() * solved.down, axis=1))))
        how = "0.40° expanded (Le Menn et al. 2023, section 2) times vertical over horizontal field"
        sources.append(Source("tilt sensor", TILT_SENSOR_DEG * ratio, how))
    if solved.log.tilted and solved.choice.level:
        tilt = float(np.sqrt(np.mean(np.var(solved.down[:, :2], axis=0))))
        hard = float(np.hypot(*solved.iron[:2]))
        how = "tilt about its mean times a vertical iron as strong as the horizontal one; the tilts do not determine it"
        sources.append(Source("vertical iron", hard * tilt / angles.DEGREE, how))
    return tuple(sources)


def _unit_warnings(solved: SolvedIron, field: Mapping[str, float], columns: Mapping[str, str]) -> list[str]:
    """Warn if the modulus is not that of the earth's field in the stated unit, or in any unit if none is stated.

    Units of magnetic fields differ by powers of ten. If the file does not state its unit, the corrected modulus must
    match IGRF in one of them; headers such as ``mag_x_nT`` state the unit.
    """
    modulus, strength_nT = solved.choice.scale * solved.gain(solved.iron), _strength(solved, field)
    ends = {match[1] if (match := UNIT_SUFFIX.search(columns.get(role) or "")) else None for role in ("x", "y")}
    unit = ends.pop() if len(ends) == 1 else None
    ratio = modulus / strength_nT
    agreement = 10.0 ** round(log10(ratio)) / ratio if unit is None else 1.0 / (modulus * NANOTESLA[unit] / strength_nT)
    if abs(agreement - 1.0) < MAX_UNIT_ERROR:
        return []
    what = "horizontal" if solved.choice.level else "total"
    none = "No unit of a magnetic field (nT, µT, mG, G) makes"
    by = "The unit in the header does not make" if unit else none
    return [
        f"The corrected {what} field is {modulus:.4g} {unit or 'in the unit of the file'}; IGRF has {strength_nT:.0f} "
        f"nT at place and date. {by} the two agree: a wrong scale, unit, place or date, raw counts of the sensor, or "
        "not the earth's field. Headings depend on ratios only and are not affected; hard_iron is in the file's unit."
    ]
