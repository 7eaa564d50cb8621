"""Valid times of a recording: single outlying times, clocks that were set back, what lies outside the deployment.

Samples are looked at in the order in which they were recorded. A clock that goes back into time that is already
recorded was set anew: what follows has times that nothing tells, and is left out, not shuffled into the rest.
"""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from compasslib.records import Record
from compasslib.types import Bools, Floats

SLACK_S = 3600.0  # steps back within this, or within SLACK_STEPS, are jitter, and order in time mends them
SLACK_STEPS = 5.0
CLASH, FEWEST = 0.05, 3  # share and number of a run's samples in time that another run has: more are no accident
SAME = 0.9  # of those in common time, where they repeat the other run value by value, the run was read twice
COVERED = 0.9  # of the deployment; a record that covers less is pointed at


def valid(record: Record) -> tuple[Bools, dict[str, int], list[str]]:
    """Return which samples have a valid time, (n,), counts of the others, and warnings about them.

    Args:
        record: samples in the order of the recording.
    """
    time_s = record.time_s
    finite = np.isfinite(time_s)
    keep = finite.copy()
    keep[finite] = ~_outlying(time_s[finite])
    wild = int(np.sum(~keep))
    runs = _runs(np.flatnonzero(keep), time_s)
    clashing = [run for k, run in enumerate(runs) if _clashes(run, runs, k, record)]
    for run in clashing:
        keep[run] = False
    lost = sum(len(run) for run in clashing)
    return keep, {"time_wild": wild, "clock_unsure": lost}, _warnings(wild, lost, clashing, time_s)


def coverage(time_s: Floats, inside: Bools, start_s: float, end_s: float) -> list[str]:
    """Return warnings where much lies outside the deployment, or much of the deployment has no sample.

    Args:
        time_s: UTC, (n,).
        inside: which lie inside, (n,).
    """
    if not len(time_s):
        return ["there is no sample with a time"]
    outside = time_s[~inside]
    span = f"{_day(time_s.min())} to {_day(time_s.max())}"
    if len(outside) > 0.5 * len(time_s):
        return [f"{len(outside)} of {len(time_s)} samples ({span}) lie outside the deployment: check clock and dates"]
    covered = np.ptp(time_s[inside]) / (end_s - start_s)
    if covered < COVERED:
        return [f"the record covers {covered:.0%} of the deployment ({_span(time_s[inside])})"]
    return []


def _slack(time_s: Floats) -> float:
    steps = np.abs(np.diff(time_s))
    return max(SLACK_S, SLACK_STEPS * float(np.median(steps))) if len(steps) else SLACK_S


def _outlying(time_s: Floats) -> Bools:
    """Tell single times that stand far from both neighbours, which follow each other."""
    outlying = np.zeros(time_s.shape, dtype=bool)
    if len(time_s) < FEWEST:
        return outlying
    slack, steps = _slack(time_s), np.diff(time_s)
    apart = (np.abs(steps[:-1]) > slack) & (np.abs(steps[1:]) > slack) & (steps[:-1] * steps[1:] < 0)
    across = time_s[2:] - time_s[:-2]
    outlying[1:-1] = apart & (across >= 0) & (across <= 2.0 * slack)
    # Two in turn can both look so, as of two recordings sample by sample: then none of them is an accident.
    return outlying & ~(np.roll(outlying, 1) | np.roll(outlying, -1))


def _runs(index: NDArray[np.intp], time_s: Floats) -> list[NDArray[np.intp]]:
    """Part samples where the clock goes back by more than jitter; those of few samples come last."""
    back = np.flatnonzero(np.diff(time_s[index]) < -_slack(time_s[index])) + 1
    return sorted(np.split(index, back), key=lambda run: len(run) < FEWEST) if len(index) else []


def _clashes(run: NDArray[np.intp], runs: list[NDArray[np.intp]], k: int, record: Record) -> bool:
    """Return whether a run stands in time that runs before it have filled with other values."""
    if k == 0:
        return False
    before = np.sort(np.concatenate(runs[:k]))
    before = before[np.argsort(record.time_s[before], kind="stable")]
    taken, at = record.time_s[before], record.time_s[run]
    right = np.clip(np.searchsorted(taken, at), 0, len(taken) - 1)
    left = np.clip(np.searchsorted(taken, at, side="right") - 1, 0, len(taken) - 1)
    filled = (at >= taken[left]) & (at <= taken[right]) & (taken[right] - taken[left] <= _slack(taken))
    if filled.sum() <= max(CLASH * len(run), min(FEWEST, len(run)) - 1):
        return False
    same = _equal(record, run[filled], before[left[filled]])
    return float(same.mean()) < SAME


def _equal(record: Record, one: NDArray[np.intp], other: NDArray[np.intp]) -> Bools:
    columns = [
        np.column_stack([x[:, None] if x.ndim == 1 else x]) for x in (record.heading_deg, record.east, record.north)
    ]
    values = np.hstack(columns)
    a, b = values[one], values[other]
    return np.asarray(((a == b) | (np.isnan(a) & np.isnan(b))).all(axis=1))


def _warnings(wild: int, lost: int, clashing: list[NDArray[np.intp]], time_s: Floats) -> list[str]:
    warnings = []
    if wild:
        warnings.append(f"{wild} samples have a time far from their neighbours' and were left out")
    if lost:
        spans = ", ".join(_span(time_s[run]) for run in clashing[:3])
        warnings.append(
            f"the clock was set back {len(clashing)} times into time already recorded: the {lost} samples after that "
            f"({spans} by their clock) were left out; give them as a file of their own with clock_offset_seconds"
        )
    return warnings


def _span(time_s: Floats) -> str:
    return f"{_day(time_s.min())} to {_day(time_s.max())}"


def _day(time_s: float) -> str:
    try:
        return f"{datetime.fromtimestamp(time_s, UTC):%Y-%m-%d}"
    except (ValueError, OverflowError, OSError):
        return f"{time_s:.3g} s"
