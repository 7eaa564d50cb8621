"""The step by which a recorded angle changes: the resolution of the instrument, or of the export."""

from __future__ import annotations

import numpy as np

from compasslib.types import Floats

RUN = 500  # samples in which the step is looked for
FEW_VALUES = 0.4  # distinct values among them; of one that steps by 1 degree there are more


def along(angle_deg: Floats) -> Floats:
    """Measure the step of a series of angles, sample by sample, (n,) degrees; 0 where it is too fine to tell.

    Args:
        angle_deg: (n,) in order of time, NaN where missing.
    """
    step = np.zeros(angle_deg.shape)
    known = np.flatnonzero(np.isfinite(angle_deg))
    for some in np.array_split(known, max(1, len(known) // RUN)):
        values = np.unique(angle_deg[some].round(2))
        if len(some) > RUN // 2 and 2 < len(values) < FEW_VALUES * len(some):
            step[some[0] : some[-1] + 1] = np.median(np.diff(values))
    return step


def sigma(step: Floats) -> Floats:
    """Return the standard error that steps leave, (n,): nobody knows whether they round down, up or to the nearest."""
    return step / np.sqrt(3.0)
