"""Find slow changes in an observatory's series: a trend beyond the field model, and jumps of its baseline.

Records of at least some weeks are analysed by the general search with the two applicable terms. Shorter ones show no
trend; a jump in them is a change of level whose residual contains no storm.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from compasslib import angles
from compasslib.calibrations import observatory
from compasslib.calibrations.observatory import FieldComparison
from compasslib.effects import Scene
from compasslib.effects.earth import SecularVariation
from compasslib.effects.effect import YEAR_S
from compasslib.effects.forward import ForwardModel
from compasslib.effects.readout import HeadingSlip
from compasslib.inference import comparison, wording
from compasslib.inference import finding as findings
from compasslib.inference.comparison import LongComparison
from compasslib.inference.finding import BinnedResidual, CovariateRange, Finding, HeldOut, Parameter, Unexplained
from compasslib.records import EarthField, FieldSeries, iso_time
from compasslib.statistics.least_squares import robust_width
from compasslib.statistics.resampling import blocks_by_span
from compasslib.types import Floats

Jumps = tuple[tuple[float, float], ...]  # (date, rise of the series in degrees)

HOURS_OF_YEARS = 3.0  # years above which daily instead of hourly means are searched
DAILY_HARMONICS = range(1, 5)  # of the quiet day
PRECISION_DEG = 0.01  # least width of the residual: resolution of a published declination
NEAR_S = 3 * observatory.DAY_S  # reach of the finer search for a jump's date
LEAST_SIDE_S = 3 * observatory.HOUR_S  # least duration of either level of a jump in a short record
LEAST_AFTER_S = observatory.DAY_S  # duration of a level beyond which it is no storm
MODEL_TREND_SHARE = 0.25  # relative difference up to which a trend is that of the model
FEWEST_PIECES = 6  # of 27 days, for a trend
LEAST_COVERED = 0.5  # share of days with data, below which the general search cannot estimate slow noise
LEVELS = 5  # days on either side whose median shows a large jump
LARGE_JUMP_RATIO = 8.0  # least change of the level at a large jump, in robust widths
DRIFTS = "the declination drifts beyond the simulation, and so its constant depends on the date"
TREND_SIGMAS = 5.0  # least trend through pieces, in standard errors
LEAST_STEADY = 0.5  # largest three-hour residual after a jump, relative to the limit


def jump_text(jump: tuple[float, float], sigma_deg: float, proof: HeldOut, alternatives: Sequence[str]) -> str:
    """Describe a jump of the baseline.

    Args:
        jump: date, and rise of the declination in degrees.
        proof: score on held-out days.
    """
    others = f" This record cannot separate it from {wording.join_names(alternatives)}." if alternatives else ""
    return (
        f"From {iso_time(jump[0])} on the declination is {jump[1]:+.2f} ± {1.96 * sigma_deg:.2f} degrees (95 %) "
        f"off what it was: the baseline jumped, as where a sensor turned. The residual goes from "
        f"{proof.rms_before_deg:.2f}° to {proof.rms_after_deg:.2f}° rms (p = {proof.p_value:.3g}).{others}"
    )


def trend_text(slope: Parameter, finding: Finding, model_slope: float | None, alternatives: Sequence[str]) -> str:
    """Describe a trend.

    Args:
        slope: degrees per year.
        model_slope: trend of IGRF if it explains the slope, degrees per year.
    """
    as_model = "" if model_slope is None else f" IGRF has {model_slope:+.3f} there: the given declination is constant."
    others = f" This record cannot separate it from {wording.join_names(alternatives)}." if alternatives else ""
    return (
        f"The declination moves by {slope.value:+.3f} ± {1.96 * slope.sigma:.3f} degrees a year (95 %) beyond the "
        f"simulation, {finding.rms_effect_deg:.2f}° rms over the record.{as_model} On held-out days the "
        f"residual goes from {finding.held_out.rms_before_deg:.2f}° to {finding.held_out.rms_after_deg:.2f}° rms "
        f"(p = {finding.held_out.p_value:.3g}).{others}"
    )


@dataclass(frozen=True)
class SlowFindings:
    """Slow changes found in a series, and effects that could not be tested."""

    findings: tuple[Finding, ...] = ()
    jumps: Jumps = ()
    unexplained: Unexplained | None = None
    negligible: tuple[tuple[str, float], ...] = ()
    not_testable: tuple[tuple[str, str], ...] = ()
    curves: tuple[BinnedResidual, ...] = ()
    threshold: Mapping[str, float] = field(default_factory=dict)


def remove_jumps(series: FieldSeries, jumps: Jumps) -> FieldSeries:
    """Subtract jumps from a series."""
    risen = np.sum([size * (series.time_s >= date) for date, size in jumps], axis=0) if jumps else 0.0
    return replace(series, declination_deg=angles.wrap180(series.declination_deg - risen))


def compare_series(compared: FieldComparison, model: EarthField) -> LongComparison:
    """Build the comparison for the general search: a compass at rest while magnetic north moves."""
    years = float(np.ptp(compared.time_s)) / YEAR_S
    step = observatory.HOUR_S if years < HOURS_OF_YEARS else observatory.DAY_S
    number, which = np.unique(np.floor(compared.time_s / step), return_inverse=True)
    off = np.bincount(which, compared.residual_deg - compared.constant_deg - compared.quiet_deg) / np.bincount(which)
    time_s = (number + 0.5) * step
    n = len(time_s)
    still = np.zeros(n)
    # A constant field: C is scaled by 1/H, and a column that drifts with H would absorb the trend.
    h, z = (np.full(n, np.mean(x)) for x in (model.horizontal_nT, model.vertical_nT))
    hour = 15.0 * (time_s / observatory.HOUR_S % 24.0)
    waves = [x for k in DAILY_HARMONICS for x in angles.sin_cos(k * hour)] if step < observatory.DAY_S else []
    return LongComparison(
        time_s=time_s,
        simulation=ForwardModel(np.zeros(5), float(h[0])),
        scene=Scene(time_s, h, z, still, still, float(time_s[0])),
        recorded_deg=still,
        observed_deg=off,
        slowness=still,
        expected_deg=np.full(n, PRECISION_DEG),
        precision_deg=PRECISION_DEG,
        covariates={"time": time_s},
        nuisance=np.column_stack(waves) if waves else np.zeros((n, 0)),
        terms=(SecularVariation, HeadingSlip),
        has_slow_noise=False,
    )


def why_too_short(compared: FieldComparison) -> str:
    """Explain why a series is too short for slow changes; empty if it is not."""
    days = float(np.ptp(compared.time_s)) / observatory.DAY_S
    hours = len(np.unique(np.floor(compared.time_s / observatory.HOUR_S)))
    if days >= comparison.SHORTEST_DAYS and hours >= comparison.FEWEST_PAIRS:
        return ""
    return (
        f"the series has {hours} hours over {days:.0f} days; {comparison.FEWEST_PAIRS} hours over "
        f"{comparison.SHORTEST_DAYS:.0f} days are needed for what is slow"
    )


def trend_of_pieces(
    compared: FieldComparison, series: FieldSeries, model: EarthField, limit_deg: float
) -> SlowFindings:
    """Fit a trend to 27-day medians of a record that is mostly gaps, where jumps are not testable."""
    missing = (("heading_slip", "most of the record is gaps: a jump in one looks like a trend or like nothing"),)
    number = np.unique(np.floor(compared.time_s / observatory.DAY_S / observatory.BLOCK_DAYS), return_inverse=True)[1]
    years = (compared.time_s - compared.time_s[0]) / YEAR_S
    off = compared.residual_deg
    middle = np.array([(np.median(years[number == k]), np.median(off[number == k])) for k in range(number[-1] + 1)])
    if len(middle) < FEWEST_PIECES:
        why = f"the series has {len(middle)} stretches of 27 days; {FEWEST_PIECES} are needed for a trend"
        return SlowFindings(not_testable=(("secular_variation", why), *missing))
    about = middle[:, 0] - middle[:, 0].mean()
    slope = float(about @ middle[:, 1] / (about @ about))
    remainder = middle[:, 1] - middle[:, 1].mean() - slope * about
    sigma = float(np.sqrt(remainder @ remainder / (len(remainder) - 2) / (about @ about)))
    size = float(abs(slope) * np.std(years))
    if abs(slope) <= TREND_SIGMAS * sigma:
        return SlowFindings(not_testable=missing)
    if size < limit_deg:
        return SlowFindings(not_testable=missing, negligible=(("secular_variation", size),))
    before, left = (x - np.median(x) for x in (off, off - slope * years))
    proof = findings.compare_residuals(
        before, left, angles.rms(left), blocks_by_span(compared.time_s, findings.HELD_OUT_BLOCK_S)
    )
    span = (float(compared.time_s[0]), float(compared.time_s[-1]))
    place = CovariateRange("time", *span, f"from {iso_time(span[0])} to {iso_time(span[1])}")
    parameters = {"deg_year": Parameter(slope, sigma, "degrees/year")}
    made = Finding("secular_variation", "compass", ("heading_slip",), place, span, parameters, size, proof, "")
    return SlowFindings(
        (reword_finding(made, series, model, None),), not_testable=(*missing, ("declination_error", DRIFTS))
    )


def reword_finding(
    finding: Finding, series: FieldSeries, model: EarthField, jump: tuple[float, float] | None
) -> Finding:
    """Reword a finding of the general search for an observatory, with its alternatives."""
    assert finding.when_s is not None  # an observatory has a clock
    if jump is not None:
        sigma = next(iter(finding.parameters.values())).sigma
        size = {"offset_deg": Parameter(-jump[1], sigma, "degrees")}
        text = jump_text(jump, sigma, finding.held_out, finding.alternatives)
        span = (jump[0], finding.when_s[1])
        return replace(finding, parameters=size, when_s=span, text=text, applied=False)
    trend = finding.parameters["deg_year"]
    by_model = float(np.ptp(model.model_declination_deg)) / max(float(np.ptp(model.time_s)) / YEAR_S, 1e-9)
    slope = float(np.copysign(by_model, model.model_declination_deg[-1] - model.model_declination_deg[0]))
    as_model = model.source != "IGRF" and abs(trend.value - slope) <= MODEL_TREND_SHARE * abs(slope)
    known = as_model or series.definitive
    others = (
        ()
        if as_model
        else finding.alternatives
        if known
        else (*dict.fromkeys((*finding.alternatives, "compass_drift")),)
    )
    text = trend_text(trend, finding, slope if as_model else None, others)
    return replace(finding, alternatives=others, text=text, applied=False)


def date_jump(compared: FieldComparison, finding: Finding) -> tuple[float, float]:
    """Refine the date of a jump found by the search; the rise of the series is that of the finding."""
    assert finding.when_s is not None  # an observatory has a clock
    near = np.abs(compared.time_s - finding.when_s[0]) <= NEAR_S
    time_s, off = compared.time_s[near], (compared.residual_deg - compared.quiet_deg)[near]
    size = -next(iter(finding.parameters.values())).value
    if len(off) < 4:
        return finding.when_s[0], size
    at, _, _ = _best_split(off, 2)
    return float(time_s[at]) - compared.step_s / 2.0, size


def _best_split(off: Floats, least: int) -> tuple[int, float, Floats]:
    """Find the best change of level of a series: its index, its size, and the residual from the two levels."""
    splits = range(least, len(off) - least + 1, max(1, len(off) // 600))
    spread = [np.sum(np.abs(part - np.median(part))) for k in splits for part in (off[:k], off[k:])]
    at = splits[int(np.argmin(np.add(spread[::2], spread[1::2])))]
    low, high = np.median(off[:at]), np.median(off[at:])
    return at, float(high - low), np.concatenate([off[:at] - low, off[at:] - high])


def short_jump(compared: FieldComparison, limit_deg: float) -> tuple[Finding, tuple[float, float]] | None:
    """Find the jump of a short record, if the residual from two levels contains no storm."""
    off = compared.residual_deg - compared.quiet_deg
    least = int(LEAST_SIDE_S / compared.step_s)
    if len(off) < 2 * least + 2:
        return None
    at, size, left = _best_split(off, least)
    # The rms without the largest value, since the jump may fall into one mean.
    remainder = float(observatory.three_hour_rms(compared.time_s, left)[1].max())
    if abs(size) < limit_deg or remainder >= LEAST_STEADY * limit_deg:
        return None
    date, last = float(compared.time_s[at]) - compared.step_s / 2.0, float(compared.time_s[-1])
    others = ("field_disturbance",) if min(last - date, date - compared.time_s[0]) < LEAST_AFTER_S else ()
    sigma = angles.rms(left) / np.sqrt(min(at, len(off) - at) * compared.step_s / observatory.WINDOW_S)
    return _jump(compared, (date, size), sigma, others), (date, size)


def large_jumps(compared: FieldComparison, limit_deg: float) -> list[tuple[Finding, tuple[float, float]]]:
    """Find jumps much larger than other changes of the daily levels, which the search would clip as outliers.

    The median change from five days to the next five is subtracted first: a trend is no jump.
    """
    begins = np.unique(np.floor(compared.time_s / observatory.DAY_S), return_index=True)[1]
    off = compared.residual_deg - compared.quiet_deg
    levels = np.array([np.median(part) for part in np.split(off, begins[1:])])
    if len(levels) < 4 * LEVELS:
        return []
    middle = np.median(np.lib.stride_tricks.sliding_window_view(levels, LEVELS), axis=1)
    change = middle[LEVELS:] - middle[:-LEVELS]
    change = change - np.median(change)
    usual = robust_width(change)
    jumps = []
    while len(change) and np.max(np.abs(change)) > max(limit_deg, LARGE_JUMP_RATIO * usual):
        at = int(np.argmax(np.abs(change)))
        around = slice(begins[at], begins[at + 2 * LEVELS] if at + 2 * LEVELS < len(begins) else len(off))
        split, size, left = _best_split(off[around], 2)
        date = float(compared.time_s[around][split]) - compared.step_s / 2.0
        sigma = angles.rms(left) * np.sqrt(2.0 / LEVELS)
        jumps.append((_jump(compared, (date, size), sigma, ()), (date, size)))
        change[max(at - 2 * LEVELS, 0) : at + 2 * LEVELS] = 0.0
    return jumps


def _jump(compared: FieldComparison, jump: tuple[float, float], sigma_deg: float, others: tuple[str, ...]) -> Finding:
    """Build the finding of one jump, scored by two levels against one on held-out stretches."""
    date, last, after = jump[0], float(compared.time_s[-1]), compared.time_s >= jump[0]
    off = compared.residual_deg - compared.quiet_deg
    unit = observatory.DAY_S if np.ptp(compared.time_s) > 10 * observatory.DAY_S else observatory.HOUR_S
    block = np.floor((compared.time_s - compared.time_s[0]) / unit).astype(int)
    before, left = np.array(off), np.array(off)
    for fold in (0, 1):
        before[block % 2 == fold] -= np.median(off[block % 2 != fold]) if np.any(block % 2 != fold) else np.median(off)
        for side in (after, ~after):
            out, fitted = side & (block % 2 == fold), side & (block % 2 != fold)
            if out.any() and fitted.any():
                left[out] = off[out] - np.median(off[fitted])
    width = max(angles.rms(left), PRECISION_DEG)
    proof = findings.bootstrap_gain(
        (before**2 - left**2) / (2.0 * width**2), block, (angles.rms(before), angles.rms(left))
    )
    share = float(np.mean(after))
    place = CovariateRange("time", date, last, f"from {iso_time(date)} on")
    return Finding(
        effect="heading_slip",
        side="compass",
        alternatives=others,
        where=place,
        when_s=(date, last),
        parameters={"offset_deg": Parameter(-jump[1], sigma_deg, "degrees")},
        rms_effect_deg=float(abs(jump[1]) * np.sqrt(share * (1.0 - share))),
        held_out=proof,
        text=jump_text(jump, sigma_deg, proof, others),
    )
