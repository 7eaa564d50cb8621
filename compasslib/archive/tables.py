"""Tables of a mooring: corrected heading by recorded heading, and histograms before and after correction."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compasslib.archive.files import read_csv, write_csv
from compasslib.deviation.correction import LOOKUP_COLUMNS
from compasslib.deviation.histograms import BIN_DEG, BINS, QUANTITIES, Counts
from compasslib.types import Floats

HISTOGRAM_COLUMNS = ("quantity", "from_deg", "to_deg", "count")


def write_lookup(path: str | Path, table: Mapping[str, Floats]) -> None:
    """Write table.csv, the lookup table of headings; only its header where the table is empty."""
    forms = ("{:.0f}", "{:.3f}", "{:.3f}", "{:.3f}", "{:.0f}")
    write_csv(path, LOOKUP_COLUMNS, [table[name] for name in LOOKUP_COLUMNS], forms)


def write_histograms(path: str | Path, histograms: Mapping[str, Counts]) -> None:
    """Write histograms.csv, one row per bin."""
    begin = np.concatenate([QUANTITIES[name] + BIN_DEG * np.arange(BINS) for name in histograms])
    columns = (np.repeat(list(histograms), BINS), begin, begin + BIN_DEG, np.concatenate(list(histograms.values())))
    write_csv(path, HISTOGRAM_COLUMNS, columns, ("", "{:g}", "{:g}", "{:.0f}"))


def read_histograms(path: str | Path) -> dict[str, NDArray[np.int_]]:
    """Read the counts of histograms.csv by quantity, (72,) each.

    Raises:
        InputError: the file is missing or damaged.
    """
    columns = read_csv(path, ("quantity",))
    return {name: columns["count"][columns["quantity"] == name].astype(int) for name in QUANTITIES}
