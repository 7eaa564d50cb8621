"""Quality control: stuck sensors, depths out of the water, fill values read as speeds, outlying headings.

Impossible values are flagged and counted; values that are possible but uninformative cause a warning.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.records import (
    BAD,
    GOOD,
    LEAST_PERCENT_GOOD,
    MISSING,
    PROBABLY_BAD,
    PROBABLY_GOOD,
    Flags,
    Record,
    iso_time,
)
from compasslib.statistics.resampling import angle_resolution
from compasslib.types import HOUR_S, Bools, Floats

# Velocity tests by the key of their count, one bit each in this order; flag meanings follow QARTOD and IMOS.
TESTS = {
    "flagged_in_file": "flagged_in_file",
    "low_percent_good": "qartod_percent_good",
    "low_correlation": "qartod_correlation_magnitude",
    "large_error_velocity": "qartod_error_velocity",
    "weak_echo": "qartod_echo_intensity",
    "impossible_speed": "qartod_current_speed",
    "frozen_velocity": "qartod_flat_line",
    "steep_tilt": "imos_tilt",
    "impossible_depth": "imos_impossible_depth",
    "out_of_water": "imos_in_out_water",
    "side_lobe": "imos_side_lobe",
    "beyond_boundary": "beyond_surface_or_bottom",
    "bins_without_length": "bins_without_length",
    "excluded": "excluded_by_operator",
    "heading": "heading",
}
MASKS = {name: np.int16(1 << k) for k, name in enumerate(TESTS)}
ABOVE_SURFACE_M = 10.0  # larger than the offset of a pressure sensor that was not zeroed in air
BELOW_BOTTOM = 1.2  # times the water depth; charted depths are rarely wrong by more
# Fractions of the 90th percentile of depth: shallower is on deck; up to the second a moored instrument passes in hours.
ON_DECK, BETWEEN, RARELY, LEAST_DEPTH_M = 0.2, 0.5, 0.01, 15.0
COARSE_DEG = 2.0  # heading resolution from which on a note is made
FROZEN_SAMPLES, FROZEN_S = 12, 6 * HOUR_S  # real currents never repeat to the last digit for this long
STILL_DEG = 0.1  # change between samples below which a compass counts as stuck: its noise
BLOCK = 50_000  # samples compared at once, to limit memory
BY_CHANCE = 1e-3  # expected number of equally long runs, given how often the rest of the series repeats
ENOUGH = 24  # fewest samples for calling a series stuck
NARROW_DEG = 5.0  # a narrower arc of headings cannot constrain how the deviation varies with heading
# Outlying headings: in a year of ten genuine and simulated compasses, with steps of 0.3 to 17 degrees, no heading in
# fast water differed from both neighbours by the mean of ten median steps and 180 degrees.
OFF_STEPS, LEAST_OFF_DEG = 10.0, 20.0  # limit in median steps; its lower bound, for a compass that hardly turns
FREE_DEG = 135.0  # a compass with a larger limit turns too freely for outliers to be recognized
# Above the limit WIDE_DEG a compass may swing widely by nature if the upper quartile of its valid steps exceeds HEAVY
# times their median: 2.05 to 2.6 in one real record as read by compasses near iron; at most 2.02 for sound compasses in
# simulated water, 5 to 20 % of whose headings were random.
WIDE_DEG, HEAVY = 75.0, 2.04
LONGEST_OFF = 5  # longest run of samples that leaves and returns together
PROOF, PROOF_SHARE = 3, 2.5e-4  # number and share of certain outliers from which uncertain ones are flagged bad too
NEAR_BINS = 5  # bins whose mean distinguishes fast from slow water
FILLS, FILLS_MORE, FILLERS = 6, 3, 8  # least count of a fill value, its ratio to neighbouring values, candidates
NEIGHBOURS = 5  # distinct values on either side
INTEGER_LIMITS, LIMIT_NEAR_DEG = (327.67, 327.68), 0.5  # limits of 16-bit integers, in hundredths of a degree
# Ranges of headings other than the circle, from 0: width of their ends as a share of the range, fewest headings there.
RANGE_END, RANGE_END_COUNT = 1 / 90, 5
RANGES = {
    180.0: "half of the circle was folded on the other (modulo 180, halved, or without a sign)",
    6.29: "they are radians",
}
FILL_OFF_DEG = (5.0, 45.0)  # a jump to a fill value exceeds twice the typical step, clipped to these bounds


@dataclass(frozen=True)
class Thresholds:
    """Thresholds of the tests; None disables a test."""

    percent_good: float = LEAST_PERCENT_GOOD  # minimum, %
    correlation: float | None = None  # minimum over the beams, counts
    error_velocity: float | None = None  # maximum, m/s
    echo: float | None = None  # minimum over the beams, counts
    tilt_deg: float = 45.0  # maximum pitch or roll; instruments do not compensate more
    speed: float = 5.0  # maximum, m/s, above any ocean current
    side_lobe: bool = True  # whether to flag cells contaminated by side-lobe echoes from surface or bottom


DEFAULT_THRESHOLDS = Thresholds()


def flag_quality(
    record: Record, water_depth: float, *, affected: bool = False, thresholds: Thresholds = DEFAULT_THRESHOLDS
) -> Record:
    """Flag and count impossible values, and warn of uninformative sensors.

    Args:
        affected: whether the compass is to be corrected. Near strong iron a small turn can change the recorded heading
            greatly: outliers are then only counted, and tested again after the correction (``heading_outlier_flags``).
    """
    record = _flag_profiles(_flag_read(record, thresholds), thresholds)
    record = _impossible(record, water_depth, thresholds)
    if record.bin_range_m.shape[1] > 1:
        with np.errstate(invalid="ignore"):  # bins at the same range, as where the cell length was lost
            flat = (np.diff(record.bin_range_m, axis=1) == 0.0).any(axis=1)[:, None]
        sentence = "bins of no length, whose depths nothing tells"
        record = flag_velocities(record, flat, BAD, "bins_without_length", sentence)
    record = _outlying_headings(record, affected)
    if len(record.time_s) > FROZEN_SAMPLES:
        frozen = _stuck_velocity(record)[:, None]
        sentence = "the same to the last digit for hours"
        record = flag_velocities(record, frozen, BAD, "frozen_velocity", sentence)
        with np.errstate(invalid="ignore"):
            same = np.abs(angles.difference(record.heading_deg[1:], record.heading_deg[:-1])) <= STILL_DEG
        still = _stuck(same, record.time_s) & (record.heading_quality < PROBABLY_BAD)
        number = int(still.sum())
        note = f"{number} headings flagged: the compass stood still within {STILL_DEG:g} degrees for hours"
        record = replace(record, counts={**record.counts, "heading_stuck": number})
        record = flag_headings(record, still, *[note] * (number > 0))
    return _constant_sensors(flag_unit(record) if affected else record)


def flag_velocities(record: Record, where: Bools, flag: int, count: str, sentence: str | None) -> Record:
    """Flag velocities that were good or probably good so far, count them, and warn if a sentence describes them.

    Args:
        where: mask, broadcastable to (n, m).
    """
    failed = np.broadcast_to(where, record.quality.shape) & (record.quality != MISSING)
    tests = np.where(failed, _tests(record) | MASKS[count], _tests(record)).astype(np.int16)
    hit = failed & (record.quality <= PROBABLY_GOOD)
    number = int(np.sum(hit))
    notes = (f"{number} velocities flagged: {sentence}",) if sentence and number else ()
    quality = np.where(hit, flag, record.quality).astype(np.int8)
    counts = {**record.counts, count: number}
    return replace(record, quality=quality, counts=counts, warnings=record.warnings + notes, tests=tests)


def flag_headings(record: Record, which: Bools, *notes: str) -> Record:
    """Flag the selected headings as doubtful unless already worse, and add notes to the warnings."""
    flags = np.where(which & (record.heading_quality < PROBABLY_BAD), PROBABLY_BAD, record.heading_quality)
    return replace(record, heading_quality=flags.astype(np.int8), warnings=record.warnings + notes)


def flag_unit(record: Record) -> Record:
    """Flag all headings as doubtful where they fill half of a circle, or are radians."""
    known = np.isfinite(record.heading_deg) & (record.heading_quality < PROBABLY_BAD)
    heading = record.heading_deg[known]
    for full, cause in RANGES.items():
        ends = [np.count_nonzero(np.abs(heading - end) <= RANGE_END * full) for end in (0.0, full)]
        if min(ends) >= RANGE_END_COUNT and heading.max() <= full:
            note = f"all recorded headings lie between 0 and {full:.4g}, up to both limits: {cause}, all are doubtful"
            return flag_headings(record, known, f"{note}; check the column of headings")
    return record


def _tests(record: Record) -> NDArray[np.int16]:
    return np.zeros(record.quality.shape, dtype=np.int16) if record.tests is None else record.tests


def _flag_read(record: Record, thresholds: Thresholds) -> Record:
    """Attribute the reader's flags to a test, and apply a percent-good threshold other than the reader's."""
    name = "low_percent_good" if "percent_good" in record.profiles else "flagged_in_file"
    flagged = (record.quality > PROBABLY_GOOD) & (record.quality != MISSING)
    least, percent = thresholds.percent_good, None
    if name == "low_percent_good" and least != LEAST_PERCENT_GOOD:
        percent = _percent_good(record)
        allowed = flagged & (percent >= least) & (percent < LEAST_PERCENT_GOOD)
        record = replace(record, quality=np.where(allowed, GOOD, record.quality).astype(np.int8))
        flagged &= ~allowed
    record = replace(record, tests=np.where(flagged, MASKS[name], np.int16(0)).astype(np.int16))
    if percent is None:
        return record
    return flag_velocities(record, percent < least, BAD, name, f"fewer than {least:g} % of the pings were good")


def _percent_good(record: Record) -> Floats:
    """Compute the share of good pings, (n, m) percent.

    In beam coordinates with four beams it is the minimum, or the second lowest for three-beam solutions; in other
    coordinates it is the sum of columns 1 and 4, the three- and four-beam solutions.
    """
    percent = np.asarray(record.profiles["percent_good"][:], dtype=float)
    if percent.ndim < 3 or percent.shape[2] != 4:
        return percent if percent.ndim == 2 else percent.min(axis=2)
    if record.recorded_in != "beam":
        return percent[..., 0] + percent[..., 3]
    ordered = np.sort(percent, axis=2)
    error = np.asarray(record.profiles.get("error_velocity", percent[..., 0])[:])
    return np.where(np.isnan(error), ordered[..., 1], ordered[..., 0])


def _flag_profiles(record: Record, thresholds: Thresholds) -> Record:
    """Flag by correlation, error velocity and echo intensity where a threshold is set and the file has the profile."""
    tests = (
        ("correlation", "low_correlation", thresholds.correlation, "correlations below {:g} counts"),
        ("echo", "weak_echo", thresholds.echo, "echoes below {:g} counts"),
        ("error_velocity", "large_error_velocity", thresholds.error_velocity, "error velocities above {:g} m/s"),
    )
    for profile, count, threshold, sentence in tests:
        if threshold is None or profile not in record.profiles:
            continue
        values = np.asarray(record.profiles[profile][:], dtype=float)
        with np.errstate(invalid="ignore"):
            if profile == "error_velocity":
                failed = np.abs(values) > threshold
            else:
                failed = np.where(values < 0.0, np.inf, values).min(axis=2) < threshold
        record = flag_velocities(record, failed, BAD, count, sentence.format(threshold))
    return record


def _impossible(record: Record, water_depth: float, thresholds: Thresholds) -> Record:
    """Flag impossible speeds, excessive tilt, and depths outside the water."""
    too_fast = np.hypot(record.east, record.north) > thresholds.speed
    with np.errstate(invalid="ignore"):
        fallen = (np.abs(record.pitch_deg) > thresholds.tilt_deg) | (np.abs(record.roll_deg) > thresholds.tilt_deg)
        outside = (record.depth_m < -ABOVE_SURFACE_M) | (record.depth_m > BELOW_BOTTOM * water_depth)
    sentence = f"faster than {thresholds.speed:g} m/s"
    record = flag_velocities(record, too_fast, BAD, "impossible_speed", sentence)
    record = flag_velocities(record, fallen[:, None], BAD, "steep_tilt", "tilted too far")
    record = flag_headings(record, fallen)
    sentence = "the instrument's depth lies above the surface or below the bottom"
    return _out_of_water(flag_velocities(record, outside[:, None], BAD, "impossible_depth", sentence))


def _out_of_water(record: Record) -> Record:
    """Flag samples recorded on deck: depths near the surface in a record with few intermediate depths.

    Profilers, which pass through all levels, and shallow instruments are not tested.
    """
    deepest = float(np.nanpercentile(record.depth_m, 90.0)) if np.isfinite(record.depth_m).any() else 0.0
    with np.errstate(invalid="ignore"):
        on_deck = record.depth_m < ON_DECK * deepest
        between = ~on_deck & (record.depth_m < BETWEEN * deepest)
    if deepest < LEAST_DEPTH_M or between.mean() > RARELY or not on_deck.any():
        return record
    record = flag_velocities(record, on_deck[:, None], BAD, "out_of_water", None)
    when = record.time_s[on_deck][[0, -1]]
    note = (
        f"{int(on_deck.sum())} samples between {iso_time(when[0])} and {iso_time(when[1])} lie out of the water by the "
        "instrument's own depth: velocities are flagged bad and headings doubtful there; correct start and end of the "
        "deployment"
    )
    return flag_headings(record, on_deck, note)


def heading_outlier_flags(record: Record, heading_deg: Floats) -> Flags:
    """Flag headings that differ implausibly from both neighbours, (n,): good, probably bad or bad.

    Headings that the record flags doubtful or bad are not tested.

    Args:
        heading_deg: recorded or corrected headings to be tested, (n,) degrees, NaN where missing.
    """
    known = np.isfinite(heading_deg) & (record.heading_quality < PROBABLY_BAD)
    flags = np.full(known.shape, GOOD, dtype=np.int8)
    good = record.quality[:, :NEAR_BINS] <= PROBABLY_GOOD
    count = good.sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = [np.where(good, of[:, :NEAR_BINS], 0.0).sum(axis=1) / count for of in (record.east, record.north)]
    speed = np.hypot(*mean)
    fast = np.nan_to_num(speed) > (np.median(speed[count > 0]) if count.any() else np.inf)
    flags[known] = _outliers(heading_deg[known], fast[known])
    return flags


def apply_heading_flags(record: Record, flags: Flags) -> Record:
    """Apply heading flags, (n,), where they are worse, and flag velocities rotated by a bad heading as doubtful."""
    turned = (flags >= BAD)[:, None] & (record.quality <= PROBABLY_GOOD)
    quality = np.where(turned, PROBABLY_BAD, record.quality).astype(np.int8)
    return replace(record, heading_quality=np.maximum(record.heading_quality, flags), quality=quality)


def _outlying_headings(record: Record, affected: bool) -> Record:
    """Flag headings that are fill values, and also outliers if the compass is not to be corrected."""
    known = np.flatnonzero(np.isfinite(record.heading_deg) & (record.heading_quality < PROBABLY_BAD))
    heading = record.heading_deg[known]
    values = _fill_values(heading) if len(known) >= ENOUGH else np.empty(0)
    fill = np.zeros(record.heading_deg.shape, dtype=np.int8)
    fill[known[np.isin(heading.round(2), values)]] = BAD
    filled = apply_heading_flags(record, fill)
    flags = heading_outlier_flags(filled, record.heading_deg)
    numbers = {"heading_fill": fill == BAD, "heading_wild": flags == BAD, "heading_unsure": flags == PROBABLY_BAD}
    counts = {name: int(np.sum(which)) for name, which in numbers.items()}
    warnings = _heading_warnings(counts, values, len(known), affected)
    record = filled if affected else apply_heading_flags(filled, flags)
    return replace(record, counts=record.counts | counts, warnings=(*record.warnings, *warnings))


def _heading_warnings(counts: dict[str, int], values: Floats, known: int, affected: bool) -> list[str]:
    fill, wild, unsure = counts.values()
    off, notes = "those before and after", []
    if fill:
        shown = " or ".join(f"{value:.2f}" for value in values)
        notes.append(f"{fill} headings flagged: they read {shown} degrees, a fill value far off {off}")
    if affected and wild:
        notes.append(
            f"{wild} of {known} recorded headings, and perhaps {unsure} more, differ from {off} as by a fault or by a "
            "compass near strong iron: the fit leaves them out, and they are judged by their corrected headings"
        )
        return notes
    if wild:
        notes.append(f"{wild} of {known} headings flagged: they differ from {off} by more than an instrument turns")
    if unsure:
        notes.append(
            f"{unsure} headings are doubtful: they differ from {off} like the wild ones, and others may hide in turns"
        )
    return notes


def _fill_values(heading_deg: Floats) -> Floats:
    """Find fill values: headings that occur far more often than adjacent values and are reached by jumps."""
    distinct, place = np.unique(heading_deg.round(2), return_inverse=True)
    # A stationary compass has no fill value, so arrivals at a value are counted, not samples.
    count = np.bincount(place[np.append(True, place[1:] != place[:-1])], minlength=len(distinct))
    typical = float(np.median(_off_both(heading_deg)))
    fills = []
    for k in np.argsort(-count)[:FILLERS]:
        neighbours = np.sort(count[np.arange(k - NEIGHBOURS, k + NEIGHBOURS + 1) % len(count)])
        # The largest count is usually the value's own, and the next may belong to another fill value.
        ordinary = neighbours[-3] if len(neighbours) > 2 else len(heading_deg)
        others = np.flatnonzero(place != k)
        if count[k] < FILLS + FILLS_MORE * ordinary or len(others) < ENOUGH:
            continue
        after = np.searchsorted(others, np.flatnonzero(place == k))
        ends = [heading_deg[others[np.clip(at, 0, len(others) - 1)]] for at in (after - 1, after)]
        off = np.min([np.abs(angles.difference(end, distinct[k])) for end in ends], axis=0)
        fills += [distinct[k]] if np.median(off) > np.clip(2.0 * typical, *FILL_OFF_DEG) else []
    # 16-bit limits may come in runs; a stationary frame near one reads the adjacent values as often.
    total = np.bincount(place, minlength=len(distinct))
    for limit in INTEGER_LIMITS:
        at, beside = distinct == limit, np.abs(distinct - limit) < LIMIT_NEAR_DEG
        if total[at].sum() >= FILLS and total[at].sum() > FILLS_MORE * total[beside & ~at].sum():
            fills.append(limit)
    return np.unique(fills)


def _off_both(heading_deg: Floats) -> Floats:
    """Compute each heading's difference from the closer of its two neighbours, (n,) degrees; 0 at both ends."""
    steps = np.abs(angles.difference(heading_deg[1:], heading_deg[:-1]))
    off = np.zeros(len(heading_deg))
    off[1:-1] = np.minimum(steps[1:], steps[:-1])
    return off


def _excursions(heading_deg: Floats, limit: float) -> Bools:
    """Find single headings, or short runs that return, that differ from those before and after by more than a limit."""
    off, steps = _off_both(heading_deg) > limit, np.abs(angles.difference(heading_deg[1:], heading_deg[:-1])) > limit
    for length in range(2, LONGEST_OFF + 1):
        begin = np.arange(1, len(heading_deg) - length)
        back = np.abs(angles.difference(heading_deg[begin + length], heading_deg[begin - 1])) < limit / 2.0
        away = begin[steps[begin - 1] & steps[begin + length - 1] & back]
        off[(away[:, None] + np.arange(length)).ravel()] = True
    return off


def _outliers(heading_deg: Floats, fast: Bools) -> Flags:
    """Flag each heading, (n,): good, bad if it is an outlier, or probably bad if it may be one.

    In slow water a compass may turn anywhere and back, so only large excursions in fast water are certain. If there are
    several, the uncertain ones are flagged too, unless the compass swings widely by nature, with steps of all sizes.
    """
    flags = np.full(len(heading_deg), GOOD, dtype=np.int8)
    off = _off_both(heading_deg)
    limit = _limit(off, 0.0)
    if len(heading_deg) < ENOUGH or limit > FREE_DEG or not fast.any():
        return flags
    far = (limit + 180.0) / 2.0
    sure = _excursions(heading_deg, far) & fast
    flags[sure] = BAD
    # Share of all headings that are wrong, if the wrong ones are uniform on the circle.
    wrong = min(sure.sum() / fast.sum() * 180.0 / (180.0 - far), 0.4)
    median, quartile = np.quantile(off[fast], (0.5 * (1.0 - wrong), 0.75 * (1.0 - wrong)))
    natural = limit > WIDE_DEG and quartile > HEAVY * median
    if natural or sure.sum() < max(PROOF, PROOF_SHARE * len(off)):
        return flags
    limit = _limit(off, wrong)
    flags[_excursions(heading_deg, far) | (off > limit)] = BAD
    left = np.flatnonzero(flags == GOOD)
    flags[left[_off_both(heading_deg[left]) > limit / 2.0]] = PROBABLY_BAD
    return flags


def _limit(off_both_deg: Floats, wrong: float) -> float:
    """Compute the difference from both neighbours that a correct heading rarely exceeds, degrees."""
    if not off_both_deg.size:
        return 360.0
    middle = 0.5 * (1.0 - min(2.0 * wrong, 0.8))  # a wrong heading may also make a valid neighbour stand out
    return max(LEAST_OFF_DEG, OFF_STEPS * float(np.quantile(off_both_deg, middle)))


def _stuck_velocity(record: Record) -> Bools:
    """Find runs of samples whose velocities repeat the previous ones in all bins; all-zero samples are not tested.

    Where one component never changes, all samples are returned.
    """
    steps = max(len(record.time_s) - 1, 0)
    same, moving = np.ones(steps, dtype=bool), np.zeros(steps, dtype=bool)
    constant = []
    for velocity in (record.east, record.north):
        repeats = np.ones(steps, dtype=bool)
        for begin in range(0, steps, BLOCK):  # copies of a decade of data would not fit into memory
            piece = slice(begin, begin + BLOCK)
            known = np.nan_to_num(velocity[begin : begin + BLOCK + 1])
            repeats[piece] = (known[1:] == known[:-1]).all(axis=1)
            moving[piece] |= known[1:].any(axis=1)
        constant.append(repeats.all())
        same &= repeats
    same &= moving
    if any(constant) and moving.any() and len(record.time_s) > ENOUGH:
        return np.ones(len(record.time_s), dtype=bool)
    return _stuck(same, record.time_s)


def _stuck(same: Bools, time_s: Floats) -> Bools:
    """Find long runs of repeated samples, (n - 1,) mask, that the rate of repetition elsewhere does not explain."""
    edge = np.diff(np.concatenate([[False], same, [False]]).astype(np.int8))
    runs = np.column_stack([np.flatnonzero(edge == 1), np.flatnonzero(edge == -1)])  # first and last sample of each
    lasts = time_s[runs[:, 1]] - time_s[runs[:, 0]] >= FROZEN_S
    runs = runs[lasts & (runs[:, 1] - runs[:, 0] >= FROZEN_SAMPLES)]
    stuck = np.zeros(len(time_s), dtype=bool)
    for begin, end in runs:
        stuck[begin + 1 : end + 1] = True
    others = same[~stuck[1:]]
    share = float(others.mean()) if others.size else 1.0
    likely = [end - begin for begin, end in runs if len(time_s) * share ** (end - begin) > BY_CHANCE]
    return stuck & (not likely)


def _constant_sensors(record: Record) -> Record:
    """Count samples of sensors that never vary, and warn."""
    counts: dict[str, int] = {"tilt_frozen": 0, "heading_frozen": 0, "heading_narrow": 0}
    notes = []
    tilts = [x for x in (record.pitch_deg, record.roll_deg) if np.isfinite(x).sum() >= ENOUGH]
    if tilts and all(np.nanmax(x) == np.nanmin(x) for x in tilts):
        counts["tilt_frozen"] = int(np.isfinite(tilts[0]).sum())
        notes.append("pitch and roll never change: the tilt sensor is stuck or was not fitted, its tilts tell nothing")
    heading = record.heading_deg[np.isfinite(record.heading_deg)]
    arc = 360.0  # width of the central arc that holds 99 % of the headings
    if heading.size >= ENOUGH:
        arc = float(np.ptp(np.percentile(angles.difference(heading, angles.mean(heading)), [0.5, 99.5])))
    if arc == 0.0:
        counts["heading_frozen"] = heading.size
        notes.append(f"the compass shows {heading[0]:.2f} degrees all the time: it is stuck, and no heading is used")
    elif arc < NARROW_DEG:
        counts["heading_narrow"] = heading.size
        notes.append(f"all headings lie within {arc:.1f} degrees: they cannot tell a deviation from a constant")
    steps = angle_resolution(record.heading_deg)
    if (coarse := steps >= COARSE_DEG).any():
        share = "" if coarse.all() else f" in {coarse.mean():.0%} of the record"
        notes.append(
            f"headings step by {np.median(steps[coarse]):g} degrees{share}: the step is included in their uncertainty"
        )
    record = replace(record, counts=record.counts | counts)
    return flag_headings(record, np.full(record.time_s.shape, arc == 0.0), *notes)
