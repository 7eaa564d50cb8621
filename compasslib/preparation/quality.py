"""Quality control: velocities by a table of checks, headings by stuck, constant or misread compasses.

Impossible values are flagged and counted; values that are possible but uninformative cause a warning.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.records import BAD, GOOD, LEAST_PERCENT_GOOD, MISSING, PROBABLY_BAD, PROBABLY_GOOD, Record, pieces, take
from compasslib.types import HOUR_S, Bools, Floats


@dataclass(frozen=True)
class Thresholds:
    """Thresholds of the checks; None disables one."""

    percent_good: float = LEAST_PERCENT_GOOD  # minimum, %
    correlation: float | None = None  # minimum that three beams must reach, counts
    error_velocity: float | None = None  # maximum, m/s
    echo: float | None = None  # minimum that three beams must reach, counts
    echo_jump: float | None = None  # maximum difference between adjacent bins, counts
    spike: float | None = None  # maximum difference from the running median, robust standard deviations
    tilt_deg: float = 45.0  # maximum pitch or roll; instruments do not compensate more
    speed: float = 5.0  # maximum, m/s, above any ocean current
    side_lobe: bool = True  # whether to flag cells contaminated by side-lobe echoes from surface or bottom


# Defaults of the instruments, commands WC and WE of the WorkHorse and Sentinel V manuals (Teledyne RDI 2015, 2017);
# the reader of Signature files applies Nortek's 50 %.
_RDI = {"correlation": 64.0, "error_velocity": 2.0}
MAKERS: Mapping[str, Mapping[str, float]] = dict.fromkeys(("pd0", "pd12", "rdi_text"), _RDI)  # by format


@dataclass(frozen=True)
class Check:
    """A check of velocities; those without ``failed`` are flagged by the reader, the user or the heading.

    Meanings name the source: IOOS QARTOD (2019, in-situ currents) or the IMOS toolbox, where they have the same check.
    """

    count: str  #: key of the number of velocities flagged
    meaning: str  #: flag meaning in the product
    #: which velocities fail, broadcastable to (n, m), of a record with a threshold in water of a depth, m
    failed: Callable[[Record, Any, float], Bools] | None = None
    threshold: str = ""  #: field of ``Thresholds``, if there is one
    profile: str = ""  #: profile of the record that is needed, if any
    sentence: str = ""  #: of the warning, formatted with the thresholds; empty where failures are natural
    heading: bool = False  #: whether the heading is doubtful then
    by_sample: bool = False  #: whether samples are tested without others, so that years of them need not fit in memory


def _third_beam(record: Record, profile: str) -> NDArray[np.int16]:
    """Compute the counts that three beams reach, as a velocity needs, (n, m); -1 is missing."""
    counts = np.asarray(record.profiles[profile][:]).astype(np.int16)
    counts[counts < 0] = np.iinfo(np.int16).max
    counts.sort(axis=2)
    return np.asarray(counts[..., max(counts.shape[2] - 3, 0)])


def _past_echo_jump(record: Record, most: float, _: float) -> Bools:
    """Find bins from a jump of the echo in two beams on, in the farther half (IMOS, imosEchoIntensityVelocitySetQC)."""
    jumps = np.abs(np.diff(np.asarray(record.profiles["echo"][:]).astype(np.int16), axis=1)) > most
    failed = np.pad(jumps.sum(axis=2) >= 2, ((0, 0), (1, 0)))
    failed[:, : round(failed.shape[1] / 2)] = False
    return np.asarray(np.maximum.accumulate(failed, axis=1))


def _spikes(record: Record, most: float, _: float) -> Bools:
    """Find velocities far off the median of five samples and three bins (Hampel's identifier; Davies and Gather 1993).

    The scale of each bin is 1.4826 times the median of the differences.
    """
    usable = record.quality <= PROBABLY_GOOD
    flow = np.where(usable, record.east.astype(float) + 1j * record.north, complex(np.nan, np.nan))
    around = np.pad(flow, ((2, 2), (1, 1)), constant_values=complex(np.nan, np.nan))
    failed = np.zeros(usable.shape, dtype=bool)
    for k in np.flatnonzero(usable.any(axis=0)):
        here = np.flatnonzero(usable[:, k])
        window = np.lib.stride_tricks.sliding_window_view(around[:, k : k + 3], 5, axis=0)[here].reshape(len(here), -1)
        off = np.abs(flow[here, k] - np.nanmedian(window.real, axis=1) - 1j * np.nanmedian(window.imag, axis=1))
        failed[here, k] = (off > most * 1.4826 * np.median(off)) & (np.median(off) > 0.0)
    return failed


def _on_deck(record: Record, _: None, water_depth: float) -> Bools:
    """Find depths near the surface in a record with few depths between them and its own, as of eh2 before deployment.

    Profilers, which pass through all levels, and instruments above 15 m are not tested.
    """
    deepest = np.nanpercentile(record.depth_m, 90.0) if np.isfinite(record.depth_m).any() else 0.0
    shallow, between = record.depth_m < 0.2 * deepest, record.depth_m < 0.5 * deepest
    return (shallow & (deepest >= 15.0) & (np.sum(between & ~shallow) <= 0.01 * len(shallow)))[:, None]


def _room(record: Record, water_depth: float) -> Floats:
    """Compute the distance to the boundary that a profiler looks at, (n, 1) m."""
    return (record.depth_m if record.looks_up else water_depth - record.depth_m)[:, None]


def _beyond(record: Record, _: None, water_depth: float) -> Bools:
    several = record.bin_range_m.shape[1] > 1
    return several & (record.bin_range_m > _room(record, water_depth))


def _in_side_lobe(record: Record, wanted: bool, water_depth: float) -> Bools:
    """Find bins whose side-lobe echo of surface or bottom arrives with theirs, but not those beyond it."""
    steps = np.abs(_steps(record))
    cell_m = float(np.nanmedian(steps)) if np.isfinite(steps).any() else 0.0
    reach = _room(record, water_depth) * angles.sin_cos(record.beam_angle_deg)[1] - cell_m / 2.0
    return wanted & (record.bin_range_m > reach) & ~_beyond(record, None, water_depth) & (steps.size > 0)


def _steps(record: Record) -> Floats:
    """Compute the distances of successive bins, (n, m - 1) m, or (1, m - 1) where all samples share one row."""
    shared = not record.bin_range_m.strides[0]
    return np.diff(record.bin_range_m[:1] if shared else record.bin_range_m, axis=1)


def _frozen(record: Record, _: None, water_depth: float) -> Bools:
    """Find runs of samples whose velocities repeat the previous ones in all bins; all-zero samples are not tested."""
    steps = max(len(record.time_s) - 1, 0)
    same, moving = np.ones(steps, dtype=bool), np.zeros(steps, dtype=bool)
    for column in (*record.east.T, *record.north.T):
        known = np.nan_to_num(column)
        same &= known[1:] == known[:-1]
        moving |= known[1:] != 0.0
    throughout = steps >= 24 and bool((same & moving).all())
    return (_stuck(same & moving, record.time_s) | throughout)[:, None]


def _zero_filled(record: Record, _: None, water_depth: float) -> Bools:
    """Find velocities of exactly zero in bins where they stand for missing values.

    A current passes through slow speeds when it turns, and a rotor stops below 2 cm/s (Aanderaa RCM). Zeros are
    therefore missing values if more of them than of the speeds below 3 cm/s lie between two speeds above 10 cm/s. Zeros
    in sequence are, if the instrument resolves speeds below 1 cm/s, as a rotor does not.
    """
    fast_m_s, slow_m_s, least_m_s, fewest = 0.10, 0.03, 0.01, 4
    filled = np.zeros(record.east.shape, dtype=bool)
    for column, east, north in zip(filled.T, record.east.T, record.north.T, strict=True):
        speed = np.hypot(east, north)
        zero, moving = np.flatnonzero(speed == 0.0), np.flatnonzero(speed > 0.0)
        if len(zero) < fewest or not len(moving):
            continue
        flow, before = np.pad(speed[moving], 1), np.searchsorted(moving, zero)
        amid = int(np.sum(np.minimum(flow[before], flow[before + 1]) > fast_m_s))
        turning = int(np.sum((flow[1:-1] < slow_m_s) & (np.minimum(flow[:-2], flow[2:]) > fast_m_s)))
        in_sequence = np.bincount(before)[before] >= fewest
        resolved = np.sum(speed[moving] < least_m_s) >= fewest
        column[zero] = (amid > max(turning, fewest - 1)) | (in_sequence & resolved)
    return filled


CHECKS = (  # in the order of their bits
    Check("flagged_in_file", "flagged_in_file"),
    Check("low_percent_good", "qartod_percent_good"),
    Check("low_correlation", "qartod_correlation_magnitude",
          lambda record, least, _: _third_beam(record, "correlation") < least,
          threshold="correlation", profile="correlation", sentence="correlations below {correlation:g} counts",
          by_sample=True),
    Check("large_error_velocity", "qartod_error_velocity",
          lambda record, most, _: np.abs(np.asarray(record.profiles["error_velocity"][:])) > most,
          threshold="error_velocity", profile="error_velocity",
          sentence="error velocities above {error_velocity:g} m/s", by_sample=True),
    Check("weak_echo", "qartod_echo_intensity", lambda record, least, _: _third_beam(record, "echo") < least,
          threshold="echo", profile="echo", sentence="echoes below {echo:g} counts", by_sample=True),
    Check("impossible_speed", "qartod_current_speed",
          lambda record, most, _: np.hypot(record.east, record.north) > most,
          threshold="speed", sentence="faster than {speed:g} m/s", by_sample=True),
    Check("frozen_velocity", "qartod_flat_line", _frozen, sentence="the same to the last digit for hours"),
    Check("steep_tilt", "imos_tilt",
          lambda record, most, _: (np.fmax(np.abs(record.pitch_deg), np.abs(record.roll_deg)) > most)[:, None],
          threshold="tilt_deg", sentence="tilted too far", heading=True),
    Check("impossible_depth", "imos_impossible_depth",  # by more than offsets of sensors and errors of charts
          lambda record, _, depth: ((record.depth_m < -10.0) | (record.depth_m > 1.2 * depth))[:, None],
          sentence="the instrument's depth lies above the surface or below the bottom"),
    Check("out_of_water", "imos_in_out_water", _on_deck, heading=True,
          sentence="out of the water by the instrument's own depth; correct start and end of the deployment"),
    Check("side_lobe", "imos_side_lobe", _in_side_lobe, threshold="side_lobe"),
    Check("beyond_boundary", "beyond_surface_or_bottom", _beyond),
    Check("bins_without_length", "bins_without_length",  # as where the cell length was lost
          lambda record, _, depth: (_steps(record) == 0.0).any(axis=1)[:, None],
          sentence="bins of no length, whose depths nothing tells"),
    Check("excluded", "excluded_by_operator"),
    Check("heading", "heading"),
    Check("echo_jump", "imos_echo_intensity_velocity", _past_echo_jump, threshold="echo_jump", profile="echo",
          sentence="at or beyond a jump of the echo by more than {echo_jump:g} counts"),
    Check("spike", "qartod_spike", _spikes, threshold="spike",
          sentence="more than {spike:g} robust standard deviations off the running median"),
    Check("flagged_by_hand", "flagged_by_operator"),
    Check("zero_filled", "zero_filled", _zero_filled, sentence="exactly zero amid a current, as missing values"),
)  # fmt: skip
MASKS = {check.count: np.int32(1 << k) for k, check in enumerate(CHECKS)}


def flag_quality(
    record: Record, water_depth: float, *, affected: bool = False, thresholds: Thresholds | None = None
) -> Record:
    """Flag and count impossible values, and warn of uninformative sensors, and of the unit of an affected compass."""
    limits = asdict(thresholds or Thresholds())
    record = _flag_read(record, limits["percent_good"])
    # Cells outside the water before those of weak signals, whose warning then does not count them; spikes last, as the
    # median leaves out what is flagged.
    for check in sorted(CHECKS, key=lambda check: (check.failed is _spikes, check.by_sample)):
        limit = limits.get(check.threshold)
        absent = (check.threshold and limit is None) or (check.profile and check.profile not in record.profiles)
        if check.failed and not absent:
            parts = map(partial(take, record), pieces(len(record.time_s))) if check.by_sample else [record]
            with np.errstate(invalid="ignore"):
                failed = np.concatenate([check.failed(part, limit, water_depth) for part in parts])
            record = flag_velocities(record, failed, check.count, check.sentence.format(**limits))
            record = flag_headings(record, failed[:, 0]) if check.heading else record
    # Headings that change by less than a compass's noise between samples for hours.
    with np.errstate(invalid="ignore"):
        same = np.abs(angles.difference(record.heading_deg[1:], record.heading_deg[:-1])) <= 0.1
    still = _stuck(same, record.time_s) & (record.heading_quality < PROBABLY_BAD)
    number = int(still.sum())
    note = f"{number} headings flagged: the compass stood still within 0.1 degrees for hours"
    record = replace(record, counts={**record.counts, "heading_stuck": number})
    record = _flag_heading_fills(flag_headings(record, still, *[note] * (number > 0)))
    return _constant_sensors(flag_unit(record) if affected else record)


def flag_velocities(record: Record, where: Bools, count: str, sentence: str = "") -> Record:
    """Flag velocities as bad that were good or probably good, count them, and warn if a sentence describes them."""
    failed = np.broadcast_to(where, record.quality.shape) & (record.quality != MISSING)
    tests = np.zeros(failed.shape, dtype=np.int32) if record.tests is None else record.tests
    if failed.any():
        tests = tests.copy()
        tests[failed] |= MASKS[count]
    hit = failed & (record.quality <= PROBABLY_GOOD)
    number = int(np.sum(hit))
    share = float(f"{100.0 * number / max(hit.size, 1):.2g}")  # without exponent
    notes = (f"{number} velocities flagged: {sentence} ({share:g} %)",) if sentence and number else ()
    quality = np.where(hit, BAD, record.quality).astype(np.int8)
    counts = {**record.counts, count: number}
    return replace(record, quality=quality, counts=counts, warnings=record.warnings + notes, tests=tests)


def flag_headings(record: Record, which: Bools, *notes: str) -> Record:
    """Flag the selected headings as doubtful unless already worse, and add notes to the warnings."""
    flags = np.where(which & (record.heading_quality < PROBABLY_BAD), PROBABLY_BAD, record.heading_quality)
    return replace(record, heading_quality=flags.astype(np.int8), warnings=record.warnings + notes)


def flag_unit(record: Record) -> Record:
    """Flag all headings as doubtful where they fill half of a circle to both ends, or are radians."""
    known = np.isfinite(record.heading_deg) & (record.heading_quality < PROBABLY_BAD)
    folded = "half of the circle was folded on the other (modulo 180, halved, or without a sign)"
    for full, cause in ((180.0, folded), (6.29, "they are radians")):
        share = record.heading_deg[known] / full
        # Five headings within 2 degrees, or as large a part of radians, of both ends; none beyond.
        if share.max(initial=0.0) <= 1.0 and min(np.sum(share < 1 / 90), np.sum(share > 89 / 90)) >= 5:
            note = f"all recorded headings lie between 0 and {full:.4g}, up to both limits: {cause}, all are doubtful"
            return flag_headings(record, known, f"{note}; check the column of headings")
    return record


def _flag_read(record: Record, least: float) -> Record:
    """Attribute the reader's flags to a check, and apply a percent-good threshold other than the reader's."""
    flagged = (record.quality > PROBABLY_GOOD) & (record.quality != MISSING)
    if "percent_good" not in record.profiles or least == LEAST_PERCENT_GOOD:
        tests = np.zeros(flagged.shape, dtype=np.int32)
        tests[flagged] = MASKS["low_percent_good" if "percent_good" in record.profiles else "flagged_in_file"]
        return replace(record, tests=tests)
    percent = np.asarray(record.profiles["percent_good"][:], dtype=float)
    if percent.ndim == 3 and percent.shape[2] != 4:
        percent = percent.min(axis=2)
    elif percent.ndim == 3 and record.recorded_in != "beam":
        percent = percent[..., 0] + percent[..., 3]  # the three- and four-beam solutions
    elif percent.ndim == 3:
        ordered = np.sort(percent, axis=2)
        error = np.asarray(record.profiles.get("error_velocity", percent[..., 0])[:])
        percent = np.where(np.isnan(error), ordered[..., 1], ordered[..., 0])  # of three beams the second lowest
    allowed = flagged & (percent >= least) & (percent < LEAST_PERCENT_GOOD)
    quality = np.where(allowed, GOOD, record.quality).astype(np.int8)
    tests = np.where(flagged & ~allowed, MASKS["low_percent_good"], np.int32(0))
    sentence = f"fewer than {least:g} % of the pings were good"
    return flag_velocities(replace(record, quality=quality, tests=tests), percent < least, "low_percent_good", sentence)


def _flag_heading_fills(record: Record) -> Record:
    """Flag headings of a value that a logger writes in place of a missing one: frequent, and far off before and after.

    Arrivals at a value are counted, not samples: a compass that rests has no fill value. Two real records (eh2, papa)
    lose no heading; with a 0 written into every 37th or 90th sample, they lose these and no other.
    """
    known = np.flatnonzero(np.isfinite(record.heading_deg) & (record.heading_quality < PROBABLY_BAD))
    heading = record.heading_deg[known]
    distinct, place = np.unique(heading.round(2), return_inverse=True)
    if len(distinct) < 24:
        return record
    count = np.bincount(place[np.append(True, place[1:] != place[:-1])], minlength=len(distinct))
    k = int(np.argmax(count))
    beside = np.sort(count[np.arange(k - 5, k + 6) % len(count)])[-2]
    others = np.flatnonzero(place != k)
    after = np.searchsorted(others, np.flatnonzero(place == k))
    ends = [heading[others[np.clip(at, 0, len(others) - 1)]] for at in (after - 1, after)]
    off = np.min([np.abs(angles.difference(end, distinct[k])) for end in ends], axis=0)
    usual = float(np.median(np.abs(angles.difference(heading[1:], heading[:-1]))))
    if count[k] < 6 + 3 * beside or np.median(off) <= min(2.0 * usual + 5.0, 45.0):
        return record
    flags = record.heading_quality.copy()
    flags[known[place == k]] = BAD
    note = f"{len(after)} headings flagged: they read {distinct[k]:.2f} degrees, a fill value far off those around"
    return replace(record, heading_quality=flags, warnings=(*record.warnings, note))


def _stuck(same: Bools, time_s: Floats) -> Bools:
    """Find runs of 12 samples and 6 hours or more that repeat the one before, unless all of the series often does."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]])))
    runs = edges.reshape(-1, 2)  # first and last sample of each
    length = runs[:, 1] - runs[:, 0]
    runs = runs[(time_s[runs[:, 1]] - time_s[runs[:, 0]] >= HOUR_S * 6.0) & (length >= 12)]
    stuck = np.zeros(len(time_s), dtype=bool)
    for begin, end in runs:
        stuck[begin + 1 : end + 1] = True
    share = float(same[~stuck[1:]].mean()) if not stuck[1:].all() else 1.0
    explained = any(len(time_s) * share ** (end - begin) > 1e-3 for begin, end in runs)
    return stuck & (not explained)


def _constant_sensors(record: Record) -> Record:
    """Count samples of sensors that never vary, and warn."""
    known = [x[np.isfinite(x)] for x in (record.pitch_deg, record.roll_deg, record.heading_deg)]
    no_pitch, no_roll, stuck = (len(x) >= 24 and np.ptp(x) == 0.0 for x in known)
    counts, notes = {"tilt_frozen": 0, "heading_frozen": 0}, []
    if no_pitch and no_roll:
        counts["tilt_frozen"] = len(known[0])
        notes.append("pitch and roll never change: the tilt sensor is stuck or was not fitted, its tilts tell nothing")
    if stuck:
        counts["heading_frozen"] = len(known[2])
        notes.append(f"the compass shows {known[2][0]:.2f} degrees all the time: it is stuck, and no heading is used")
    record = replace(record, counts=record.counts | counts)
    return flag_headings(record, np.full(record.time_s.shape, stuck), *notes)
