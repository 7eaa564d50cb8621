"""``compass diff``: what changed between two runs, by mooring and calibration, as after a metadata fix."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import angles
from compasslib.archive.attributes import DATES
from compasslib.archive.files import get, opened
from compasslib.cli import changes, diff_calibrations, folders, versions
from compasslib.cli.changes import SAME, coefficients, degrees, effects, from_to, table
from compasslib.pipeline import reasons
from compasslib.report import words
from compasslib.types import Floats

HEADER = (
    *("mooring", "true heading, rms", "largest", "in OLD's 1σ: median, 95 %, largest", "corrected", "flags"),
    *("verdict", "effects", "coefficients", "also changed"),
)
# What a column, or a variable of "also changed", is called in the changelog.
CHANGES = {
    **{"true heading, rms": "headings", "corrected": "flags", "flags": "flags", "verdict": "verdict"},
    **{"effects": "verdict", "coefficients": "coefficients"},
}
SIGMA, FLAG = "HEADING_CORRECTED_UNCERTAINTY", "HEADING_CORRECTED_QC"
INCOMPLETE = 1
Row = Callable[[Path | None, Path | None], tuple[str, ...]]
NEEDED = ("TIME", "HEADING_CORRECTED", "DECLINATION")
# Follow from what stands in columns of its own.
TURNED = ("HEADING_CORRECTED", "HEADING_TRUE", "DEVIATION", "BRANCH_PROBABILITY", "UCUR", "VCUR")
SHOWN = (
    *(*DATES, "history", "software_version", "product_version"),
    *("correction_method", "correction_coefficients", "effects"),
)


@dataclass(frozen=True)
class MooringRun:
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
    """Print a table of moorings and one of calibrations, those in which something changed, or that nothing did.

    Args:
        asked: ``old`` and ``new``, each a cruise, a folder of results, or that of one mooring or calibration.

    Raises:
        InputError: there are no results, or one of their files is damaged.
    """
    old, new = (folders.results(place) for place in (asked.old, asked.new))
    moorings = _rows(old.moorings, new.moorings, _row)
    calibrations = _rows(old.calibrations, new.calibrations, diff_calibrations.row)
    changed = [(HEADER, moorings), (diff_calibrations.HEADER, calibrations)]
    sections = [table(*one) for one in changed if any(one[1].values())]
    sections += _settings(old.moorings, new.moorings, moorings)
    sections += _reasons(old.moorings, new.moorings, moorings)
    sections += diff_calibrations.reasons(old.calibrations, new.calibrations, calibrations)
    print("\n\n".join(sections) or _nothing(moorings, calibrations))
    return INCOMPLETE if any(len(row) == 1 for rows in (moorings, calibrations) for row in rows.values()) else 0


def _rows(old: Mapping[str, Path], new: Mapping[str, Path], row: Row) -> dict[str, tuple[str, ...]]:
    if len(old) == len(new) == 1:  # one folder against its copy of another name
        old = dict(zip(new, old.values(), strict=True))
    return {name: row(old.get(name), new.get(name)) for name in sorted({*old, *new})}


def _settings(old: Mapping[str, Path], new: Mapping[str, Path], rows: Mapping[str, tuple[str, ...]]) -> list[str]:
    """Return which settings and raw files of the changed moorings are others, where records of the jobs are there."""
    both = {name: (old.get(name) or next(iter(old.values())), new[name]) for name, row in rows.items() if len(row) > 1}
    lines = [f"  {name}: {text}" for name, sides in both.items() for text in reasons.between(*sides)]
    return ["\n".join(["Settings and raw files that differ:", *lines])] if lines else []


def _reasons(old: Mapping[str, Path], new: Mapping[str, Path], rows: Mapping[str, tuple[str, ...]]) -> list[str]:
    """Return for each pair of versions what in the changelog may have changed the moorings."""
    changed: dict[tuple[str, str], set[str]] = {}
    for name, row in rows.items():
        if len(row) == len(HEADER) - 1:
            sides = _software(old.get(name) or next(iter(old.values()))), _software(new[name])
            cells = dict(zip(HEADER[1:], row, strict=True))
            named = {what for column, what in CHANGES.items() if cells[column] != SAME}
            named |= {"uncertainty"} if SIGMA in cells["also changed"] else set()
            changed.setdefault(sides, set()).update(named)
    return [
        "\n".join(lines) for sides, named in changed.items() if named and (lines := versions.reasons(*sides, named))
    ]


def _software(folder: Path) -> str:
    with opened(folder / "corrected.nc") as nc:
        return str(getattr(nc, "software_version", ""))


def _nothing(moorings: Mapping[str, Any], calibrations: Mapping[str, Any]) -> str:
    parts = ((moorings, "mooring"), (calibrations, "calibration"))
    compared = [words.plural(len(rows), noun) for rows, noun in parts if rows]
    return f"nothing changed: {words.listed(compared)} compared"


def _row(old: Path | None, new: Path | None) -> tuple[str, ...]:
    """Return a mooring's cells; none where nothing changed, a single one where the two cannot be compared."""
    return changes.row((old, new), folders.NEEDED, lambda a, b: _compared(_read(a), _read(b)))


def _read(folder: Path) -> MooringRun:
    with opened(folder / "corrected.nc") as nc:
        series = {name: get(nc, name) for name in dict.fromkeys([*NEEDED, *nc.variables])}
        attributes = {name: nc.getncattr(name) for name in nc.ncattrs() if name not in SHOWN}
    files = (folders.content(folder / f"{file}.json") for file in ("deviation", "diagnosis", "assessment"))
    return MooringRun(series, attributes, *files)


def _compared(old: MooringRun, new: MooringRun) -> tuple[str, ...]:
    turned = _turned(old, new)
    share = from_to(words.percent(_share(old)), words.percent(_share(new)))
    found = (
        from_to(old.diagnosis["verdict"], new.diagnosis["verdict"]),
        from_to(effects(old.diagnosis), effects(new.diagnosis)),
    )
    fitted = coefficients(old.deviation, new.deviation)
    shown = {"assessment": turned[0], "diagnosis": "".join(found).replace(2 * SAME, SAME), "deviation": fitted}
    others = _variables(old, new, turned[0]) + _attributes(old, new)
    others += [f"{file}.json" for file, said in shown.items() if said == SAME and _file(old, file) != _file(new, file)]
    return (*turned, _in_sigmas(old, new), share, _flags(old, new), *found, fitted, ", ".join(others) or SAME)


def _file(run: MooringRun, name: str) -> Any:
    return getattr(run, name)


def _turned(old: MooringRun, new: MooringRun) -> tuple[str, str]:
    """Return rms and largest turn of the true heading where both have one."""
    here, there = _common(old, new)
    turn = angles.difference(new.true_deg[there], old.true_deg[here])
    turn = turn[np.isfinite(turn)]
    if not turn.size:
        nowhere = SAME if not (np.isfinite(old.true_deg).any() or np.isfinite(new.true_deg).any()) else "none in both"
        return nowhere, nowhere
    if not turn.any():
        return SAME, SAME
    return degrees(float(np.sqrt(np.mean(turn**2)))), degrees(float(np.max(np.abs(turn))))


def _common(old: MooringRun, new: MooringRun) -> tuple[Any, Any]:
    """Return where the samples of one time are in both."""
    _, here, there = np.intersect1d(old.series["TIME"], new.series["TIME"], return_indices=True)
    return here, there


def _in_sigmas(old: MooringRun, new: MooringRun) -> str:
    """Return the turns over what OLD stated as 1σ: who used it relied on that; both rest on the same data."""
    here, there = _common(old, new)
    turn = np.abs(angles.difference(new.true_deg[there], old.true_deg[here]))
    stated = np.asarray(old.series.get(SIGMA, np.full(old.series["TIME"].shape, np.nan)))[here]
    known = np.isfinite(turn) & (stated > 0.0)
    if not turn[np.isfinite(turn)].any():
        return SAME
    if not known.any():
        return "OLD states none"
    ratio = turn[known] / stated[known]
    return ", ".join(words.significant(x, 2) for x in (*np.quantile(ratio, [0.5, 0.95]).tolist(), float(ratio.max())))


def _flags(old: MooringRun, new: MooringRun) -> str:
    """Return how many samples have another flag, and the commonest changes."""
    if FLAG not in old.series or FLAG not in new.series:
        return SAME if FLAG not in {*old.series, *new.series} else "none on one side"
    here, there = _common(old, new)
    before, after = old.series[FLAG][here], new.series[FLAG][there]
    steps, count = np.unique(np.stack([before, after])[:, before != after], axis=1, return_counts=True)
    most = np.argsort(-count, kind="stable")[:3]
    listed = (f"{steps[0, k]:.0f} → {steps[1, k]:.0f}: {count[k]}" for k in most)
    return f"{count.sum()} of {len(here)} ({', '.join(listed)})" if count.size else SAME


def _share(run: MooringRun) -> float:
    corrected = np.isfinite(run.series["HEADING_CORRECTED"])
    return float(corrected.mean()) if corrected.size else 0.0


def _variables(old: MooringRun, new: MooringRun, turned: str) -> list[str]:
    """Return the variables of corrected.nc that differ, those left out that turn with the heading."""
    names = dict.fromkeys([*old.series, *new.series])
    differing = [name for name in names if not _equal(old.series.get(name), new.series.get(name))]
    if turned == SAME:
        return differing
    follow = {f"{name}{end}" for name in TURNED for end in ("", "_QC", "_UNCERTAINTY")} - {SIGMA}
    return [name for name in differing if name not in follow]


def _attributes(old: MooringRun, new: MooringRun) -> list[str]:
    keys = dict.fromkeys([*old.attributes, *new.attributes])
    return [f"attribute {key}" for key in keys if not _equal(old.attributes.get(key), new.attributes.get(key))]


def _equal(one: Any, other: Any) -> bool:
    if one is None or other is None:
        return False
    one, other = np.asarray(one), np.asarray(other)
    return one.shape == other.shape and bool(np.array_equal(one, other, equal_nan=one.dtype.kind == "f"))
