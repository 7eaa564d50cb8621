"""Two profilers on one rigid frame: the simulation is b's heading from a's, rigidly turned.

The clocks come first, then the frame (by tilts), then the headings. The difference of two compasses does not tell
which of them is wrong; its constant cannot be told from the mounting angle but by the tilts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import angles
from compasslib.calibrations import readings
from compasslib.calibrations.heads import clock as heads_clock
from compasslib.calibrations.heads import frame as heads_frame
from compasslib.calibrations.heads import motion, report
from compasslib.calibrations.heads import series as heads_series
from compasslib.calibrations.heads.clock import ClockDifference
from compasslib.calibrations.heads.frame import Frame
from compasslib.calibrations.heads.motion import Compared, Motion
from compasslib.calibrations.heads.series import HeadingDifference
from compasslib.calibrations.result import Calibration
from compasslib.errors import InputError
from compasslib.readers import pd0
from compasslib.records import Record
from compasslib.types import Floats

KIND = "two_heads"
FEWEST = 100  # samples of both heads at the same time
FARTHEST_CLOCK_S = 600.0
UNRELATED_DEG = 30.0  # rms of the difference beyond which two headings have nothing to do with each other
PAIR = 2


def calibrate(files: Sequence[str | Path], settings: Mapping[str, Any]) -> Calibration:
    """Return the difference of the compasses of two profilers on one frame.

    Args:
        files: PD0 files of head a and of head b.
        settings: keys of the calibration's YAML: start_s, end_s (window by a's clock), orientation,
            declination_applied, heading_alignment (of a and b), max_clock_seconds, clock_offset_seconds (None: found).

    Raises:
        InputError: not two files, or one that cannot be read.
    """
    if len(files) != PAIR:
        raise InputError(
            "file",
            expected="two files, of head a and head b",
            found=f"{len(files)}",
            advice="write file: [a.000, b.000]",
        )
    a, b = (record(path, settings, k) for k, path in enumerate(files))
    return compare(a, b, settings)


def compare(a: Record, b: Record, settings: Mapping[str, Any]) -> Calibration:
    """Return the difference of the compasses of two heads.

    Args:
        a: record of one head, by its own clock.
        b: record of the other.
        settings: as for ``calibrate``.
    """
    farthest = float(given(settings, "max_clock_seconds", FARTHEST_CLOCK_S))
    start, end = settings.get("start_s"), settings.get("end_s")
    first = motion.motion(a, start, end)
    second = motion.motion(b, None if start is None else start - farthest, None if end is None else end + farthest)
    warnings = (*a.warnings, *b.warnings, *readings.dated(first.time_s, settings.get("date_s")))
    if min(len(first.time_s), len(second.time_s)) < FEWEST or not overlap(first, second, farthest):
        n = min(len(first.time_s), len(second.time_s))
        return _nothing(0, f"the two heads share no time with {FEWEST} usable samples of each ({n} usable)", warnings)
    fixed = settings.get("clock_offset_seconds")
    clock = heads_clock.find(first, second, farthest) if fixed is None else given_clock(second, float(fixed))
    compared = together(first, second, clock)
    if len(compared) < FEWEST:
        why = f"{len(compared)} samples of both heads at the same time, at least {FEWEST} are needed"
        return _nothing(len(compared), why, warnings + clock.warnings)
    return _assembled(compared, clock, warnings)


def record(path: str | Path, settings: Mapping[str, Any], which: int) -> Record:
    """Return the record of one head.

    Args:
        settings: as for ``calibrate``.
        which: 0 for a, 1 for b.
    """

    def of(key: str) -> Any:
        value = settings.get(key)
        return value[which] if isinstance(value, list | tuple) else value

    return pd0.read(
        [Path(path)],
        orientation=of("orientation"),
        declination_applied=of("declination_applied"),
        heading_alignment=of("heading_alignment"),
    )


def given(settings: Mapping[str, Any], key: str, default: float) -> Any:
    """Return a key of the settings, the default where it is absent or null."""
    value = settings.get(key)
    return default if value is None else value


def overlap(a: Motion, b: Motion, farthest: float) -> bool:
    """Tell whether two heads measured at the same time, their clocks at most so far apart, seconds."""
    return bool(max(a.time_s[0], b.time_s[0] - farthest) < min(a.time_s[-1], b.time_s[-1] + farthest))


def given_clock(b: Motion, offset_s: float) -> ClockDifference:
    """Return a clock of b that is known to be off by so many seconds."""
    middle = float(b.time_s[0] + b.time_s[-1]) / 2.0
    return ClockDifference(offset_s=offset_s, sigma_s=heads_clock.RESOLUTION_S, middle_s=middle)


def together(a: Motion, b: Motion, clock: ClockDifference) -> Compared:
    """Return both heads at b's instants, a's read at the same time by the clocks."""
    at = clock.by_a(b.time_s)
    heading, lean, rate = a.heading.at(at), a.leaning.at(at), a.heading.at(at, 1)
    known = np.isfinite(heading) & np.isfinite(lean)
    recorded = angles.wrap360(heading[known])
    return Compared(b.time_s[known], recorded, b.recorded_deg[known], lean[known], b.lean[known], rate[known])


def _assembled(pairs: Compared, clock: ClockDifference, warnings: tuple[str, ...]) -> Calibration:
    frame = heads_frame.fit(pairs.time_s, pairs.lean_a, pairs.lean_b)
    offset, difference, series = _fitted(pairs, clock, frame)
    rms = angles.rms(series.residual_deg[series.kept])
    warnings = warnings + clock.warnings + report.warnings(pairs, clock, frame, series, offset)
    details = report.details(pairs, clock, frame, series, offset)
    points = report.points(pairs, difference, offset, frame, series)
    coverage = int(series.covered.sum())
    if rms > UNRELATED_DEG:
        why = (
            f"b's headings do not follow a's ({rms:.0f}° rms about any constant turn): these heads do not stand on one "
            f"frame, or their clocks are farther apart than max_clock_seconds"
        )
        return replace(_nothing(len(pairs), why, warnings + clock.warnings), coverage=coverage, points=points)
    full = _full(series)
    return Calibration(
        kind=KIND,
        model=f"rigid turn, then series in b's recorded heading: {heads_series.SETS[series.terms]}",
        n=int(series.kept.sum()),
        coverage=coverage,
        coefficients=full[0] if series.terms > 1 else np.zeros(0),
        covariance=full[1] if series.terms > 1 else np.zeros(0),
        residual_rms_deg=rms,
        sources=report.sources(pairs, clock, frame, series),
        table=heads_series.table(series),
        points=points,
        details=details,
        why="" if series.terms > 1 else series.refused,
        warnings=warnings,
    )


def _fitted(pairs: Compared, clock: ClockDifference, frame: Frame) -> tuple[float, Floats, HeadingDifference]:
    """Return the offset, what b must add to agree with a turned by it, and the series through that.

    The offset is the series' constant; twice, because the turn enters the effect of tilt too.
    """
    offset = float(angles.mean(angles.difference(pairs.recorded_b, pairs.recorded_a)))
    sigma = heads_clock.heading_error_deg(clock, pairs.rate_deg_s)
    for _ in range(3):
        difference = angles.difference(turned(pairs, offset, frame), pairs.recorded_b)
        series = heads_series.fit(pairs.time_s, pairs.recorded_b, difference, sigma)
        if abs(series.coefficients[0]) < 1e-4:
            break
        offset = float(angles.wrap180(offset - series.coefficients[0]))
    return offset, difference, series


def turned(pairs: Compared, offset_deg: float, frame: Frame) -> Floats:
    """Return the heading that b must have by a's, rigidly turned, (n,) degrees.

    Args:
        offset_deg: of b's forward axis clockwise from a's.
    """
    if frame.verdict in ("mirrored", "not rigid"):
        return angles.wrap360(pairs.recorded_a + offset_deg)
    rotation = heads_frame.upright(offset_deg, pairs.lean_a, pairs.lean_b)
    return heads_frame.turned_heading(pairs.recorded_a, pairs.lean_a, rotation)


def _full(series: HeadingDifference) -> tuple[Floats, Floats]:
    """Return five coefficients and their covariance, NaN where a term was refused; A is 0 by definition."""
    coefficients, covariance = np.full(5, np.nan), np.full((5, 5), np.nan)
    coefficients[: series.terms] = series.coefficients
    coefficients[0] = 0.0
    covariance[: series.terms, : series.terms] = series.covariance
    return coefficients, covariance


def _nothing(n: int, why: str, warnings: tuple[str, ...]) -> Calibration:
    return Calibration(kind=KIND, model="none", n=n, coverage=0, why=why, warnings=warnings)
