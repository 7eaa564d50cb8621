"""Agreement of the two instruments before and after correction, on held-out pairs.

Von Appen 2015, section 4, assesses the fit by histograms and a scatter plot of the fitted pairs themselves. Here the
record is divided into contiguous blocks of ten days (hourly currents decorrelate within a day or two; a record of less
than forty days is divided into four), and the model is fitted without some blocks and evaluated on these.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from compasslib import angles, compass
from compasslib.deviation import fit_deviation
from compasslib.deviation.correction import correct_headings, readings_at_pairs
from compasslib.deviation.exact import fit_exact
from compasslib.deviation.model import MIN_PAIRS, DeviationFit
from compasslib.preparation.clocks import nearest_index
from compasslib.records import BAD, PROBABLY_BAD, PROBABLY_GOOD, Pairs, Record, take
from compasslib.statistics import single_threaded
from compasslib.statistics.noise import effective_sample_size
from compasslib.statistics.resampling import NORMAL_95, blocks_by_span
from compasslib.types import DAY_S, Complexes, Floats

BLOCK_S = 10 * DAY_S  # of pairs held out together
FOLDS = 2
Counts = NDArray[np.int_]
BIN_DEG = 5.0  # of histograms.csv
BINS = round(360.0 / BIN_DEG)
# Lower edge of the first bin of each quantity in histograms.csv, degrees.
QUANTITIES = {
    "heading_recorded": 0.0,
    "heading_corrected": 0.0,
    "direction_recorded": 0.0,
    "direction_corrected": 0.0,
    "direction_reference": 0.0,
    "difference_before": -180.0,
    "difference_after": -180.0,
}
WATER = ("mean_of_bins", "predicted")  # expected rms error of one component at the reference's depth


def held_out_headings(pairs: Pairs, fit: DeviationFit) -> Floats:
    """Correct the heading of each pair by a fit to the other blocks that starts from that to all, (n,) degrees."""
    heading = np.full(len(pairs), np.nan)
    block = blocks_by_span(pairs.time_s, max(_block_length(pairs.time_s), 1.0)) % FOLDS
    for fold in range(FOLDS):
        left_out, training = block == fold, take(pairs, block != fold)
        again = fit_deviation(fit.method, training, near=fit)
        decision = correct_headings(readings_at_pairs(pairs), again, training)
        heading[left_out] = decision.heading_deg[left_out]
    return heading


def _block_length(time_s: Floats) -> float:
    return min(BLOCK_S, float(np.ptp(time_s)) / (2 * FOLDS)) if len(time_s) > 1 else BLOCK_S


@single_threaded()
def assess_correction(pairs: Pairs, fit: DeviationFit, plain: Pairs | None = None) -> dict[str, Any]:
    """Compose assessment.json: direction differences, upper minus lower, before and after correction, and currents.

    Args:
        plain: the pairs as the compass of the fit alone would have recorded them, where further effects acted; these
            effects are estimated from the whole record, not held out.
    """
    plain = pairs if plain is None else plain
    held_out = held_out_headings(plain, fit) if fit.fitted and len(pairs) else np.full(len(pairs), np.nan)
    known = np.isfinite(held_out)
    some = take(pairs, known)
    turned = angles.turn(some.upper_east, some.upper_north, held_out[known] - some.heading_deg)
    after = _agreement(*turned, some)
    before = _agreement(some.upper_east, some.upper_north, some)
    others = None  # least rms against the reference's directions of other days, given enough pairs
    if len(some) >= 200:
        upper, lower = angles.direction(*turned), angles.direction(some.lower_east, some.lower_north)
        shifts = (np.arange(1, 13) * len(upper) // 13).tolist()
        others = min(angles.rms(angles.difference(upper, np.roll(lower, shift))) for shift in shifts)
    shown = some if len(some) else pairs
    return {
        "before": _agreement(pairs.upper_east, pairs.upper_north, pairs),
        "before_where_corrected": before,
        "after": after,
        "difference_counts": {
            "before": count_differences(pairs.upper_east, pairs.upper_north, pairs),
            "after": count_differences(*turned, some),
        },
        "currents": {
            "recorded": _describe_current(shown.upper_east + 1j * shown.upper_north),
            "corrected": _describe_current(turned[0] + 1j * turned[1]),
            "reference": _describe_current(shown.lower_east + 1j * shown.lower_north),
        },
        "rms_of_other_days_deg": others,
        "water_error_m_s": None if pairs.expected_m_s is None else dict(zip(WATER, pairs.expected_m_s, strict=True)),
        "refuted": _refuted(after, others) or _worse(before, after) or _contradicted(plain, fit),
        "held_out": {"block_days": _block_length(pairs.time_s) / DAY_S, "folds": FOLDS, "n": len(some)},
    }


def _refuted(after: dict[str, Any], others_deg: float | None) -> str:
    """Explain why held-out pairs refute the correction; empty if they do not."""
    if after["n"] < 10:
        return ""
    check = "so that all headings are flagged doubtful; check instruments, clocks, columns, signs and units"
    rms = f"held-out pairs refute the correction: directions still differ by {after['rms_deg']:.0f}° rms"
    if others_deg is None and after["rms_deg"] > 75.0:  # slow water scatters by 42°
        return f"{rms} (unrelated ones by 104°), {check}"
    if others_deg is not None and 35.0 < after["rms_deg"] >= others_deg:  # about a mean flow even other days agree
        return f"{rms}, and by {others_deg:.0f}° from those of other days, {check}"
    return ""


def _worse(before: dict[str, Any], after: dict[str, Any]) -> str:
    """Report if held-out pairs agree significantly less after the correction than before; empty if they do not."""
    if not after["n"]:
        return ""
    sigma = float(np.hypot(before["rms_deg_sigma"], after["rms_deg_sigma"]))
    if after["rms_deg"] - before["rms_deg"] <= 2.0 * sigma:
        return ""
    return (
        f"on held-out pairs directions differ by {after['rms_deg']:.0f}° rms after the correction and by "
        f"{before['rms_deg']:.0f}° before: it makes them worse, and all headings are flagged doubtful; look for a time "
        "when the compass was wrong"
    )


def _contradicted(pairs: Pairs, fit: DeviationFit) -> str:
    """Report if the pairs show a significantly different compass than the given one; empty if they do not."""
    if not (fit.fitted and fit.known_beforehand and fit.covariance_known) or len(pairs) < 4 * MIN_PAIRS:
        return ""
    if not (refitted := fit_exact(pairs)).fitted:
        return ""
    # A is not compared: that of the pairs includes the mounting and the mean veer of the water.
    off = np.subtract(refitted.coefficients, fit.coefficients)[1:5]
    score = float(off @ np.linalg.solve(refitted.covariance[1:5, 1:5] + fit.covariance[1:5, 1:5], off))
    heading = np.arange(0.0, 360.0, 5.0)
    curves = (compass.recorded_heading(each.coefficients, heading) for each in (refitted, fit))
    apart = angles.difference(*curves)
    size = angles.rms(angles.difference(apart, angles.mean(apart)))
    if score < 28.5 or size < 3.0:  # chi-squared with 4 degrees of freedom, p = 1e-5
        return ""
    return (
        f"the overlapping measurements show a deviation that differs by {size:.0f}° rms from the given one, more than "
        "both uncertainties explain, so that all headings are flagged doubtful; check that it is of this compass and "
        "its mounting, or fit the pairs (fit: {method: exact})"
    )


def describe_assessment(name: str, verdict: dict[str, Any]) -> str:
    """Describe the assessment in a log line, with its warning."""
    before, after = verdict["before"], verdict["after"]
    if not after["n"]:
        return f"{name}: nothing to assess ({before['n']} pairs, none corrected)"
    line = (
        f"{name}: affected minus reference direction {before['rms_deg']:.1f}° rms before, {after['rms_deg']:.1f}° "
        f"after, on {after['n']} of {before['n']} pairs, each held out from its fit"
    )
    return f"{line}\n{name}: warning: {verdict['refuted']}" if verdict["refuted"] else line


def _agreement(east: Floats, north: Floats, pairs: Pairs) -> dict[str, Any]:
    if not len(pairs):
        nothing = ("mean_deg", "rms_deg", "median_absolute_deg", "interval_95", "vector_correlation")
        return {"n": 0} | dict.fromkeys(nothing)
    lower = angles.direction(pairs.lower_east, pairs.lower_north)
    off = angles.difference(angles.direction(east, north), lower)
    return {
        "n": len(pairs),
        "mean_deg": float(angles.wrap180(angles.mean(off))),
        "rms_deg": angles.rms(off),
        "rms_deg_sigma": angles.rms(off) / np.sqrt(2.0 * effective_sample_size(off, pairs.time_s)),
        "median_absolute_deg": float(np.median(np.abs(off))),
        "interval_95": confidence_intervals(off, pairs.time_s),
        "vector_correlation": vector_correlation(east + 1j * north, pairs.lower_east + 1j * pairs.lower_north),
    }


def confidence_intervals(off_deg: Floats, time_s: Floats) -> dict[str, tuple[float, float]]:
    """Compute 95 % intervals of circular mean, rms and median absolute value of autocorrelated differences.

    Args:
        off_deg: (n,), n > 0, in [-180, 180).
    """
    mean, squared = float(angles.wrap180(angles.mean(off_deg))), off_deg**2
    about, rms = angles.difference(off_deg, mean), angles.rms(off_deg)
    independent = min(effective_sample_size(about, time_s), effective_sample_size(squared, time_s))
    half = NORMAL_95 / np.sqrt(independent)
    spread = float(np.exp(half * squared.std() / max(2.0 * squared.mean(), 1e-12)))
    ends = {
        "mean_deg": (mean - half * angles.rms(about), mean + half * angles.rms(about)),
        "rms_deg": (rms / spread, rms * spread),
        "median_absolute_deg": np.quantile(np.abs(off_deg), np.clip([0.5 - half / 2.0, 0.5 + half / 2.0], 0.0, 1.0)),
    }
    return {name: (round(float(low), 4), round(float(high), 4)) for name, (low, high) in ends.items()}


def _describe_current(velocity: Complexes) -> dict[str, float] | None:
    """Describe mean and variance ellipse (principal axes) of a current east + i north, m/s; None without any."""
    if not velocity.size:
        return None
    mean = velocity.mean()
    power, pseudo = np.mean(np.abs(velocity - mean) ** 2), np.mean((velocity - mean) ** 2)
    axis = np.sqrt(complex(pseudo))  # half the angle of the pseudo-variance
    return {
        "east_m_s": round(float(mean.real), 6),
        "north_m_s": round(float(mean.imag), 6),
        "major_m_s": round(float(np.sqrt((power + np.abs(pseudo)) / 2.0)), 6),
        "minor_m_s": round(float(np.sqrt(max(power - np.abs(pseudo), 0.0) / 2.0)), 6),
        "major_towards_deg": round(float(angles.direction(axis.real, axis.imag)), 3),
        "n": int(velocity.size),
    }


def vector_correlation(a: NDArray[np.complex128], b: NDArray[np.complex128]) -> dict[str, float]:
    """Compute magnitude and angle of Kundu's complex correlation (J. Phys. Oceanogr. 6, 238, 1976)."""
    product = np.mean(a * np.conj(b)) / np.sqrt(np.mean(np.abs(a) ** 2) * np.mean(np.abs(b) ** 2))
    angle = -float(angles.wrap180(angles.argument(product)))  # clockwise positive: upper minus lower
    return {"magnitude": float(np.abs(product)), "angle_deg": angle}


def answer_use(
    diagnosis: Mapping[str, Any], flags: NDArray[np.integer], sigma_deg: Floats
) -> dict[str, str | float | None]:
    """Answer whether the corrected directions can be used: yes, with care, or no, by limits that are chosen."""
    known = np.isfinite(sigma_deg)
    sigma = float(np.median(sigma_deg[known])) if known.any() else None
    n = max(len(flags), 1)  # a record without samples has no good heading
    bad, unsure = 1.0 - np.sum(flags < PROBABLY_BAD) / n, np.isin(flags, (PROBABLY_GOOD, PROBABLY_BAD)).sum() / n
    verdict, left = diagnosis["verdict"], diagnosis["unexplained"]
    size = left["rms_effect_deg"] if left else 0.0
    why = {
        "consistent": "no further error of the compass was noticed",
        "explained": "no error beyond the identified effects was noticed",
        "unexplained": f"a mismatch of {size:.1f}° rms {left['where']['text'] if left else ''} is unexplained",
    }.get(verdict, diagnosis["why"].partition(". ")[0])
    no = {
        f"{100.0 * bad:.0f} % of the headings are doubtful or missing": bool(bad > 0.5),
        "the uncertainty does not cover the mismatch": bool(known.any() and size > 3.0 * angles.rms(sigma_deg[known])),
    }
    care = {
        f"{100.0 * unsure:.0f} % of the headings have flag 2 or 3": bool(unsure > 0.05),
        "σ exceeds 5°": (sigma or 0.0) > 5.0,
    }
    if verdict == "insufficient" or any(no.values()):
        answer, reasons = "no", no
    else:
        answer = "with care" if verdict in ("ambiguous", "unexplained") or any(care.values()) else "yes"
        reasons = care
    said = "; ".join([*(reason for reason, holds in reasons.items() if holds), *([why] if why else [])])
    limits = diagnosis["detectable_deg"].values()
    unseen = None if None in limits else max(limits, default=None)
    return {"answer": answer, "why": said, "sigma_deg": sigma, "unseen_deg": unseen}


# Histograms of headings and directions before and after the correction (von Appen 2015, Figs 8 and 9).


def count_angles(angle_deg: ArrayLike, from_deg: float = 0.0) -> Counts:
    """Count angles, without NaN, in bins of 5 degrees over one turn from a lower edge, (72,)."""
    angle = np.asarray(angle_deg, dtype=float)
    turn = angles.wrap360(angle[np.isfinite(angle)] - from_deg)
    return np.bincount((turn / BIN_DEG).astype(int), minlength=BINS)[:BINS]


def count_differences(east: Floats, north: Floats, pairs: Pairs) -> Counts:
    """Count the directions of a current at the pairs minus the reference's, (72,) from -180 degrees."""
    lower = angles.direction(pairs.lower_east, pairs.lower_north)
    return count_angles(angles.difference(angles.direction(east, north), lower), -180.0)


def directions_at_pairs(pairs: Pairs, time_s: Floats, heading_corrected_deg: Floats) -> tuple[Floats, Floats, Floats]:
    """Compute directions at each pair, (n,) degrees each: reference, affected as recorded, affected corrected.

    Args:
        time_s: times of the affected record, which include those of the pairs, (m,).
        heading_corrected_deg: corrected headings of that record, (m,); NaN where there is no correction.
    """
    lower = angles.direction(pairs.lower_east, pairs.lower_north)
    upper = angles.direction(pairs.upper_east, pairs.upper_north)
    if not (len(pairs) and len(time_s)):
        return lower, upper, np.full(upper.shape, np.nan)
    near = nearest_index(time_s, pairs.time_s)
    known = np.abs(time_s[near] - pairs.time_s) <= 60.0  # files round times
    turned = angles.difference(heading_corrected_deg[near], pairs.heading_deg)
    return lower, upper, angles.wrap360(np.where(known, upper + turned, np.nan))


def build_histograms(
    record: Record, heading_corrected_deg: Floats, pairs: Pairs, differences: Mapping[str, ArrayLike]
) -> dict[str, Counts]:
    """Count headings of the record, directions at the pairs and held-out differences (those of assessment.json)."""
    usable = np.where(record.heading_quality < BAD, record.heading_deg, np.nan)
    lower, upper, corrected = directions_at_pairs(pairs, record.time_s, heading_corrected_deg)
    counted = [count_angles(angle) for angle in (usable, heading_corrected_deg, upper, corrected, lower)]
    counted += [np.asarray(differences[when], dtype=int) for when in ("before", "after")]
    return dict(zip(QUANTITIES, counted, strict=True))
