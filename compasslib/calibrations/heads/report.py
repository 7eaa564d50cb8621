"""What a comparison of two heads says of itself: numbers for the file, points for the figures, budget and sentences."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import numpy as np

from compasslib import angles
from compasslib.calibrations.heads import clock as heads_clock
from compasslib.calibrations.heads import series as heads_series
from compasslib.calibrations.heads.clock import ClockDifference
from compasslib.calibrations.heads.frame import Frame
from compasslib.calibrations.heads.motion import LEAST_STRETCHES, Compared, step, tilts
from compasslib.calibrations.heads.series import HeadingDifference
from compasslib.calibrations.result import Source
from compasslib.statistics import blocks, robust
from compasslib.types import Floats

SIGMAS, LEAST_CONSTANT_DEG = 2.0, 1.0
RARE_S = 600.0
SLIP_STRETCHES, SLIP_SIGMAS, SLIP_DEG = 24, 8.0, 1.0
CANNOT_TELL = (
    "The difference of two compasses does not tell which of them is wrong: the coefficients are b's against a's and "
    "are b's own only as far as a's compass is right.",
    "A is 0 by definition: a constant error of either compass and the mounting angle look the same in the headings. "
    "offset_deg holds both.",
)


def details(
    pairs: Compared, clock: ClockDifference, frame: Frame, series: HeadingDifference, offset: float
) -> dict[str, Any]:
    """Return what goes into the file beside the common fields.

    Args:
        pairs: both heads at b's instants.
        offset: of b's forward axis from a's by the headings, degrees.
    """
    return {
        **_offsets(frame, series, offset),
        "clock": _clock(clock),
        "frame": {
            "verdict": frame.verdict,
            "text": frame.text,
            "residual_rms_deg": frame.rms_deg,
            "tilt_variation_deg": frame.variation_deg,
            "rotation": frame.rotation.tolist(),
        },
        "terms": series.terms,
        "refused": series.refused,
        "variance_inflation": {str(k): v.tolist() for k, v in series.inflation.items()},
        "covered": heads_series.stretches_deg(series.covered),
        "turns": float(np.ptp(np.cumsum(angles.difference(pairs.recorded_a[1:], pairs.recorded_a[:-1]))) / 360.0),
        "n_effective": series.n_effective,
        "stretches": series.stretches,
        "spikes": int(np.sum(~series.kept)),
        "cannot_tell": list(CANNOT_TELL),
    }


def _offsets(frame: Frame, series: HeadingDifference, offset: float) -> dict[str, float | None]:
    constant, sigma = _constant(frame, series, offset)
    known = bool(np.isfinite(frame.offset_sigma_deg))
    return {
        "offset_deg": offset,
        "offset_sigma_deg": float(np.sqrt(series.covariance[0, 0])),
        "offset_sampling_sigma_deg": float(np.sqrt(series.sampling[0, 0])),
        "offset_from_tilts_deg": frame.offset_deg if known else None,
        "offset_from_tilts_sigma_deg": frame.offset_sigma_deg if known else None,
        "constant_difference_deg": constant if known else None,
        "constant_difference_sigma_deg": sigma if known else None,
    }


def _constant(frame: Frame, series: HeadingDifference, offset: float) -> tuple[float, float]:
    """Return the mounting angle by the tilts minus the offset by the headings, and its standard deviation."""
    sigma = float(np.hypot(frame.offset_sigma_deg, np.sqrt(series.covariance[0, 0])))
    return float(angles.difference(frame.offset_deg, offset)), sigma


def _clock(clock: ClockDifference) -> dict[str, Any]:
    return {
        "offset_s": clock.offset_s,
        "sigma_s": clock.sigma_s,
        "drift_s_per_day": clock.drift_s_per_day,
        "drift_sigma_s_per_day": clock.drift_sigma_s_per_day,
        "drift_applied": clock.drift_applied,
        "found": clock.found,
        "from_tilts_s": list(clock.from_tilts_s),
        "from_headings_s": list(clock.from_headings_s),
        "correlation_of_tilt_rates": clock.tilt_correlation,
        "correlation_of_heading_rates": clock.heading_correlation,
    }


def points(
    pairs: Compared, difference: Floats, offset: float, frame: Frame, series: HeadingDifference
) -> dict[str, Floats]:
    """Return the columns of what was observed, (n,) each.

    Args:
        pairs: both heads at b's instants.
        difference: a's heading, turned, minus b's, degrees.
        offset: of b's forward axis from a's by the headings, degrees.
    """
    pitch_a, roll_a = tilts(pairs.lean_a)
    pitch_b, roll_b = tilts(pairs.lean_b)
    return {
        "time_s": pairs.time_s,
        "recorded_a_deg": pairs.recorded_a,
        "recorded_b_deg": pairs.recorded_b,
        "simulated_b_deg": angles.wrap360(pairs.recorded_b + difference),
        "deviation_deg": difference,
        "offset_deg": offset - difference,
        "residual_deg": series.residual_deg,
        "kept": series.kept.astype(float),
        "pitch_a_deg": pitch_a,
        "roll_a_deg": roll_a,
        "pitch_b_deg": pitch_b,
        "roll_b_deg": roll_b,
        "tilt_residual_deg": frame.residual_deg,
        "turn_rate_deg_s": pairs.rate_deg_s,
    }


def sources(pairs: Compared, clock: ClockDifference, frame: Frame, series: HeadingDifference) -> tuple[Source, ...]:
    """Return the lines of the uncertainty budget.

    Args:
        pairs: both heads at b's instants.
    """
    there = heads_series.curve(series, pairs.recorded_b).sigma_deg
    fitted = float(np.sqrt(max(float(np.nanmean(there**2)) - series.structure_deg**2, 0.0)))
    by_clock = float(abs(np.mean(heads_clock.heading_error_deg(clock, pairs.rate_deg_s))))
    lever = float(np.sqrt(np.mean(np.abs(np.tan(np.abs(pairs.lean_a))) ** 2)))
    how = f"jackknife over {series.stretches} stretches, the clocks' part below included"
    if series.refused:
        how += f"; refused terms assumed {heads_series.ALLOWANCE_DEG.tolist()}° (B, C, D, E)"
    return (
        Source("fit", fitted, how),
        Source("structure", series.structure_deg, "rms by sectors of 10° of what the series leaves, beyond noise"),
        Source(
            "one reading", angles.rms(series.residual_deg[series.kept]), "scatter of single differences, both compasses"
        ),
        Source("clocks", by_clock, "standard uncertainty of the offset times the mean rate of turn"),
        Source("tilts", lever * frame.rms_deg, "what is left of the tilts, times the tangent of the tilt"),
        Source("resolution", 0.01 / np.sqrt(12.0), "PD0 headings count hundredths of a degree: uniform"),
    )


def warnings(
    pairs: Compared, clock: ClockDifference, frame: Frame, series: HeadingDifference, offset: float
) -> tuple[str, ...]:
    """Return what the reader of the result must know, in sentences.

    Args:
        pairs: both heads at b's instants.
        offset: of b's forward axis from a's by the headings, degrees.
    """
    tilts_say = [frame.text] if frame.verdict != "rigid" else []
    return (
        *CANNOT_TELL,
        *_of_terms(series),
        *tilts_say,
        *_of_constant(frame, series, offset),
        *_of_sampling(pairs, clock, series),
        *_slip(pairs.time_s, series),
    )


def _of_terms(series: HeadingDifference) -> list[str]:
    if not series.refused:
        return []
    leak = (
        "a refused term is not zero: what it may leak into the fitted ones and into offset_deg is in their "
        "uncertainty, with assumed standard deviations of 5° (B, C) and 2° (D, E)"
    )
    where = heads_series.stretches_deg(series.covered)
    only = f"offset_deg is the mean difference over {where}; elsewhere the difference may be another"
    return [series.refused, leak, only] if series.terms == 1 else [series.refused, leak]


def _of_constant(frame: Frame, series: HeadingDifference, offset: float) -> list[str]:
    apart, sigma = _constant(frame, series, offset)
    if not np.isfinite(sigma) or abs(apart) < max(SIGMAS * sigma, LEAST_CONSTANT_DEG):
        return []
    return [
        f"the tilts turn b by {frame.offset_deg:.1f}° ± {frame.offset_sigma_deg:.1f}° against a, the headings by "
        f"{offset:.1f}°: the constants of the compasses differ by {apart:+.1f}° ± {sigma:.1f}°, or the tilt sensors "
        "are turned in their housings"
    ]


def _of_sampling(pairs: Compared, clock: ClockDifference, series: HeadingDifference) -> list[str]:
    gain = f"{clock.drift_s_per_day:+.2f} ± {clock.drift_sigma_s_per_day:.2f} s a day"
    spikes = int(np.sum(~series.kept))
    sentences = {
        f"b's clock gains {gain} on a's; that was taken out": clock.drift_applied,
        f"the differences follow each other: {series.n_effective:.0f} of {len(pairs)} count, and the uncertainty rests "
        f"on {series.stretches} stretches": series.stretches == LEAST_STRETCHES,
        f"{spikes} of {len(pairs)} differences are spikes and were left out": spikes > 0,
        "the heads sample too rarely for a clock error of seconds to be seen": step(pairs.time_s) > RARE_S,
    }
    return [sentence for sentence, holds in sentences.items() if holds]


def _slip(time_s: Floats, series: HeadingDifference) -> list[str]:
    """Return the sentence on a step of the offset, if there is one far beyond what neighbouring stretches differ by."""
    stretch = blocks.in_time(time_s, SLIP_STRETCHES)[series.kept]
    count = np.bincount(stretch, minlength=SLIP_STRETCHES)
    if count.min() == 0:
        return []
    mean = -np.bincount(stretch, series.residual_deg[series.kept], SLIP_STRETCHES) / count
    noise = robust.width(np.diff(mean)) / np.sqrt(2.0)
    splits = np.arange(2, SLIP_STRETCHES - 1)
    steps = np.array([mean[k:].mean() - mean[:k].mean() for k in splits])
    sigma = noise * np.sqrt(1.0 / splits + 1.0 / (SLIP_STRETCHES - splits))
    worst = int(np.argmax(np.abs(steps) / np.maximum(sigma, 1e-9)))
    if abs(steps[worst]) < max(SLIP_DEG, SLIP_SIGMAS * sigma[worst]):
        return []
    when = datetime.fromtimestamp(float(time_s[0] + np.ptp(time_s) * splits[worst] / SLIP_STRETCHES), UTC)
    return [
        f"the offset changes by {steps[worst]:+.1f}° about {when:%Y-%m-%dT%H:%M}Z by b's clock: a head turned in its "
        "mount, or iron moved; calibrate the parts before and after apart"
    ]
