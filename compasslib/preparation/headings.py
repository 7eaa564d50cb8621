"""Tests of whether the recorded headings are those by which the instrument rotated its velocities.

Heading minus direction of flow is the direction of flow in the instrument's own frame (with its sign reversed), which
does not depend on the compass or its deviation. A moored instrument turns with the water, so this direction stays on
one side: over windows of five days its speed-weighted mean vector stays within 0.61 of the record's in two real records
of 21 months in total. If the column of headings was altered later (rotated, mirrored, replaced), it does not. Changes
of heading and of the direction of flow occur in the same samples, and neither series is much smoother than the other.
A working compass that turns does not repeat a reading or a sequence of readings to the last digit, nor omit every other
sector of the circle.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.records import PROBABLY_BAD, Record, iso_time
from compasslib.statistics.resampling import adjacent
from compasslib.types import DAY_S, HOUR_S, Bools, Complexes, Floats

WINDOW_S, FEWEST, FEWEST_WINDOWS = 5 * DAY_S, 40, 6
# Least resultant length or correlation that counts as significant; largest turn of two consecutive windows.
FIRM, TURNED_DEG = 0.4, 60.0
# Limits for a single window are wider: of 553 of the demonstration cruise one is off by 79 degrees and 0.81.
ALONE, ALONE_DEG = 1.4, 110.0
OFF, OFF_TIMES = 0.75, 5.0  # distance of a window's mean vector from the record's, and its ratio to the median distance
SEQUENCE, DISTINCT = 12, 8  # length of the sequences compared, and the fewest distinct readings in them
MIRRORED = 0.15  # excess of the mirrored headings' correlation with the flow
NEAR_BINS = 3  # bins averaged for the flow
# Headings equal to the extreme one, ratio to the median count of the next values, and the number of those values.
AT_LIMIT, CROWDED, COMPARED_VALUES = 10, 10.0, 9
# Headings that fill a range from 0: width of its ends as a share of it, fewest headings there; the ranges and causes.
RANGE_END, RANGE_END_COUNT = 1 / 90, 5
RANGES = {
    180.0: "half of the circle was folded on the other (modulo 180, halved, or without a sign)",
    6.29: "they are radians",
}
# Consecutive windows pooled, largest lag in samples, and excess of the correlation at that lag over natural lags (at
# most 0.26 in 24 sound records, real water included), also in standard errors. Adjacent windows need half of it.
TOGETHER, MAX_LAG, LAG_EXCESS, LAG_SIGMAS = 3, 24, 0.3, 5.5
LEAST_LAG_S, MOST_LAG_S = 1800.0, 6 * HOUR_S  # a mooring turns minutes to some hours after the flow
# Smoothness of heading relative to flow, less the record's median, in two consecutive windows: at most 1.03 in the same
# records, 0.7 to 2.3 where headings were averaged over 6 samples, 1.1 to 3.0 over 12.
SMOOTHER, SMOOTHER_ALONE, TURNS_DEG = 1.1, 0.25, 2.0  # the last: least mean change between samples for this test
# Length of a run of readings; share of repeated readings in it from which it is flagged, where the median of the other
# changes exceeds HELD_STEPS times the resolution. Sound records have up to 0.09.
HELD_RUN, HELD_SHARE, HELD_STEPS = 100, 0.4, 5.0
# Readings far from the mean of neighbours on either side of north: number, share, and ratio to the share elsewhere.
ACROSS, ACROSS_SHARE, ACROSS_TIMES, BETWEEN_DEG, ASTRAY_DEG = 8, 0.2, 1.5, 100.0, 60.0
ACROSS_SIGMAS = 4.0  # standard errors by which their share exceeds that elsewhere
# A running mean over m samples has no power at multiples of 1/m: log10 of the power between them over that at them,
# median over the multiples, for unit vectors and for degrees as numbers. A mean of three has only one multiple.
SECTION, MEANS, NOTCH, NOTCH_OF_DEGREES = 1024, range(4, 37), 0.75, 1.2
# Larger of the headings' correlations with the previous reading and with the flow: lowest value 0.15, in one of 972
# sections of 23 sound records and a real one of 16 months, whole and thinned; at most 0.11 for reordered headings.
UNRELATED, STEADY, RELATED_STEP_S = 0.11, 0.97, 3 * HOUR_S  # the last: longest sampling interval tested
# Resolutions of compass counts (degrees), smallest and largest weight of a tested bit (degrees), changes of the higher
# bits after which it must have changed, and least share of readings in each eighth of the remaining sectors.
COUNTS_DEG, BIT_ERROR_DEG, BIT_CHANGES, BIT_FILLED = (0.01, 0.1, 360 / 4096, 360 / 65536), (2.0, 90.0), 24, 0.06
# Range of all headings, and share of steps over half of it: 1 in 4 if independent, 1 in 200 for a steady frame.
WRAPPED_DEG, WRAPPED_JUMPS = 5.0, 0.12
# Every k-th reading minus the mean direction of its neighbours: median, and median size relative to that of the other
# readings; at most 4.9 degrees and 1.8 in 34 records from a single compass, real water included.
PERIODS, INDEX_TURN_DEG, INDEX_SIGMAS, INDEX_TIMES, INDEX_LEAST_DEG = range(2, 13), 10.0, 6.0, 3.0, 2.0
LONGEST_STEP = 2.5  # longest time step to a neighbour, in median steps


def flag_altered(record: Record) -> Record:
    """Flag as doubtful headings that cannot be those by which the instrument rotated its velocities.

    Records of less than a month, as from a lowered package, are tested without comparing headings and flow.
    """
    record = _flag_across_north(_flag_stuck_bits(_flag_held(_flag_limits(_flag_repeated(record)))))
    record = _flag_wrapped(_flag_by_index(record))
    # Mean velocity of the good near bins, (n,), 0 where there is none.
    velocity = record.east[:, :NEAR_BINS] + 1j * record.north[:, :NEAR_BINS]
    good = np.isfinite(velocity) & (record.quality[:, :NEAR_BINS] < PROBABLY_BAD)
    flow = np.where(good, velocity, 0.0).sum(axis=1) / np.maximum(good.sum(axis=1), 1)
    speed = np.where(_usable(record), np.abs(flow), 0.0)
    if np.count_nonzero(speed) < FEWEST_WINDOWS * FEWEST or np.ptp(record.time_s) < FEWEST_WINDOWS * WINDOW_S:
        return record
    weight = np.minimum(speed, np.median(speed[speed > 0.0]))  # slow flow has no direction
    # Unit vectors of heading minus direction of flow, 0 where one is missing.
    towards = angles.direction(flow.real, flow.imag)
    direction = np.nan_to_num(angles.phasor(record.heading_deg - towards))
    flowing = direction != 0.0
    heading, current = angles.phasor(record.heading_deg[flowing]), angles.phasor(towards[flowing])
    as_recorded, mirrored = (float(_relation(way, current, weight[flowing])) for way in (heading, np.conj(heading)))
    if mirrored > max(FIRM, as_recorded + MIRRORED):
        note = (
            "the recorded headings turn with the flow where they are mirrored (counted anticlockwise), and not as they "
            "are: all are flagged doubtful; check the column of headings"
        )
        return flag_headings(record, np.ones(weight.shape, dtype=bool), note)
    number = np.floor((record.time_s - record.time_s[0]) / WINDOW_S).astype(int)
    altered = _far_windows(number, direction, weight)[number]
    text = (
        "are not those by which the velocities were turned, as the flow in the instrument's own frame shows: they are "
        "flagged doubtful, with five days on either side; check the column of headings"
    )
    record = _flag_some(record, altered, text)
    record = _flag_smoothed(_flag_late(record, towards, weight, number), towards, weight, number)
    return _flag_unrelated(_flag_running_means(record, flow), flow)


def _flag_late(record: Record, flow_deg: Floats, weight: Floats, number: NDArray[np.intp]) -> Record:
    """Flag windows in which the heading lags or leads the direction of flow by some samples.

    A mooring may turn hours after the flow: lags up to that of the whole record are regarded as natural.
    """
    both = np.where((weight[1:] > 0.0) & (weight[:-1] > 0.0), np.minimum(weight[1:], weight[:-1]), 0.0)
    changes = (angles.sin_cos(np.diff(angle))[0] for angle in (record.heading_deg, flow_deg))
    heading, flow = (np.nan_to_num(both * change) for change in changes)

    def pooled(values: Floats) -> Floats:
        total = np.bincount(number[1:], values, int(number[-1]) + 1)
        return np.convolve(total, np.ones(TOGETHER), "valid")

    lags = np.arange(-MAX_LAG, MAX_LAG + 1)
    size = np.sqrt(np.maximum(pooled(heading**2), 1e-12))
    shifted = (np.roll(flow, lag) for lag in lags)
    correlation = np.array([pooled(heading * f) / size / np.sqrt(np.maximum(pooled(f**2), 1e-12)) for f in shifted])
    # Above the largest value that chance gives over all lags and windows.
    least = np.maximum(LAG_EXCESS, LAG_SIGMAS / np.sqrt(np.maximum(pooled(np.sign(both)), 1.0)))
    step_s = float(np.median(np.diff(record.time_s)))
    own = int(lags[int(np.argmax(np.abs([heading @ np.roll(flow, lag) for lag in lags])))])
    own = own if 0 < own * step_s <= MOST_LAG_S else 0
    natural = (lags >= 0) & (lags <= own + (own > 0)) | (np.abs(lags) * step_s < LEAST_LAG_S)
    excess = (np.abs(correlation) - np.abs(correlation[natural]).max(axis=0)) / least
    lag, largest = int(np.argmax(excess.max(axis=1))), float(excess.max())
    if largest <= 1.0:
        return record
    late = np.convolve(excess[lag] > 0.5, np.ones(TOGETHER))[: int(number[-1]) + 1] > 0
    late = late | adjacent(late)  # an altered period may begin and end within a window
    text = (
        f"{'lag' if lags[lag] > 0 else 'lead'} the direction of flow by {abs(lags[lag])} samples, as no compass does: "
        "they are flagged doubtful; check the times of the column of headings"
    )
    return _flag_some(record, late[number], text)


def _flag_smoothed(record: Record, flow_deg: Floats, weight: Floats, number: NDArray[np.intp]) -> Record:
    """Flag windows whose headings are smoother than the flow allows, as after averaging or interpolation."""
    known, windows = weight > 0.0, int(number[-1]) + 1
    both = known[1:] & known[:-1]

    def roughness(angle_deg: Floats) -> tuple[Floats, Floats]:
        """Compute, per window, the summed change between samples and the correlation of successive changes."""
        change = np.where(both, np.nan_to_num(np.clip(angles.wrap180(np.diff(angle_deg)), -90.0, 90.0)), 0.0)
        first, second = np.where(both[1:] & both[:-1], np.stack([change[:-1], change[1:]]), 0.0)
        products = (np.bincount(number[2:], x, windows) for x in (first * second, first**2, second**2))
        product, before, after = products
        total = np.bincount(number[1:], np.abs(change), windows)
        return total + 1e-6, product / np.sqrt(before * after + 1e-6)

    series = record.heading_deg, flow_deg, record.heading_deg - flow_deg
    (turn, persistence), (_, persistence_of_flow), (relative, _) = map(roughness, series)
    smoothness = persistence - persistence_of_flow - np.log(turn / relative)
    count = np.bincount(number[1:], both, windows)
    enough = count >= FEWEST
    if not enough.any() or np.median((turn / np.maximum(count, 1.0))[enough]) < TURNS_DEG:
        return record  # a frame on the bottom does not turn
    # The heading must also be smooth by itself: the direction of slow flow is rough.
    excess, alone = (np.where(enough, x - np.median(x[enough]), 0.0) for x in (smoothness, persistence))
    pairs = (excess[1:] + excess[:-1] > 2.0 * SMOOTHER) & (alone[1:] + alone[:-1] > 2.0 * SMOOTHER_ALONE)
    smoothed = np.append(pairs, False) | np.append(False, pairs)
    text = (
        "are far smoother than the flow and the rest of the record: averaged or interpolated headings are not those by "
        "which the velocities were turned, and are flagged doubtful"
    )
    return _flag_some(record, smoothed[number], text)


def _flag_running_means(record: Record, flow: Complexes) -> Record:
    """Flag sections whose headings are running means, unless the velocities are the same running means."""
    known = np.flatnonzero(_usable(record))
    if len(known) < SECTION // 2:
        return record
    sections = _sections(known, min(SECTION, len(known)))
    heading = record.heading_deg[sections]
    of_flow = np.maximum(_notches(flow[sections]), 0.0)
    of_directions, of_degrees = (_notches(x) - of_flow for x in (angles.phasor(heading), heading))
    found = np.any((of_directions > NOTCH) | (of_degrees > NOTCH_OF_DEGREES), axis=1)
    text = (
        "are running means, by their spectrum, where the velocities are not: averaged headings are not those by which "
        "the velocities were turned, and are flagged doubtful"
    )
    return _flag_some(record, np.isin(np.arange(len(flow)), sections[found]), text)


def _sections(known: NDArray[np.intp], size: int) -> NDArray[np.intp]:
    """Divide samples into sections that overlap by half, the last ending at the last sample, (k, size)."""
    starts = np.unique(np.append(np.arange(0, len(known) - size + 1, size // 2), len(known) - size))
    return known[starts[:, None] + np.arange(size)]


def _relation(a: Complexes, b: Complexes, weight: Floats) -> Floats:
    """Compute the size of the weighted correlation of unit vectors about their means along the last axis."""
    weight = weight / weight.mean(axis=-1, keepdims=True)
    means = [np.mean(weight * x, axis=-1) for x in (a, b)]
    size = np.sqrt(np.prod([np.maximum(1.0 - np.abs(mean) ** 2, 1e-6) for mean in means], axis=0))
    return np.asarray(np.abs(np.mean(weight * a * np.conj(b), axis=-1) - means[0] * np.conj(means[1])) / size)


def _flag_unrelated(record: Record, flow: Complexes) -> Record:
    """Flag sections whose headings correlate neither with the previous reading nor with the flow, as if reordered.

    Sparse readings need not correlate: 512 of a real record, thinned to one in 6 hours, did not.
    """
    known = np.flatnonzero(_usable(record) & (np.abs(flow) > 0.0))
    if len(known) < SECTION // 2 or np.median(np.diff(record.time_s)) > RELATED_STEP_S:
        return record
    sections = _sections(known, SECTION // 2)
    heading = angles.phasor(record.heading_deg[sections])
    speed = np.abs(flow[sections])
    towards = angles.phasor(angles.direction(flow[sections].real, flow[sections].imag))
    weight = np.minimum(speed, np.median(speed, axis=1, keepdims=True))  # slow flow has no direction
    with_previous = _relation(heading[:, 1:], heading[:, :-1], np.ones(heading[:, 1:].shape))
    unrelated = np.maximum(with_previous, _relation(heading, towards, weight)) < UNRELATED
    unrelated &= np.abs(heading.mean(axis=1)) < STEADY  # a frame on the bottom does not turn
    text = (
        "go neither with the reading before nor with the flow: they are in another order or of another source, and are "
        "flagged doubtful; check the column of headings"
    )
    return _flag_some(record, np.isin(np.arange(len(flow)), sections[unrelated]), text)


def _notches(values: Complexes | Floats) -> Floats:
    """Compute log10 of the power between the multiples of 1/m over that at them, (sections, MEANS)."""
    length = values.shape[1] // 3
    pieces = np.lib.stride_tricks.sliding_window_view(values - values.mean(axis=1, keepdims=True), length, axis=1)
    power = np.abs(np.fft.fft(pieces[:, :: length // 2] * np.hanning(length))) ** 2 + 1e-9
    depths = []
    for m in MEANS:
        off = np.fft.fftfreq(length) - np.arange(1, m)[:, None] / m
        off = np.abs(off - np.rint(off))
        at, beside = off <= 0.75 / length, (off > 0.25 / m) & (off < 0.45 / m)
        ratio = (power @ beside.T / beside.sum(axis=1)) / (power @ at.T / at.sum(axis=1))
        depths.append(np.median(np.log10(ratio), axis=(1, 2)))
    return np.stack(depths, axis=1)


def _usable(record: Record) -> Bools:
    """Select the headings that exist and are not flagged, (n,)."""
    return np.isfinite(record.heading_deg) & (record.heading_quality < PROBABLY_BAD)


def _mean(direction: Complexes, weight: Floats) -> complex:
    return complex(np.sum(weight * direction) / weight.sum())


def _far_windows(number: NDArray[np.intp], direction: Complexes, weight: Floats) -> Bools:
    """Find the windows whose mean vector is far from the record's, and the adjacent windows, (w,)."""
    size = int(number[-1]) + 1
    total = np.bincount(number, weight, size)
    mean = np.bincount(number, weight * direction.real, size) + 1j * np.bincount(number, weight * direction.imag, size)
    mean = mean / np.maximum(total, 1e-12)
    enough = np.bincount(number, weight > 0.0, size) >= FEWEST
    if enough.sum() < FEWEST_WINDOWS:
        return np.zeros(size, dtype=bool)
    usual = complex(np.median(mean[enough].real), np.median(mean[enough].imag))
    away, turned = np.abs(mean - usual), np.abs(angles.wrap180(angles.argument(mean * np.conj(usual))))
    firm = np.minimum(np.abs(mean), abs(usual)) > FIRM
    least = max(OFF, OFF_TIMES * float(np.median(away[enough])))
    sure, far = (
        enough & ((away > times * least) | (firm & (turned > degrees)))
        for times, degrees in ((ALONE, ALONE_DEG), (1.0, TURNED_DEG))
    )
    far = sure | (far & adjacent(far))
    return np.asarray(far | adjacent(far))


def _flag_repeated(record: Record) -> Record:
    """Flag all copies of sequences of readings that occur more than once, as the original is unknown."""
    latest = np.maximum.accumulate(np.append(-np.inf, record.time_s[:-1]))
    later = record.time_s > latest  # a sample given twice is no repetition
    known = np.flatnonzero(later & _usable(record))
    if len(known) < SEQUENCE:
        return record
    runs = np.lib.stride_tricks.sliding_window_view(record.heading_deg[known].round(2), SEQUENCE)
    distinct = 1 + np.count_nonzero(np.diff(np.sort(runs, axis=1), axis=1), axis=1)
    varied = np.flatnonzero(distinct >= DISTINCT)
    _, index, count = np.unique(runs[varied], axis=0, return_inverse=True, return_counts=True)
    begins = varied[count[index.ravel()] > 1]
    repeated = np.zeros(record.heading_deg.shape, dtype=bool)
    repeated[known[(begins[:, None] + np.arange(SEQUENCE)).ravel()]] = True
    text = "repeat others to the last digit: part of the record was copied, and both places are flagged doubtful"
    return _flag_some(record, repeated, text)


def _flag_held(record: Record) -> Record:
    """Flag runs in which one reading is repeated for several samples although the compass turned."""
    known = np.flatnonzero(_usable(record))
    if len(known) <= HELD_RUN:
        return record
    change = np.abs(angles.wrap180(np.diff(record.heading_deg[known])))
    resolution = np.min(change[change > 0.0], initial=360.0)
    held = np.zeros(record.heading_deg.shape, dtype=bool)
    for run in np.array_split(np.arange(len(change)), len(change) // HELD_RUN):
        moved = change[run] > 0.0
        if 2 < np.count_nonzero(moved) <= (1.0 - HELD_SHARE) * len(run):
            held[known[run]] = np.median(change[run][moved]) > HELD_STEPS * resolution
    text = (
        "are repeated from sample to sample and then turn by many degrees: one reading stands for several samples, and "
        "they are flagged doubtful"
    )
    return _flag_some(record, held, text)


def _flag_across_north(record: Record) -> Record:
    """Flag all headings if readings between two neighbours on either side of north often point elsewhere."""
    known = record.heading_deg[_usable(record)]
    if len(known) < FEWEST:
        return record
    between = angles.wrap180(known[2:] - known[:-2])
    expected = angles.wrap360(known[:-2] + between / 2.0)
    near = np.abs(between) < BETWEEN_DEG
    astray = near & (np.abs(angles.difference(known[1:-1], expected)) > ASTRAY_DEG)
    sector = np.floor(angles.wrap360(expected + 15.0) / 30.0).astype(int) % 12
    count, of = (np.bincount(sector[which], minlength=12) for which in (astray, near))
    share = count / np.maximum(of, 1)
    usual = float(np.max(share[1:], where=of[1:] >= ACROSS, initial=0.0))
    chance = usual + ACROSS_SIGMAS * np.sqrt(usual * (1.0 - usual) / max(of[0], 1))
    if count[0] < ACROSS or share[0] < max(ACROSS_SHARE, ACROSS_TIMES * usual, chance):
        return record
    note = (
        f"{count[0]} of {of[0]} headings recorded between two that lie either side of north point elsewhere, as where "
        "degrees were averaged as numbers: all headings are flagged doubtful; average them as directions"
    )
    return flag_headings(record, np.ones(record.heading_deg.shape, dtype=bool), note)


def _flag_by_index(record: Record) -> Record:
    """Flag all headings if every k-th one differs from its neighbours, as where two recordings were interleaved.

    The first and the last reading of a burst have a neighbour that is far in time, and are not compared.
    """
    if len(record.time_s) < 2 * FEWEST:
        return record
    vectors = np.where(_usable(record), angles.phasor(record.heading_deg), np.nan)
    between = vectors[:-2] + vectors[2:]
    off = angles.difference(record.heading_deg[1:-1], angles.argument(between))
    step_s = np.diff(record.time_s)
    even = np.maximum(step_s[1:], step_s[:-1]) <= LONGEST_STEP * np.median(step_s)
    known = np.isfinite(off) & (np.abs(between) > 1.0) & even  # neighbours within 120 degrees
    index = np.arange(1, len(off) + 1)
    for period in PERIODS:
        for k in range(period):
            own, others = (known & ((index % period == k) == same) for same in (True, False))
            if min(own.sum(), others.sum()) < FEWEST:
                continue
            size, usual = (float(np.median(np.abs(off[part]))) for part in (own, others))
            turn, error = abs(float(np.median(off[own]))), 1.9 * size / np.sqrt(own.sum())  # 1.9: median of normal data
            if turn > max(INDEX_TURN_DEG, INDEX_SIGMAS * error) or size > INDEX_TIMES * max(usual, INDEX_LEAST_DEG):
                note = (
                    f"one heading in {period} differs from those before and after by {size:.0f} degrees, half of them "
                    f"by more, and the others by {usual:.0f}: two recordings may have been put together, and all "
                    "headings are flagged doubtful"
                )
                return flag_headings(record, np.ones(record.heading_deg.shape, dtype=bool), note)
    return record


def _flag_stuck_bits(record: Record) -> Record:
    """Flag runs of readings in which one bit of the count never changes although higher ones do."""
    known = np.flatnonzero(_usable(record))
    stuck = np.zeros(record.heading_deg.shape, dtype=bool)
    for step in COUNTS_DEG:
        exact = record.heading_deg[known] / step
        count = np.rint(exact).astype(np.int64)
        if np.abs(exact - count).max(initial=0.0) * step > 0.006:  # files have two decimals
            continue
        low, high = (int(np.floor(np.log2(error / step))) for error in BIT_ERROR_DEG)
        for bit in range(low + 1, high + 1):
            edges = np.concatenate([[0], np.flatnonzero(np.diff(count >> bit & 1)) + 1, [len(count)]])
            for run in np.flatnonzero(np.diff(edges) > BIT_CHANGES):
                inside = slice(edges[run], edges[run + 1])
                changes = np.count_nonzero(np.diff(count[inside] >> bit + 1))
                eighths = np.bincount((count[inside] & 2**bit - 1) * 8 >> bit, minlength=8)
                filled = eighths.min() >= BIT_FILLED * eighths.sum()
                stuck[known[inside]] |= changes >= BIT_CHANGES and filled
    text = "leave out every other sector of the circle: a bit of the reading is stuck, and they are flagged doubtful"
    return _flag_some(record, stuck, text)


def _flag_wrapped(record: Record) -> Record:
    """Flag all headings if they span a few degrees and jump across them: only the low byte of a count was stored."""
    known = record.heading_deg[_usable(record)]
    span = float(np.ptp(known)) if len(known) else 0.0
    if span > WRAPPED_DEG or len(np.unique(known)) < FEWEST:
        return record
    share = float(np.mean(np.abs(np.diff(known)) > span / 2.0))
    if share < WRAPPED_JUMPS:
        return record
    note = (
        f"all recorded headings lie within {span:.2f} degrees, and {share:.0%} of them jump across half of it between "
        "samples: higher bits of the reading are missing, and all are flagged doubtful"
    )
    return flag_headings(record, np.ones(record.heading_deg.shape, dtype=bool), note)


def _flag_limits(record: Record) -> Record:
    """Flag headings that were clipped at a limit, which many equal, and those that fill a range other than the circle.

    Headings that fill exactly half of it were taken modulo 180, halved, or have lost their sign; those that
    fill 0 to 6.28 are radians.
    """
    heading, known = record.heading_deg, _usable(record)
    if not known.any():
        return record
    for full, said in RANGES.items():
        ends = [np.count_nonzero(np.abs(heading[known] - end) <= RANGE_END * full) for end in (0.0, full)]
        if heading[known].max() <= full and min(ends) >= RANGE_END_COUNT:
            note = f"all recorded headings lie between 0 and {full:.4g}, up to both limits: {said}, all are doubtful"
            return flag_headings(record, known, f"{note}; check the column of headings")
    for limit in (heading[known].min(), heading[known].max()):
        at = known & (heading == limit)
        values, counts = np.unique(heading[known & ~at], return_counts=True)
        others = np.median(counts[np.argsort(np.abs(values - limit))[:COMPARED_VALUES]]) if len(values) else np.inf
        if at.sum() >= AT_LIMIT and at.sum() > CROWDED * others:
            note = f"{int(at.sum())} recorded headings are exactly {limit:g} degrees, the limit of all others"
            record = flag_headings(record, at, f"{note}: they were cut there, and are flagged doubtful")
    return record


def _flag_some(record: Record, which: Bools, text: str) -> Record:
    """Flag the selected headings, if any, with a note on their number, their time span and the fault."""
    if not which.any():
        return record
    first, last = (iso_time(when) for when in record.time_s[which][[0, -1]])
    return flag_headings(record, which, f"{int(which.sum())} recorded headings between {first} and {last} {text}")


def flag_headings(record: Record, which: Bools, *notes: str) -> Record:
    """Flag the selected headings as doubtful unless already worse, and add notes to the warnings."""
    flags = np.where(which & (record.heading_quality < PROBABLY_BAD), PROBABLY_BAD, record.heading_quality)
    return replace(record, heading_quality=flags.astype(np.int8), warnings=record.warnings + notes)
