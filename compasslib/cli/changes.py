"""How ``compass diff`` says what changed: cells that are alike, angles, coefficients, and the table."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from compasslib.cli import folders
from compasslib.report import words

SAME = "same"
LEAST = 0.01  # of a coefficient's standard deviation: below lies what a solver leaves


def from_to(old: str, new: str) -> str:
    """Return one cell."""
    return SAME if old == new else f"{old} → {new}"


def degrees(value: float) -> str:
    """Return the size of a change.

    Args:
        value: degrees.
    """
    return f"{words.significant(value, 3)}°" if value >= 0.01 else "below 0.01°"


def effects(diagnosis: Mapping[str, Any]) -> str:
    """Return the effects that were found.

    Args:
        diagnosis: content of diagnosis.json.
    """
    return ", ".join(one["effect"] for one in diagnosis["findings"]) or "none"


def coefficients(old: Mapping[str, Any], new: Mapping[str, Any]) -> str:
    """Return how the configured fit's coefficients changed, as configured; by its methods where these differ.

    Args:
        old: method, coefficients and covariance of a fit.
    """
    before, after = old["coefficients"], new["coefficients"]
    if old["method"] != new["method"]:
        return f"{old['method']} → {new['method']}"
    if before == after:
        return SAME
    if not (before and after):
        return "none → fitted" if after else "fitted → none"
    known = old["covariance"] or new["covariance"]
    sigma = np.sqrt(np.diag(known)) if known else np.zeros(len(after))
    change = [(letter, value - before[letter], s) for (letter, value), s in zip(after.items(), sigma, strict=True)]
    worth = [_in_sigmas(*each) for each in change if abs(each[1]) > LEAST * each[2]]
    return ", ".join(worth) or f"below {LEAST} of their 1σ"


def _in_sigmas(letter: str, change: float, sigma: float) -> str:
    """Return a coefficient's change, and how many of OLD's 1σ it is."""
    return f"{letter} {_signed(change)}" + (f" ({abs(change) / sigma:.2g}σ)" if sigma > 0.0 else "")


def row(
    folders_of: tuple[Path | None, Path | None], needed: Sequence[str], cells: Callable[[Path, Path], tuple[str, ...]]
) -> tuple[str, ...]:
    """Return one line's cells; none where nothing changed, a single one where the two cannot be compared.

    Args:
        folders_of: the results of the earlier and of the later run, None where there are none.
        needed: files that either must hold.

    Raises:
        InputError: a file is damaged.
    """
    old, new = folders_of
    if lacking := folders.lacking(old, new, needed):
        return (lacking,)
    assert old is not None and new is not None  # for the checker of types
    with folders.of_this_version(old):
        found = cells(old, new)
    return found if any(cell != SAME for cell in found) else ()


def _signed(change: float) -> str:
    return f"{change:+.2g}".replace("-", words.MINUS)


def table(header: Sequence[str], rows: Mapping[str, tuple[str, ...]]) -> str:
    """Return the rows beneath the header; a row of one cell runs across the columns.

    Args:
        rows: cells by name; none where nothing changed.
    """
    lines = [header, *((name, *(row or ("nothing changed",))) for name, row in rows.items())]
    columns = zip(*(line for line in lines if len(line) == len(header)), strict=True)
    widths = [max(len(cell) for cell in column) for column in columns]
    widths[0] = max(len(line[0]) for line in lines)
    padded = ([cell.ljust(width) for cell, width in zip(line, widths, strict=False)] for line in lines)
    return "\n".join("  ".join(cells).rstrip() for cells in padded)
