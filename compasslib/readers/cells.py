"""Parse the cells of text tables as numbers."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence

import numpy as np

from compasslib.types import Floats

LARGEST = 1e30  # above any measurement in any unit; its square is still finite
MISSING_TEXT = frozenset({"", "nan", "na", "n/a", "null", "none", "-"})
NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", re.ASCII)


def parse_numbers(cells: Sequence[str], decimal: str | None = None, missing: Collection[str] = ()) -> Floats:
    """Parse cells as numbers, (n,): NaN for a missing one, infinite for what is no number.

    Args:
        decimal: mark; None accepts points and commas.
        missing: texts that stand for missing values, besides the usual ones.
    """
    words = MISSING_TEXT | {text.lower() for text in missing}
    plain = [text.replace(",", ".") for text in missing]
    fill_values = {float(text) for text in plain if NUMBER.fullmatch(text)}

    def parse(cell: str) -> float:
        number = cell.replace(",", ".") if decimal == "," or (decimal is None and "." not in cell) else cell
        if (decimal == "," and "." in cell) or not NUMBER.fullmatch(number) or abs(float(number)) >= LARGEST:
            return np.nan if cell.lower() in words else np.inf
        return np.nan if float(number) in fill_values else float(number)

    numbers = {cell: parse(cell) for cell in {*cells}}  # recordings repeat their values
    return np.array([numbers[cell] for cell in cells], dtype=float)
