"""Diagnose two heads on one frame: the heading of b against that of a, rigidly rotated, after aligning the clocks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import angles
from compasslib.calibrations import two_heads
from compasslib.calibrations.two_heads import motion
from compasslib.calibrations.two_heads.motion import ClockDifference, Motion, PairedHeads
from compasslib.effects.effect import Effect, turning_scene
from compasslib.effects.forward import COMPASS_STEPS
from compasslib.effects.iron import HardIronStep, HardIronTrend, Heeling, LevelHardIron, LevelSoftIron
from compasslib.effects.readout import CompassDelay
from compasslib.effects.reference import ClockDrift, ClockOffset
from compasslib.inference import diagnosis, finding, short_search
from compasslib.inference.comparison import Options, build_finding, equal_chances
from compasslib.inference.diagnosis import Diagnosis
from compasslib.inference.finding import Finding, HeldOut, Parameter
from compasslib.inference.kinds.platform import READOUT, CurveResidual, recording_scene, thin_indices
from compasslib.inference.short_model import FINEST_DEG, MOST_BLOCKS, ShortComparison
from compasslib.inference.short_search import build_outcome
from compasslib.statistics.least_squares import robust_width
from compasslib.statistics.resampling import blocks_by_count

TERMS: tuple[type[Effect], ...] = (
    *READOUT, CompassDelay, HardIronStep, HardIronTrend, Heeling, LevelHardIron, LevelSoftIron
)  # fmt: skip
NO_DIFFERENCE = ClockDifference()
LAGS_S = (-8.0, -4.0, -2.0, -1.0, 1.0, 2.0, 4.0, 8.0)  # starting values of a lag, since the misfit has several minima
UNTESTED = (
    ("declination_error", "a constant of either compass cannot be separated from the mounting angle"),
    ("field_disturbance", "it acts on both compasses alike and cancels in their difference"),
    ("secular_variation", "it acts on both compasses alike and cancels in their difference"),
    ("temperature", "the heads' temperatures are those of the same water"),
)


def diagnose(files: Sequence[str | Path], settings: Mapping[str, Any], options: Options) -> Diagnosis:
    """Diagnose the heading difference of two heads, of PD0 files a and b, against a rigid rotation.

    Raises:
        InputError: not two files, or one that cannot be read.
    """
    a, b = two_heads.read_heads(files, settings)
    farthest = float(two_heads.setting(settings, "max_clock_seconds", two_heads.MAX_CLOCK_OFFSET_S))
    start, end = (two_heads.setting(settings, *edge) for edge in (("start_s", -np.inf), ("end_s", np.inf)))
    known = float(two_heads.setting(settings, "clock_offset_seconds", 0.0))
    reach = max(farthest, motion.DAY_S)
    second = motion.extract_motion(b, start + known - reach, end + known + reach)
    second = replace(second, time_s=second.time_s - known)
    first = motion.extract_motion(a, start, end)
    return diagnose_motion(first, second, farthest_s=farthest, field=settings.get("field"), options=options)


def diagnose_motion(
    a: Motion, b: Motion, *, farthest_s: float, field: Mapping[str, float] | None, options: Options
) -> Diagnosis:
    """Diagnose two heads by their own clocks, which may differ by ``farthest_s``, of unrelated ones by a day."""
    pairs, clock, count = None, NO_DIFFERENCE, min(len(a.time_s), len(b.time_s))
    if count >= two_heads.MIN_SAMPLES:
        pairs, clock = _align(a, b, farthest_s)
        count = len(pairs)
    if pairs is None or count < two_heads.MIN_SAMPLES:
        why = f"{count} usable samples of both heads at the same time, at least {two_heads.MIN_SAMPLES} are needed"
        return diagnosis.insufficient(why, UNTESTED)
    if (off := _scatter(pairs)) > two_heads.UNRELATED_DEG:
        why = (
            f"b's headings do not follow a's ({off:.0f}° rms about any turn), and no difference of the clocks "
            "up to a day makes them: the heads do not stand on one frame, or did not measure together"
        )
        return diagnosis.insufficient(why, UNTESTED)
    given, compared = motion.pair_samples(a, b, NO_DIFFERENCE), _compare(pairs, clock, a, field)
    missing = () if clock.determined else (("clock_offset", "headings and tilts hardly change together"),)
    return diagnosis.combine_outcomes(
        [build_outcome(short_search.search_effects(compared, options), options.min_effect_deg)],
        options,
        extra=_clock_findings(given, pairs, clock, compared, options.min_effect_deg),
        not_testable=(*UNTESTED, *missing),
        separated_by="which of the two heads is wrong: a third compass, or a swing of either head",
    )


def _align(a: Motion, b: Motion, farthest_s: float) -> tuple[PairedHeads, ClockDifference]:
    """Align both heads by their clocks, extending the search to a day if the headings remain unrelated."""
    tried = []
    for reach_s in (farthest_s, motion.DAY_S):
        overlap = motion.overlap_in_time(a, b, reach_s)
        clock = motion.estimate_clock_offset(a, b, reach_s) if overlap else NO_DIFFERENCE
        tried.append((motion.pair_samples(a, b, clock), clock))
        if len(tried[-1][0]) >= two_heads.MIN_SAMPLES and _scatter(tried[-1][0]) <= two_heads.UNRELATED_DEG:
            return tried[-1]
    return tried[0]


def _scatter(pairs: PairedHeads) -> float:
    """Compute the rms of the difference about its mean, degrees."""
    off = angles.difference(pairs.recorded_b, pairs.recorded_a)
    return angles.rms(angles.difference(off, float(angles.mean(off))))


def _compare(
    pairs: PairedHeads, clock: ClockDifference, a: Motion, field: Mapping[str, float] | None
) -> ShortComparison:
    frame = two_heads.fit_frame(pairs.time_s, pairs.lean_a, pairs.lean_b)
    offset = float(angles.mean(angles.difference(pairs.recorded_b, pairs.recorded_a)))
    samples = thin_indices(len(pairs))
    pitch, roll = (tilt[samples] for tilt in motion.tilt_angles(pairs.lean_b))
    time_s, rate, recorded = pairs.time_s[samples], pairs.rate_deg_s[samples], pairs.recorded_b[samples]
    scene, unit = recording_scene(time_s, field, tilt_deg=(pitch, roll), departures={"turn_rate": rate})
    at = clock.by_a(time_s)
    scene = turning_scene(scene, lambda ahead_s: np.nan_to_num(a.heading.at(at + ahead_s) - a.heading.at(at)))
    correct = two_heads.simulated_heading(pairs, offset, frame)[samples]
    return ShortComparison(
        what="the heading of b against that of a, rigidly turned",
        residual=CurveResidual(correct, recorded, scene, exact=True),
        start=np.zeros(5),
        steps=COMPASS_STEPS * (np.arange(5) == 0),  # only the angle between the heads is free
        time_s=time_s,
        terms=TERMS,
        covariates={"heading": recorded, "time": time_s, "pitch": pitch, "roll": roll, "turn_rate": rate},
        field_unit=unit,
        starts={"compass_lag": LAGS_S},
    )


def _clock_findings(
    given: PairedHeads, pairs: PairedHeads, clock: ClockDifference, heads: ShortComparison, min_effect_deg: float
) -> list[Finding]:
    """Build the clock findings that are significant and change the simulated heading by the minimum size or more."""
    if not clock.determined:
        return []
    grown = (pairs.time_s - clock.middle_s) / motion.DAY_S * clock.drift_s_per_day * clock.drift_applied
    proof = _clock_gain(given, pairs)
    alone = () if np.isfinite(clock.from_tilts_s[0]) else ("compass_lag",)
    compared, findings = replace(heads, what="the clock of b against that of a"), []
    for term, name, value, sigma, unit, error_s in (
        (ClockOffset(), "offset_s", clock.offset_s, clock.sigma_s, "s", clock.offset_s),
        (ClockDrift(), "drift_s_day", clock.drift_s_per_day, clock.drift_sigma_s_per_day, "s/day", grown),
    ):
        # Rate of turn times a large error overestimates the turn: limit it by the rms before the correction.
        size = min(angles.rms(pairs.rate_deg_s * error_s), max(proof.rms_before_deg, min_effect_deg))
        if abs(value) > finding.NAMED_SIGMAS * sigma and size >= min_effect_deg:
            chances, parameter = equal_chances(term.name, *alone), {name: Parameter(value, sigma, unit)}
            place = compared.where("turn_rate")
            findings.append(build_finding(compared, term, chances, parameter, size_deg=size, proof=proof, place=place))
    return findings


def _clock_gain(given: PairedHeads, corrected: PairedHeads) -> HeldOut:
    """Score the estimated clock by the heading difference, which does not itself enter the estimate."""
    both = given, corrected
    same, *at = np.intersect1d(given.time_s, corrected.time_s, return_indices=True)
    if len(same) < two_heads.MIN_SAMPLES:
        rms_deg = [_scatter(pairs) if len(pairs) >= two_heads.MIN_SAMPLES else float("nan") for pairs in both]
        return HeldOut(rms_deg[0], rms_deg[1], 0.0, (0.0, 0.0), 1.0)
    turned = [angles.difference(x.recorded_b, x.recorded_a)[k] for x, k in zip(both, at, strict=True)]
    before, after = (angles.difference(off, float(angles.mean(off))) for off in turned)
    width = max(robust_width(before), FINEST_DEG)
    return finding.compare_residuals(before, after, width, blocks_by_count(same, MOST_BLOCKS))
