"""What an instrument's stamps stand for where a sample is a mean over minutes: its beginning, not its middle."""

from __future__ import annotations

import numpy as np

from compasslib.types import Floats

LONG_AVERAGE_S = 120.0  # whose middle lies a minute after its time
OVERLAP = 0.9  # of the time to the next sample that a mean takes at least; clocks are rounded to a second


def describe_averages(average_s: float, time_s: Floats) -> tuple[str, ...]:
    """Describe where the middle of averaged samples lies, if it is far from their times.

    Samples that follow each other faster than an average takes are no averages, whatever was set: single pings.

    Args:
        average_s: over which a sample is said to be a mean, beginning at its time; 0 or NaN where unknown.
        time_s: (n,) times of the samples in their order.
    """
    steps = np.diff(time_s)
    steps = steps[steps > 0.0]
    single = len(steps) > 0 and float(np.median(steps)) < OVERLAP * average_s
    if not average_s >= LONG_AVERAGE_S or single:
        return ()
    half = average_s / 2.0
    return (
        f"Each sample is the mean of {average_s:g} s from its time on: its middle is {half:g} s later; "
        f"clock_offset_seconds: -{half:g} moves it there.",
    )
