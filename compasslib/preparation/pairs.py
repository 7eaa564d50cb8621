"""Pairs: where affected instrument and reference measured nearly the same water at nearly the same time.

The rules are those of von Appen 2015, section 2 and appendix: the mean of the first bins at the affected instrument,
the bins of the reference nearest to it, less than 20 minutes and 20 m apart, on an hourly grid. With ``predict``, the
mean is replaced by the velocity that the whole profile predicts at the reference's depth (``water``). Pairs that reveal
an input error (one record given twice, a wrong coordinate frame or unit) are rejected or come with a warning.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from compasslib import angles, earthfield
from compasslib.errors import InputError
from compasslib.preparation.clocks import ClockOffset, compare_speeds, grid_indices, interpolate_series, nearest_index
from compasslib.preparation.references import find_speed_changes
from compasslib.preparation.water import (
    delay_of_current,
    fails_speed_check,
    predict_water,
    usable_velocities,
    veer_of_nearest_bins,
)
from compasslib.records import BAD, PROBABLY_GOOD, EarthField, Pairs, Record, pieces, take
from compasslib.statistics import single_threaded
from compasslib.types import Complexes, Floats

NEARER_IN_SPEED = 0.7  # ratio of speed differences: 1.0 in the demonstration, 0.4 of eh2 with a depth 3.8 m off
ENOUGH = 30  # fewest pairs that show one recording, or a wrong frame
# By (sign, k): the frame of the upper velocities if lower + sign * upper + k * heading (directions) is constant.
OTHER_FRAMES = {
    (-1, 1): "turned back by the heading",
    (-1, -1): "turned by the heading",
    (1, -1): "mirrored and turned by the heading",
    (1, -2): "mirrored about the heading",
    (1, 0): "mirrored",
}
NOISE_M_S = 0.01  # below this a profiler's hourly velocity is noise


@dataclass(frozen=True)
class PairRules:
    """Criteria for overlapping measurements (config.yaml, ``overlap``)."""

    max_minutes: float = 20.0  #: largest difference in time, minutes
    max_metres: float = 20.0  #: largest difference in depth, m
    bins: int = 2  #: number of nearest bins that are averaged
    predict: bool = False  #: predict the velocity at the reference's depth from the profile instead of averaging bins
    grid_minutes: float = 60.0  #: step of the time grid, minutes
    grid_tolerance_minutes: float = 30.0  #: largest distance of a sample from its grid time, minutes


@dataclass(frozen=True)
class VelocitySeries:
    """One velocity per time, from one cell of an instrument, (k,) each, finite."""

    time_s: Floats
    velocity: Complexes  # east + i north, m/s
    depth_m: Floats


def widen_rules(rules: PairRules) -> PairRules:
    """Widen the depth limit for the comparison of clocks, which needs many pairs rather than close ones.

    Where the mooring is blown down, a clock error separates pairs in depth, and the normal limit would exclude them.
    """
    return replace(rules, max_metres=3.0 * rules.max_metres, predict=False)


def estimate_clock_offset(upper: Record, trusted: Sequence[Record], rules: PairRules) -> ClockOffset:
    """Estimate the clock offset from current speeds.

    Both records must be cut to the deployment; ``trusted`` may be empty.
    """
    if not (trusted and len(upper.time_s) and len(trusted[0].time_s)):
        return ClockOffset()
    upper = _gridded(upper, rules)
    velocity, depth = mean_of_nearest_bins(upper, _range_of_meter(upper, trusted[0], rules), rules.bins)
    cell = _trusted_cell(upper, depth, trusted[0], widen_rules(rules))
    return compare_speeds((upper.time_s, np.abs(velocity)), (cell.time_s, np.abs(cell.velocity)))


@single_threaded()
def find_pairs(
    upper: Record, trusted: Sequence[Record], field: EarthField, rules: PairRules, clocks: ClockOffset | None = None,
    *, several: bool = False,
) -> Pairs:  # fmt: skip
    """Find the overlapping measurements on the time grid, relative to true north; none without a reference.

    Raises:
        InputError: as ``check_pairs``, which ``several`` is for.
    """
    clocks = clocks or ClockOffset()
    recorded, tolerance_s = upper, 60.0 * rules.grid_tolerance_minutes
    lower = clocks.align(trusted[0]) if trusted else take(upper, np.zeros(0, dtype=np.intp))
    upper = _gridded(upper, rules)
    velocity, depth = mean_of_nearest_bins(upper, _range_of_meter(upper, lower, rules), rules.bins)
    cell = _trusted_cell(upper, depth, lower, rules)
    other, other_depth = (
        interpolate_series(cell.time_s, column, upper.time_s, tolerance_s=tolerance_s)
        for column in (cell.velocity, cell.depth_m)
    )
    minutes = np.full(len(upper.time_s), np.nan)
    if len(cell.time_s):
        minutes = (cell.time_s[nearest_index(cell.time_s, upper.time_s)] - upper.time_s) / 60.0
    close = (np.abs(minutes) < rules.max_minutes) & (np.abs(other_depth - depth) < rules.max_metres)
    usable = close & np.isfinite(velocity) & np.isfinite(other) & np.isfinite(upper.heading_deg)
    keep = np.flatnonzero(usable & (upper.heading_quality <= PROBABLY_GOOD) & (np.abs(velocity) > 0) & (abs(other) > 0))
    paired = take(upper, keep)
    declination = earthfield.declination_at(field, paired.time_s)
    top, bottom = _to_true(velocity[keep], paired, declination), _to_true(other[keep], lower, declination)
    pairs = _assemble(paired, top, bottom, (depth[keep], other_depth[keep], minutes[keep]), declination)
    if reason := find_identical_velocities(pairs):
        return replace(take(pairs, np.zeros(0, dtype=np.intp)), warnings=(reason,))
    doubts = ((angles.UNIFORM_SIGMA_DEG, clocks.uncorrelated),) if clocks.uncorrelated else ()
    heading = _heading(lower, pairs.time_s, tolerance_s)
    pairs = check_pairs(
        replace(pairs, warnings=clocks.warnings, lower_heading_deg=heading, doubts=doubts), recorded, trusted,
        several=several,
    )  # fmt: skip
    if not len(pairs):
        return pairs
    at_m = other_depth[keep]
    pairs = find_speed_changes(pairs, paired)
    apart_m = float(np.nanmedian(np.abs(pairs.lower_depth_m - pairs.upper_depth_m)))
    pairs = replace(pairs, delay_h=delay_of_current(paired, apart_m))
    pairs = replace(pairs, warnings=(*pairs.warnings, *_depth_by_speed(pairs, paired, at_m)))
    if rules.predict and (predicted := _predicted(pairs, paired, at_m, rules.bins)) is not None:
        return predicted
    veer = veer_of_nearest_bins(paired, at_m, rules.bins)
    return replace(pairs, veer_deg=veer.mean_deg, slow_shear=veer.slow)


def describe_pairs(name: str, pairs: Pairs) -> str:
    """Compose the log line of the job that finds pairs."""
    line = f"{name}: no overlapping pairs"
    if len(pairs):
        metres = float(np.median(np.abs(pairs.lower_depth_m - pairs.upper_depth_m)))
        apart = f"{metres:.1f} m apart in the median" if np.isfinite(metres) else "made elsewhere"
        line = f"{name}: {len(pairs)} overlapping pairs, {apart}"
    if len(pairs) and pairs.reference_index is not None:
        counts = np.bincount(pairs.reference_index, minlength=len(pairs.reference_names)).tolist()
        line += f" ({', '.join(f'{who} {n}' for who, n in zip(pairs.reference_names, counts, strict=True))})"
    if len(pairs) and pairs.expected_m_s is not None:
        mean, predicted = (100.0 * error for error in pairs.expected_m_s)
        off = f"{predicted:.1f} cm/s off the prediction, {mean:.1f} off the mean"
        line += f"; by the profile the water there is {off}"
    return "\n".join([line, *(f"{name}: warning: {warning}" for warning in pairs.warnings)])


def mean_of_nearest_bins(record: Record, distance_from: Floats, bins: int) -> tuple[Complexes, Floats]:
    """Average velocity and depth, (n,) each, of the good bins nearest to a range, (n,) m; NaN without good bins."""
    velocity, depth = np.empty(len(record.time_s), dtype=complex), np.empty(len(record.time_s))
    for rows in pieces(len(record.time_s)):
        piece = take(record, rows)
        away = piece.bin_range_m - distance_from[rows, None]
        np.abs(away, out=away)
        away[~usable_velocities(piece)] = np.inf
        count = min(bins, away.shape[1])
        index = np.argpartition(away, count - 1, axis=1)[:, :count]
        row = np.arange(len(away))[:, None]
        weight = np.isfinite(away[row, index]).astype(float)
        with np.errstate(invalid="ignore", divide="ignore"):
            share = weight / weight.sum(axis=1, keepdims=True)
        nearest = np.where(weight > 0, piece.east[row, index] + 1j * piece.north[row, index], 0.0)
        at_m = np.where(weight > 0, piece.bin_depth_m()[row, index], 0.0)
        velocity[rows], depth[rows] = (share * nearest).sum(axis=1), (share * at_m).sum(axis=1)
    return velocity, depth


def check_pairs(pairs: Pairs, upper: Record, trusted: Sequence[Record], *, several: bool = False) -> Pairs:
    """Check pairs for input errors, and attach warnings.

    Args:
        several: whether there are other references, so that velocities in a wrong frame are a doubt of this one only.

    Raises:
        InputError: both instruments have the same serial number, or the velocities of one are in a wrong frame.
    """
    if any(upper.serial_number and upper.serial_number == each.serial_number for each in trusted):
        expected, shown = "two instruments", f"serial number {upper.serial_number} in the files of both"
        raise InputError("compromised and reference", expected=expected, found=shown, advice="correct files of one")
    if not len(pairs):
        return replace(pairs, warnings=tuple(_absent(upper, trusted)))
    try:
        pairs = replace(pairs, warnings=(*pairs.warnings, *_check_frame(pairs)))
    except InputError as wrong:
        if not several:
            raise
        pairs = replace(pairs, doubts=(*pairs.doubts, (angles.UNIFORM_SIGMA_DEG, str(wrong))))
    speeds = [np.median(np.abs(flow)) for flow in pairs.flows]
    medians = f"median speeds of the pairs are {speeds[0]:.3g} and {speeds[1]:.3g} m/s"
    # No two depths 20 m apart reach a ratio of 5.
    apart, slow = not 0.2 < speeds[0] / speeds[1] < 5.0, min(speeds) < NOISE_M_S
    if apart and slow:
        why = f"{medians}: the unit or scale of one is wrong, or half are so slow that their directions are noise"
        pairs = replace(pairs, doubts=(*pairs.doubts, (angles.UNIFORM_SIGMA_DEG, why)))
    elif apart:
        pairs = replace(pairs, warnings=(*pairs.warnings, f"{medians}: check the unit and scale of both"))
    elif slow:
        why = f"half of the pairs are slower than {min(speeds):.2g} m/s: their directions are noise"
        pairs = replace(pairs, warnings=(*pairs.warnings, why))
    return pairs


def find_identical_velocities(pairs: Pairs) -> str:
    """Explain that both instruments of the pairs are one recording; empty if their velocities differ."""
    upper, lower = np.abs(pairs.flows)
    if len(pairs) < ENOUGH or np.ptp(upper) == 0.0 or np.mean(np.abs(upper - lower) < 1e-6) <= 0.5:
        return ""
    return "the two instruments recorded the same velocities: one recording was given twice, and no pair counts"


def _predicted(pairs: Pairs, upper: Record, depth_m: Floats, bins: int) -> Pairs | None:
    """Replace the upper velocities by those predicted at the reference's depth; None if that is impossible or worse."""
    prediction = predict_water(upper, depth_m, bins)
    if prediction is None:
        return None
    predicted = _to_true(prediction.velocity, upper, pairs.declination_deg)
    mean, trusted = pairs.flows
    known = np.isfinite(predicted) & (np.abs(predicted) > 0.0)
    if fails_speed_check(pairs.time_s[known], mean[known], predicted[known], trusted[known]):
        return None
    velocity = np.where(known, predicted, mean)
    off = float(np.sqrt(np.mean((np.abs(predicted[known]) - np.abs(trusted[known])) ** 2)))
    notes = []
    # The observed over the expected error was 0.8 to 1.5 in 40 cases of two real profiles.
    if off >= 3.0 * max(prediction.expected_m_s, NOISE_M_S):
        notes.append(
            f"the speeds of the reference differ by {100.0 * off:.1f} cm/s rms from those predicted at its depth, "
            "far more than expected from the profile: check depths, clocks and units of both"
        )
    return replace(
        pairs,
        upper_east=velocity.real,
        upper_north=velocity.imag,
        expected_m_s=(prediction.published_m_s, prediction.expected_m_s),
        veer_deg=prediction.veer.mean_deg,
        slow_shear=prediction.veer.slow,
        warnings=(*pairs.warnings, *notes),
    )


def _depth_by_speed(pairs: Pairs, upper: Record, depth_m: Floats) -> list[str]:
    """Warn if the speeds of a bin are far nearer to the reference's than those of the bin nearest to its depth."""
    off = (
        np.where(usable_velocities(upper), np.hypot(upper.east, upper.north), np.nan) - np.abs(pairs.flows[1])[:, None]
    )
    known = np.isfinite(off)
    square = np.where(known, off, 0.0) ** 2
    misfit = np.sqrt(square.sum(axis=0) / np.maximum(known.sum(axis=0), 1))
    misfit[known.mean(axis=0) < 0.5] = np.inf
    with np.errstate(invalid="ignore"):
        away_m = np.nan_to_num(np.median(np.abs(upper.bin_depth_m() - depth_m[:, None]), axis=0), nan=np.inf)
    away_m[np.isinf(misfit)] = np.inf
    best, near = int(np.argmin(misfit)), int(np.argmin(away_m))
    if len(pairs) < ENOUGH or np.isinf(away_m[near]) or misfit[best] > NEARER_IN_SPEED * misfit[near]:
        return []
    at_m, sizes = float(np.nanmedian(upper.bin_depth_m()[:, best])), 100.0 * misfit[[best, near]]
    return [
        f"the speeds of the reference are far nearer to those of the bin at {at_m:.0f} m ({sizes[0]:.1f} cm/s rms) "
        f"than to those of the bin nearest to its depth ({sizes[1]:.1f}): check its depth"
    ]


def _gridded(upper: Record, rules: PairRules) -> Record:
    step_s, tolerance_s = 60.0 * rules.grid_minutes, 60.0 * rules.grid_tolerance_minutes
    return take(upper, grid_indices(upper.time_s, step_s=step_s, tolerance_s=tolerance_s))


def _range_of_meter(upper: Record, lower: Record, rules: PairRules) -> Floats:
    """Compute the range of a point meter that is within the profile but not near its beginning, (n,) m; else 0."""
    none = np.zeros(len(upper.time_s))
    if not len(lower.time_s) or not len(none) or lower.bin_range_m.shape[1] > 1:
        return none
    at = interpolate_series(lower.time_s, lower.depth_m, upper.time_s, tolerance_s=np.inf)
    range_m = np.nan_to_num((at - upper.depth_m) * (-1.0 if upper.looks_up else 1.0))
    nearest_m, farthest_m = np.nanmin(upper.bin_range_m), np.nanmax(upper.bin_range_m)
    inside = nearest_m + rules.max_metres <= np.median(range_m) <= farthest_m and np.std(range_m) < rules.max_metres
    return np.maximum(range_m, 0.0) if inside else none


def _trusted_cell(upper: Record, depth: Floats, lower: Record, rules: PairRules) -> VelocitySeries:
    """Select the reference's cell nearest to the sphere, or to the affected bins, and average dense series."""
    known = np.isfinite(depth)
    if not len(lower.time_s) or not known.any():
        return VelocitySeries(np.zeros(0), np.zeros(0, dtype=complex), np.zeros(0))
    wanted = np.interp(lower.time_s, upper.time_s[known], depth[known])
    sphere = interpolate_series(upper.time_s, upper.depth_m, lower.time_s, tolerance_s=np.inf)
    towards = (lower.depth_m - (wanted if rules.predict else sphere)) * (1.0 if lower.looks_up else -1.0)
    velocity, at = mean_of_nearest_bins(lower, np.nan_to_num(towards), rules.bins)
    near = np.isfinite(velocity) & (np.abs(at - wanted) < rules.max_metres)
    time_s, velocity, at = lower.time_s[near], velocity[near], at[near]
    if len(time_s) < 2 or np.median(np.diff(time_s)) >= 300.0:
        return VelocitySeries(time_s, velocity, at)
    # Faster samples, as of a profiler passing its top, are averaged over blocks of time.
    begins = np.flatnonzero(np.diff(np.floor(time_s / (30.0 * rules.max_minutes)), prepend=-1.0))
    size = np.diff(np.append(begins, len(time_s)))
    averaged: list[Any] = [np.add.reduceat(column, begins) / size for column in (time_s, velocity, at)]
    return VelocitySeries(*averaged)


def _heading(lower: Record, time_s: Floats, tolerance_s: float) -> Floats | None:
    """Interpolate the reference's heading to given times, (n,) degrees; None if it has no usable heading."""
    known = np.isfinite(lower.heading_deg) & (lower.heading_quality <= PROBABLY_GOOD)
    if not known.any() or not len(time_s):
        return None
    sine, cosine = angles.sin_cos(lower.heading_deg[known])
    at = interpolate_series(lower.time_s[known], cosine + 1j * sine, time_s, tolerance_s=tolerance_s)
    return angles.argument(at) if np.isfinite(at).any() else None


def _assemble(
    samples: Record, top: Complexes, bottom: Complexes, apart: tuple[Floats, Floats, Floats], declination: Floats
) -> Pairs:
    """Create pairs from samples of the affected instrument, velocities, and depths and minutes between them."""
    return Pairs(
        samples.time_s, samples.heading_deg, samples.pitch_deg, samples.roll_deg,
        top.real, top.imag, bottom.real, bottom.imag, *apart, declination,
    )  # fmt: skip


def _to_true(velocity: Complexes, record: Record, declination: Floats) -> Complexes:
    if record.direction_reference == "true":
        return velocity
    east, north = angles.turn(velocity.real, velocity.imag, declination)
    return east + 1j * north


def _absent(upper: Record, trusted: Sequence[Record]) -> list[str]:
    """Explain why there is no pair."""
    if not trusted:
        return []
    whys = {"affected": _unusable(upper, heading=True), "reference": _unusable(trusted[0], heading=False)}
    if reasons := [f"the {name} instrument {why}" for name, why in whys.items() if why]:
        return reasons
    if upper.time_s[0] > trusted[0].time_s[-1] or trusted[0].time_s[0] > upper.time_s[-1]:
        return ["the two records do not overlap in time"]
    depths = [f"{np.nanmedian(record.depth_m):.0f}" for record in (upper, trusted[0])]
    sample = take(upper, np.linspace(0, len(upper.time_s) - 1, 100).astype(np.intp))
    bins_m = np.nanmedian(sample.bin_depth_m(), axis=0)
    apart_m = float(np.nanmin(np.abs(bins_m - np.nanmedian(trusted[0].depth_m)), initial=np.inf))
    return [
        f"no two velocities are near enough in time and depth: instruments at {' and '.join(depths)} m, the nearest "
        f"bin {apart_m:.0f} m from the reference (overlap: max_metres, max_minutes)"
    ]


def _unusable(record: Record, *, heading: bool) -> str:
    headings = np.isfinite(record.heading_deg) & (record.heading_quality <= PROBABLY_GOOD)
    moving, usable = False, False
    for piece in (take(record, rows) for rows in pieces(len(record.time_s))):
        usable |= bool(usable_velocities(piece).any())
        moving |= bool(np.nan_to_num(piece.east).any() or np.nan_to_num(piece.north).any())
    reasons = {
        "has no sample inside the deployment": not len(record.time_s),
        "has no usable velocity": not usable,
        "has velocities of zero only": not moving,
        "has no usable heading: is it the one with the compass to correct?": heading and not headings.any(),
        "has no depth": not np.isfinite(record.depth_m).any(),
    }
    return next((reason for reason, holds in reasons.items() if holds), "")


def _check_frame(pairs: Pairs) -> list[str]:
    """Reject directions that agree with the reference's only after adding or subtracting the heading, or mirroring.

    Where the flow keeps one direction or the compass hardly turns, the test cannot decide and passes. The slowest
    quarter is ignored. Iron as strong as the field halves each turn: the compass then shows half of the circle only,
    and twice its readings are the headings up to a constant, so that this causes a warning.
    """
    most_opposite = 0.05  # share of readings on the other half: to 0.014 in five moorings with iron of 0.85 to 1.05 H
    slower = np.min(np.abs(pairs.flows), axis=0)
    fast = slower >= np.quantile(slower, 0.25)
    upper, lower = (angles.direction(flow.real, flow.imag)[fast] for flow in pairs.flows)
    heading = pairs.heading_deg[fast]
    plain = min(_spread(lower - upper), _spread(lower), _spread(heading))
    others = {(sign, k): _spread(lower + sign * upper + k * heading) for sign, k in OTHER_FRAMES}
    best = min(others, key=others.__getitem__)
    if best == (-1, -1):  # as of an instrument that follows the flow, with iron as strong as the field
        plain = min(plain, _spread(upper - heading))
    if len(heading) < ENOUGH or others[best] * 1.8 >= plain:
        return []
    middle = float(angles.mean(heading))
    if best == (-1, -1) and np.mean(np.abs(angles.difference(heading, middle)) > 90.0) < most_opposite:
        return [
            "directions agree with those of the reference where they are turned by the heading: iron is as strong as "
            "the earth's field, or the velocities are in the instrument's coordinates (check EX)"
        ]
    shown = f"directions that agree with those of the reference only where they are {OTHER_FRAMES[best]}"
    advice = "check coordinates (EX), orientation, and east and north of both instruments"
    raise InputError("compromised and reference", expected="velocities as in the files", found=shown, advice=advice)


def _spread(angle_deg: Floats) -> float:
    """Compute the circular standard deviation of angles, radians."""
    length = min(max(float(angles.resultant_length(angle_deg)), 1e-12), 1.0)
    return float(np.sqrt(-2.0 * np.log(length)))


# Ready-made pairs, read from a table or MATLAB file and matched to the samples of the affected instrument's record.


def match_ready_pairs(columns: Mapping[str, Floats], scale: float, record: Record, field: EarthField) -> Pairs:
    """Match ready-made pairs to the nearest samples of the record, dropping those off by over half a sample interval.

    Depths and separations are unknown. Both velocities must refer to the same north, true or magnetic.
    """
    order = np.argsort(columns["time"], kind="stable")
    rows = {role: column[order] for role, column in columns.items()}
    known = np.all([np.isfinite(column) for column in rows.values()], axis=0)
    rows = {role: column[known] for role, column in rows.items()}
    n, samples = int(known.sum()), record.time_s
    near, at = np.zeros(n, dtype=bool), np.zeros(n, dtype=np.intp)
    if len(samples) > 1:
        at = nearest_index(samples, rows["time"])
        near = np.abs(samples[at] - rows["time"]) <= 0.5 * np.median(np.diff(samples))
        near &= np.diff(at, prepend=-1) > 0  # at most one pair per sample, the first
    rows, at = {role: column[near] for role, column in rows.items()}, at[near]
    matched, unknown = take(record, at), np.full(len(at), np.nan)
    rows = {role: scale * column if role.endswith(("east", "north")) else column for role, column in rows.items()}
    top, bottom = rows["upper_east"] + 1j * rows["upper_north"], rows["lower_east"] + 1j * rows["lower_north"]
    declination = earthfield.declination_at(field, matched.time_s)
    pairs = _assemble(matched, top, bottom, (unknown, unknown, unknown), declination)
    pairs = replace(pairs, heading_deg=angles.wrap360(rows["heading"]))
    moving = np.min(np.abs(pairs.flows), axis=0) > 0.0
    pairs = take(pairs, moving & (record.heading_quality[at] < BAD))
    if reason := find_identical_velocities(pairs):
        return replace(take(pairs, np.zeros(0, dtype=np.intp)), warnings=(reason,))
    pairs = check_pairs(pairs, record, [])
    left_out = n - len(pairs)
    notes = [f"{left_out} of {n} ready-made pairs lie at no usable sample of the record"] * bool(left_out)
    off = angles.difference(pairs.heading_deg, record.heading_deg[np.searchsorted(samples, pairs.time_s)])
    if len(pairs) and (size := float(np.median(np.abs(off)))) > 5.0:
        notes.append(
            f"headings of the ready-made pairs differ from the record's by {size:.0f}° in the median: check times and "
            "headings of both"
        )
    return replace(pairs, warnings=(*pairs.warnings, *notes))
