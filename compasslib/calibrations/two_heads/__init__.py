"""Two profilers on one rigid frame: compares b's recorded heading with that simulated from a's by a rigid rotation.

Clocks are aligned first, then the frame is fitted to the tilts, then the headings are compared. The difference of two
compasses does not show which of them is wrong, nor their constant errors, which the mounting angle includes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import angles
from compasslib.calibrations.result import Calibration, Source
from compasslib.calibrations.two_heads import frame as frames
from compasslib.calibrations.two_heads import motion
from compasslib.calibrations.two_heads.frame import Frame, HeadingDifference
from compasslib.calibrations.two_heads.motion import RESOLUTION_S, ClockDifference, Motion, PairedHeads
from compasslib.errors import InputError, applicable
from compasslib.readers import pd0
from compasslib.records import Record
from compasslib.types import Floats

KIND = "two_heads"
MIN_SAMPLES = 100  # simultaneous samples of both heads
MAX_CLOCK_OFFSET_S = 600.0
UNRELATED_DEG = 30.0  # rms of the difference beyond which two headings are unrelated
PAIR = 2
CLOCK = {  # keys in calibration.json -> fields of a clock difference
    **{name: name for name in ("offset_s", "sigma_s", "drift_s_per_day", "drift_sigma_s_per_day", "drift_applied")},
    **{"found": "determined", "from_tilts_s": "from_tilts_s", "from_headings_s": "from_headings_s"},
}
AMBIGUITY = (
    "The difference of two compasses does not show which of them is wrong: the coefficients are those of b relative to "
    "a, and of b alone only as far as a's compass is correct.",
    "A is 0 by definition: the headings cannot separate a constant error of either compass from the mounting angle. "
    "offset_deg includes both.",
)


def calibrate(files: Sequence[str | Path], settings: Mapping[str, Any]) -> Calibration:
    """Estimate the difference of the compasses of two profilers on one frame from the PD0 files of head a and head b.

    Raises:
        InputError: there are not two files, or one cannot be read.
    """
    if len(files) != PAIR:
        expected, advice = "two files, of head a and head b", "write file: [a.000, b.000]"
        raise InputError("file", expected=expected, found=f"{len(files)}", advice=advice)
    a, b = (read_head(path, settings, k) for k, path in enumerate(files))
    warnings = (*a.warnings, *b.warnings)
    max_offset_s = float(setting(settings, "max_clock_seconds", MAX_CLOCK_OFFSET_S))
    start, end = (float(setting(settings, key, edge)) for key, edge in (("start_s", -np.inf), ("end_s", np.inf)))
    first = motion.extract_motion(a, start, end)
    second = motion.extract_motion(b, start - max_offset_s, end + max_offset_s)
    n = min(len(first.time_s), len(second.time_s))
    if n < MIN_SAMPLES or not overlap_in_time(first, second, max_offset_s):
        why = f"the two heads share no time with {MIN_SAMPLES} usable samples of each ({n} usable)"
        return _refused(0, why, warnings)
    fixed = settings.get("clock_offset_seconds")
    if fixed is None:
        clock = motion.estimate_clock_offset(first, second, max_offset_s)
    else:
        clock = known_clock_offset(second, float(fixed))
    pairs, warnings = pair_samples(first, second, clock), warnings + clock.warnings
    if len(pairs) < MIN_SAMPLES:
        why = f"{len(pairs)} samples of both heads at the same time, at least {MIN_SAMPLES} are needed"
        return _refused(len(pairs), why, warnings)
    if not frames.covered_sectors(pairs.recorded_b).any():
        why = f"no sector of 10° of headings holds {frames.MIN_IN_SECTOR} samples of both heads"
        return _refused(len(pairs), why, warnings)
    # Fit the rotation as the constant of the series, iteratively, because it enters the effect of tilt too.
    frame = frames.fit_frame(pairs.time_s, pairs.lean_a, pairs.lean_b)
    offset = float(angles.mean(angles.difference(pairs.recorded_b, pairs.recorded_a)))
    sigma = clock.heading_error_deg(pairs.rate_deg_s)
    for _ in range(3):
        difference = angles.difference(simulated_heading(pairs, offset, frame), pairs.recorded_b)
        series = frames.fit_difference(pairs.time_s, pairs.recorded_b, difference, sigma)
        if abs(series.coefficients[0]) < 1e-4:
            break
        offset = float(angles.wrap180(offset - series.coefficients[0]))
    return _make_calibration(pairs, clock, frame, offset, difference, series, warnings)


def read_head(path: str | Path, settings: Mapping[str, Any], which: int) -> Record:
    """Read the record of one head, 0 for a and 1 for b."""
    given = {key: settings.get(key) for key in ("orientation", "declination_applied", "heading_alignment")}
    return pd0.read([Path(path)], **{k: x[which] if isinstance(x, list | tuple) else x for k, x in given.items()})


def setting(settings: Mapping[str, Any], key: str, default: float) -> Any:
    """Look up a key of the settings, with a default if it is absent or null."""
    value = settings.get(key)
    return default if value is None else value


def overlap_in_time(a: Motion, b: Motion, max_offset_s: float) -> bool:
    """Return whether two heads measured at the same time, for a largest clock offset in seconds."""
    return bool(max(a.time_s[0], b.time_s[0] - max_offset_s) < min(a.time_s[-1], b.time_s[-1] + max_offset_s))


def known_clock_offset(b: Motion, offset_s: float) -> ClockDifference:
    """Make a clock difference from a known offset of b's clock, seconds."""
    middle = float(b.time_s[0] + b.time_s[-1]) / 2.0
    return ClockDifference(offset_s=offset_s, sigma_s=RESOLUTION_S, middle_s=middle)


def pair_samples(a: Motion, b: Motion, clock: ClockDifference) -> PairedHeads:
    """Interpolate a to the times of b, converted to a's clock."""
    at = clock.by_a(b.time_s)
    heading, lean, rate = a.heading.at(at), motion.GapSpline(a.time_s, a.lean).at(at), a.heading.at(at, 1)
    known = np.isfinite(heading) & np.isfinite(lean)
    recorded = angles.wrap360(heading[known])
    return PairedHeads(b.time_s[known], recorded, b.recorded_deg[known], lean[known], b.lean[known], rate[known])


def simulated_heading(pairs: PairedHeads, offset_deg: float, frame: Frame) -> Floats:
    """Simulate b's heading, (n,) degrees, from a's by a rigid rotation with b's forward axis clockwise by an offset."""
    if frame.verdict in ("mirrored", "not rigid"):
        return angles.wrap360(pairs.recorded_a + offset_deg)
    rotation = frames.upright(offset_deg, pairs.lean_a, pairs.lean_b)
    return frames.turned_heading(pairs.recorded_a, pairs.lean_a, rotation)


def _refused(n: int, why: str, warnings: tuple[str, ...], coverage: int = 0) -> Calibration:
    return Calibration(kind=KIND, model="none", n=n, coverage=coverage, why=why, warnings=warnings)


def _make_calibration(
    pairs: PairedHeads,
    clock: ClockDifference,
    frame: Frame,
    offset_deg: float,
    difference_deg: Floats,
    series: HeadingDifference,
    warnings: tuple[str, ...],
) -> Calibration:
    """Compose the result of a rigid rotation by an offset and the series fitted to the difference that remains."""
    points = {
        "time_s": pairs.time_s,
        "recorded_a_deg": pairs.recorded_a,
        "recorded_deg": pairs.recorded_b,
        "deviation_deg": difference_deg,
        "residual_deg": series.residual_deg,
        "kept": series.used.astype(float),
    }
    spikes, rms, coverage = (
        int(np.sum(~series.used)),
        angles.rms(series.residual_deg[series.used]),
        int(series.covered.sum()),
    )
    warnings += (*AMBIGUITY, *_warnings(pairs, clock, frame, series, spikes))
    if rms > UNRELATED_DEG:
        why = (
            f"b's headings do not follow a's ({rms:.0f}° rms about any constant turn): these heads do not stand on one "
            "frame, or their clocks are farther apart than max_clock_seconds"
        )
        return replace(_refused(len(pairs), why, warnings, coverage), points=points)
    # Refused terms are NaN; A is 0 by definition.
    coefficients, covariance = np.full(5, np.nan), np.full((5, 5), np.nan)
    coefficients[: series.terms] = series.coefficients
    coefficients[0] = 0.0
    covariance[: series.terms, : series.terms] = series.covariance
    stated = {name: getattr(clock, field) for name, field in CLOCK.items()}
    return Calibration(
        kind=KIND,
        model=f"rigid turn, then series in b's recorded heading: {frames.TERM_NAMES[series.terms]}",
        n=int(series.used.sum()),
        coverage=coverage,
        coefficients=coefficients if series.terms > 1 else np.zeros(0),
        covariance=covariance if series.terms > 1 else np.zeros(0),
        residual_rms_deg=rms,
        sources=_sources(pairs, clock, frame, series, rms),
        table=frames.deviation_table(series, np.arange(0.0, 360.0, 10.0)),
        points=points,
        details={
            "offset_deg": offset_deg,
            "offset_sigma_deg": float(np.sqrt(series.covariance[0, 0])),
            "clock": {name: list(x) if isinstance(x, tuple) else x for name, x in stated.items()},
            "frame": {
                "verdict": frame.verdict,
                "text": frame.text,
                "residual_rms_deg": frame.rms_deg,
                "rotation": frame.rotation.tolist(),
            },
            "terms": series.terms,
            "refused": series.refused,
            "covered": frames.stretches_deg(series.covered),
            "n_effective": series.n_effective,
            "stretches": series.stretches,
            "spikes": spikes,
            "cannot_tell": list(AMBIGUITY),
        },
        why="" if series.terms > 1 else series.refused,
        warnings=warnings,
    )


def _sources(
    pairs: PairedHeads, clock: ClockDifference, frame: Frame, series: HeadingDifference, scatter_deg: float
) -> tuple[Source, ...]:
    table_sigma = frames.deviation_table(series, pairs.recorded_b).sigma_deg
    sampling = float(np.sqrt(max(float(np.nanmean(table_sigma**2)) - series.structure_deg**2, 0.0)))
    by_clock = float(abs(np.mean(clock.heading_error_deg(pairs.rate_deg_s))))
    lever = float(np.sqrt(np.mean(np.abs(np.tan(np.abs(pairs.lean_a))) ** 2)))
    how = f"jackknife over {series.stretches} stretches, the clocks' part below included"
    if series.refused:
        how += f"; refused terms assumed {frames.ALLOWANCE_DEG.tolist()}° (B, C, D, E)"
    return (
        Source("fit", sampling, how),
        Source("structure", series.structure_deg, "rms by sectors of 10° of what the series leaves, beyond noise"),
        Source("one reading", scatter_deg, "scatter of single differences, both compasses"),
        Source("clocks", by_clock, "standard uncertainty of the offset times the mean rate of turn"),
        Source("tilts", lever * frame.rms_deg, "what is left of the tilts, times the tangent of the tilt"),
        Source("resolution", 0.01 / np.sqrt(12.0), "PD0 headings count hundredths of a degree: uniform"),
    )


def _warnings(
    pairs: PairedHeads, clock: ClockDifference, frame: Frame, series: HeadingDifference, spikes: int
) -> list[str]:
    gain = f"{clock.drift_s_per_day:+.2f} ± {clock.drift_sigma_s_per_day:.2f} s a day"
    where = frames.stretches_deg(series.covered)
    return applicable(
        {
            series.refused: series.refused,
            "a refused term is not zero: its possible leakage into the fitted terms and into offset_deg is included in "
            "their uncertainty, with assumed standard deviations of 5° (B, C) and 2° (D, E)": series.refused,
            f"offset_deg is the mean difference over {where}; elsewhere the difference may differ": series.terms == 1,
            frame.text: frame.verdict != "rigid",
            f"b's clock gains {gain} on a's; this is corrected": clock.drift_applied,
            f"the differences are autocorrelated: effective sample size {series.n_effective:.0f} of {len(pairs)}; the "
            f"uncertainty rests on {series.stretches} blocks": series.stretches == frames.MIN_STRETCHES,
            f"{spikes} of {len(pairs)} differences are spikes and excluded": spikes > 0,
            "the heads sample too rarely to resolve a clock error of seconds": motion.step(pairs.time_s) > 600.0,
        }
    )
