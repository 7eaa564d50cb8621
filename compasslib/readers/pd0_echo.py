"""Where the echo of a PD0 ensemble shows a boundary, and how far the instrument heard at all.

From one bin to the next the echo of water falls; surface and bottom stand far above it (in two genuine moored records
by 80 to 160 counts). A layer of animals rises by 10 to 20 dB at most.
"""

from __future__ import annotations

import numpy as np

from compasslib.readers.pd0_fields import Ensembles
from compasslib.records import Floats

BOUNDARY_COUNTS = 50  # above the least echo before it; 0.45 dB a count
HEARD_COUNTS = 15  # above the least echo of the ensemble, which is the noise of the receiver or more
BEAMS = 4


def echo_ranges(ensembles: Ensembles) -> Floats:
    """Return vertical ranges, (n, 2) metres, NaN where there is none: of a boundary, and of the last bin heard.

    Args:
        ensembles: n ensembles.
    """
    if not ensembles.echo.any():
        return np.full((len(ensembles), 2), np.nan)
    one, two, three, four = np.moveaxis(ensembles.echo, 2, 0)
    echo = one.astype(np.int16) + two + three + four  # six times as fast as a sum over the last axis
    beyond = np.arange(echo.shape[1]) >= ensembles.cells[:, None]
    ragged = beyond.any()
    if ragged:
        echo[beyond] = np.iinfo(np.int16).max
    least = np.minimum.accumulate(echo, axis=1)
    rise, loud = echo - least, echo - least[:, -1:]
    if ragged:
        rise[beyond] = loud[beyond] = 0
    strongest = rise.argmax(axis=1)
    last = echo.shape[1] - 1 - (loud > BEAMS * HEARD_COUNTS)[:, ::-1].argmax(axis=1)
    seen = np.column_stack([rise.max(axis=1, initial=0) > BEAMS * BOUNDARY_COUNTS, loud.any(axis=1)])
    ranges = ensembles.bin1_m[:, None] + ensembles.cell_m[:, None] * np.column_stack([strongest, last])
    return np.where(seen, ranges, np.nan)
