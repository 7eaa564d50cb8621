"""A compass on a bench whose directions are known: Le Menn et al. 2023, sections 2 and 6."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import angles
from compasslib.calibrations import budget, curves, readings, series
from compasslib.calibrations.curves import BenchReadings
from compasslib.calibrations.result import Calibration, Source
from compasslib.errors import InputError
from compasslib.types import Floats

ROLES = ("reference_deg", "recorded_deg")
QUARTER_DEG = 90.0  # a constant from which an instrument that stood turned is likelier than its compass
LARGE_DEG = 5.0  # a constant that benches and mounts are set better than
DECLINATION_DEG, ALIKE_DEG = 2.0, 0.5  # least that is told from a constant, and how near that is then
STEP_DEG = 2.0  # of a constant from the distance of two settings
POOR_DEG, EXPLAINED = 3.0, 3.0  # rms about the curve from which a mistake is looked for, and how much it must explain
EVEN, FEWEST_EVEN = 0.02, 8  # scatter of the distances of headings that were set, over their mean
UNITS = {"gon": 400.0, "radians": 360.0 * angles.DEGREE, "compass points": 32.0, "tens of degrees": 36.0}  # in a turn


def calibrate(files: Sequence[str | Path], settings: Mapping[str, Any]) -> Calibration:
    """Return the calibration on a bench.

    Args:
        files: CSV files with the magnetic reference direction and the recorded heading, degrees.
        settings: ``columns``, ``withhold``, the keys of tables, ``table_step_deg``, ``budget``, ``uncertainty``;
            ``mounting_deg``, how far clockwise of the bench's direction the instrument stood;
            ``declination_deg`` of the place.

    Raises:
        InputError: a file cannot be read, a column is absent or is not in degrees, headings run against each other, or
            a constant of a quarter turn and more is not settled by ``mounting_deg``.
    """
    columns, notes = readings.read(files, settings, required=ROLES)
    readings.check_degrees(columns, files)
    known = np.isfinite(columns["reference_deg"] + columns["recorded_deg"])
    mounting = settings.get("mounting_deg")
    reference = angles.wrap360(columns["reference_deg"][known] + (mounting or 0.0))
    read = BenchReadings(reference, columns["recorded_deg"][known])
    rows = budget.sources(settings.get("uncertainty") or {}, settings.get("budget"))
    step = float(settings.get("table_step_deg", 10.0))
    found = curves.calibration("platform", read, rows, table_step_deg=step)
    where = ", ".join(str(file) for file in files)
    _refuse_mistaken(found, BenchReadings(*(columns[role][known] for role in ROLES)), where)
    if mounting is None:
        _refuse_turned(found, where)
    constant = [] if mounting is not None else _constant(found, read, settings.get("declination_deg"))
    misfits = [*constant, *_exchanged(read)]
    return replace(
        found,
        details={**found.details, "doubts": misfits},
        warnings=(*notes, *_left_out(int(np.sum(~known))), *found.warnings, *misfits, *_missing(rows)),
    )


def _refuse_mistaken(found: Calibration, read: BenchReadings, where: str) -> None:
    """Refuse readings that a curve misses and that one mistake explains: another unit, or another sense of turning."""
    missed = np.inf if found.model == "none" else found.residual_rms_deg
    if missed < POOR_DEG or len(read) < FEWEST_EVEN:
        return
    each = {text: _missed(undone) for text, undone in _mistakes(read)}
    best = min(each, key=lambda text: each[text])
    if each[best] < min(missed, 90.0) / EXPLAINED:
        advice = "correct the columns; headings are degrees, clockwise"
        raise InputError(where, expected="headings that a deviation curve can join", found=best, advice=advice)


def _mistakes(read: BenchReadings) -> list[tuple[str, BenchReadings]]:
    reference, recorded = read.reference_deg, read.recorded_deg
    tried = [
        ("headings that run against each other: one column counts anticlockwise", BenchReadings(-reference, recorded))
    ]
    for unit, turn in UNITS.items():
        by = 360.0 / turn
        both = np.nanmax(np.abs([reference, recorded])) <= turn
        tried += [
            (f"reference_deg in {unit}, as it looks", BenchReadings(by * reference, recorded)),
            (f"recorded_deg in {unit}, as it looks", BenchReadings(reference, by * recorded)),
            *(
                [(f"both columns in {unit}, as they look", BenchReadings(by * reference, by * recorded))]
                if both
                else []
            ),
        ]
    return tried


def _missed(read: BenchReadings) -> float:
    """Return the rms of the five terms through readings; infinite where they determine none."""
    seen = series.points(read.recorded_deg, read.reference_deg)
    curve = series.fit(series.SMITH, seen)
    return float("inf") if isinstance(curve, str) else angles.rms(curve.residual_deg)


def _refuse_turned(found: Calibration, where: str) -> None:
    shift = found.details.get("constant_shift", {"value_deg": 0.0})["value_deg"]
    if abs(shift) < QUARTER_DEG - POOR_DEG:
        return
    stood = float(angles.wrap360(-QUARTER_DEG * np.round(shift / QUARTER_DEG)))
    raise InputError(
        where,
        expected="a constant of less than a quarter turn, or mounting_deg in the calibration's file",
        found=f"A {shift:+.1f} degrees",
        advice=f"write mounting_deg: {stood:.0f} if the instrument stood so on the bench, clockwise, or the bench was "
        "read from the other side; mounting_deg: 0 if the constant is the compass's own",
    )


def _constant(found: Calibration, read: BenchReadings, declination_deg: float | None) -> list[str]:
    """Return what a constant that is large, or the declination's, is likelier to be than the compass's."""
    shift = found.details.get("constant_shift")
    if shift is None or abs(shift["value_deg"]) <= 2.0 * shift["sigma_deg"]:
        return []
    value, near = float(shift["value_deg"]), max(2.0 * float(shift["sigma_deg"]), ALIKE_DEG)
    reasons = []
    if declination_deg is not None and min(abs(declination_deg), abs(value)) > DECLINATION_DEG:
        signs = {"": 1.0, " with the other sign": -1.0}
        alike = [text for text, sign in signs.items() if abs(value - sign * declination_deg) < near]
        reasons = [f"it is the declination, {declination_deg:+.1f}{text}: reference_deg may be true" for text in alike]
    if abs(value) > LARGE_DEG:
        step = float(np.median(np.diff(np.unique(np.round(read.reference_deg, 1)))))
        shifted = f", the columns shifted by one setting of {step:.0f}" if abs(abs(value) - step) < STEP_DEG else ""
        reasons.append(f"the instrument may have stood turned (mounting_deg){shifted}, or reference_deg is true")
    text = f"a constant of {value:+.1f} degrees, which turns all headings alike: {'; '.join(reasons)}"
    return [text] if reasons else []


def _exchanged(read: BenchReadings) -> list[str]:
    if not _even(read.recorded_deg) or _even(read.reference_deg):
        return []
    return [
        "recorded_deg goes in even steps and reference_deg does not: where the columns are exchanged, every deviation "
        "has the wrong sign"
    ]


def _even(heading_deg: Floats) -> bool:
    """Tell whether headings were set: all round, in even steps."""
    at = np.unique(np.round(angles.wrap360(heading_deg), 2))
    apart = angles.wrap360(np.roll(at, -1) - at)
    return len(at) >= FEWEST_EVEN and bool(np.ptp(apart) <= EVEN * np.mean(apart))


def _left_out(count: int) -> list[str]:
    return [f"{count} lines without both headings are left out"] if count else []


def _missing(rows: tuple[Source, ...]) -> list[str]:
    names = budget.absent(rows)
    if not names:
        return []
    holds = "only the scatter about the curve" if not rows else "the other rows only"
    return [f"the budget has no row {', '.join(names)}: the expanded uncertainty holds {holds}"]
