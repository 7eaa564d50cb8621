"""``compass diff``: what changed between two runs, mooring by mooring, as after a metadata fix."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import angles
from compasslib.archive_files import get, opened
from compasslib.command import folders
from compasslib.records import Floats
from compasslib.report import words

HEADER = ("mooring", "true heading, rms", "largest", "corrected", "verdict", "effects", "coefficients", "also changed")
SAME, INCOMPLETE = "same", 1
LEAST = 0.01  # of a coefficient's standard deviation: below lies what a solver leaves
NEEDED = ("TIME", "HEADING_CORRECTED", "DECLINATION")
# Follow from what stands in columns of its own.
TURNED = ("HEADING_CORRECTED", "DEVIATION", "BRANCH_PROBABILITY", "UCUR", "VCUR")
SHOWN = ("date_created", "history", "software_version", "correction_method", "correction_coefficients", "effects")


@dataclass(frozen=True)
class Held:
    """What one run says of one mooring."""

    series: Mapping[str, Any]  # variables of corrected.nc
    attributes: Mapping[str, Any]
    deviation: Mapping[str, Any]
    diagnosis: Mapping[str, Any]
    assessment: Mapping[str, Any]

    @property
    def true_deg(self) -> Floats:
        """Return the corrected true heading, (n,) degrees, NaN where there is none."""
        heading: Floats = self.series["HEADING_CORRECTED"] + self.series["DECLINATION"]
        return heading


def run(asked: Namespace) -> int:
    """Print one table, or that nothing changed.

    Args:
        asked: ``old`` and ``new``, each a cruise, a folder of results or one mooring's.

    Raises:
        InputError: there are no results, or one of their files is damaged.
    """
    old, new = folders.moorings(asked.old), folders.moorings(asked.new)
    if len(old) == len(new) == 1:  # one mooring's folder against its copy of another name
        old = dict(zip(new, old.values(), strict=True))
    rows = {name: _row(old.get(name), new.get(name)) for name in sorted(old | new)}
    print(_table(rows) if any(rows.values()) else f"nothing changed: {words.plural(len(rows), 'mooring')} compared")
    return INCOMPLETE if any(len(row) == 1 for row in rows.values()) else 0


def _row(old: Path | None, new: Path | None) -> tuple[str, ...]:
    """Return a mooring's cells; none where nothing changed, a single one where the two cannot be compared."""
    for folder, which in ((old, "OLD"), (new, "NEW")):
        if folder is None:
            return (f"not in {which}",)
        if files := folders.missing(folder):
            return (f"{which} is incomplete: no {files[0]}",)
    assert old is not None and new is not None  # for the checker of types
    before, after = _held(old), _held(new)
    with folders.of_this_version(old):
        cells = _compared(before, after)
    return cells if any(cell != SAME for cell in cells) else ()


def _held(folder: Path) -> Held:
    with opened(folder / "corrected.nc") as nc:
        series = {name: get(nc, name) for name in dict.fromkeys([*NEEDED, *nc.variables])}
        attributes = {name: nc.getncattr(name) for name in nc.ncattrs() if name not in SHOWN}
    files = (folders.content(folder / f"{file}.json") for file in ("deviation", "diagnosis", "assessment"))
    return Held(series, attributes, *files)


def _compared(old: Held, new: Held) -> tuple[str, ...]:
    turned = _turned(old, new)
    share = _told(words.percent(_share(old)), words.percent(_share(new)))
    found = (_told(old.diagnosis["verdict"], new.diagnosis["verdict"]), _told(_effects(old), _effects(new)))
    fitted = _coefficients(old.deviation, new.deviation)
    shown = {"assessment": turned[0], "diagnosis": "".join(found).replace(2 * SAME, SAME), "deviation": fitted}
    others = _variables(old, new, turned[0]) + _attributes(old, new)
    others += [f"{file}.json" for file, said in shown.items() if said == SAME and _file(old, file) != _file(new, file)]
    return (*turned, share, *found, fitted, ", ".join(others) or SAME)


def _file(held: Held, name: str) -> Any:
    return getattr(held, name)


def _told(old: str, new: str) -> str:
    return SAME if old == new else f"{old} → {new}"


def _turned(old: Held, new: Held) -> tuple[str, str]:
    """Return rms and largest turn of the true heading where both have one."""
    _, here, there = np.intersect1d(old.series["TIME"], new.series["TIME"], return_indices=True)
    turn = angles.difference(new.true_deg[there], old.true_deg[here])
    turn = turn[np.isfinite(turn)]
    if not turn.size:
        nowhere = SAME if not (np.isfinite(old.true_deg).any() or np.isfinite(new.true_deg).any()) else "none in both"
        return nowhere, nowhere
    if not turn.any():
        return SAME, SAME
    return _degrees(float(np.sqrt(np.mean(turn**2)))), _degrees(float(np.max(np.abs(turn))))


def _degrees(value: float) -> str:
    return f"{words.significant(value, 3)}°" if value >= 0.01 else "below 0.01°"


def _share(held: Held) -> float:
    corrected = np.isfinite(held.series["HEADING_CORRECTED"])
    return float(corrected.mean()) if corrected.size else 0.0


def _effects(held: Held) -> str:
    return ", ".join(one["effect"] for one in held.diagnosis["findings"]) or "none"


def _coefficients(old: Mapping[str, Any], new: Mapping[str, Any]) -> str:
    """Return how the configured fit's coefficients changed, as configured; by its methods where these differ."""
    before, after = old["coefficients"], new["coefficients"]
    if old["method"] != new["method"]:
        return f"{old['method']} → {new['method']}"
    if before == after:
        return SAME
    if not (before and after):
        return "none → fitted" if after else "fitted → none"
    sigma = np.sqrt(np.diag(new["covariance"])) if new["covariance"] else np.zeros(len(after))
    change = {letter: value - before[letter] for letter, value in after.items()}
    worth = [letter for letter, s in zip(change, sigma, strict=True) if abs(change[letter]) > LEAST * s]
    return ", ".join(f"{letter} {_signed(change[letter])}" for letter in worth) or f"below {LEAST} of their 1σ"


def _signed(change: float) -> str:
    return f"{change:+.2g}".replace("-", words.MINUS)


def _variables(old: Held, new: Held, turned: str) -> list[str]:
    """Return the variables of corrected.nc that differ, those left out that turn with the heading."""
    names = dict.fromkeys([*old.series, *new.series])
    differing = [name for name in names if not _equal(old.series.get(name), new.series.get(name))]
    if turned == SAME:
        return differing
    return [name for name in differing if not any(name in (v, f"{v}_QC", f"{v}_UNCERTAINTY") for v in TURNED)]


def _attributes(old: Held, new: Held) -> list[str]:
    keys = dict.fromkeys([*old.attributes, *new.attributes])
    return [f"attribute {key}" for key in keys if not _equal(old.attributes.get(key), new.attributes.get(key))]


def _equal(one: Any, other: Any) -> bool:
    if one is None or other is None:
        return False
    one, other = np.asarray(one), np.asarray(other)
    return one.shape == other.shape and bool(np.array_equal(one, other, equal_nan=one.dtype.kind == "f"))


def _table(rows: Mapping[str, tuple[str, ...]]) -> str:
    """Return the rows beneath the header; a row of one cell runs across the columns."""
    lines = [HEADER, *((name, *(row or ("nothing changed",))) for name, row in rows.items())]
    columns = zip(*(line for line in lines if len(line) == len(HEADER)), strict=True)
    widths = [max(len(cell) for cell in column) for column in columns]
    widths[0] = max(len(line[0]) for line in lines)
    padded = ([cell.ljust(width) for cell, width in zip(line, widths, strict=False)] for line in lines)
    return "\n".join("  ".join(cells).rstrip() for cells in padded)
