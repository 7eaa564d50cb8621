"""``compass diff``: compare two runs by mooring and calibration, for example after a correction of metadata."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import angles
from compasslib.archive import calibrations as archive
from compasslib.archive import provenance
from compasslib.archive.attributes import DATES
from compasslib.archive.files import open_netcdf, read_json, read_variable
from compasslib.calibrations.result import DeviationTable
from compasslib.cli import results
from compasslib.report import words
from compasslib.types import Floats

MOORING_HEADER = (
    *("mooring", "true heading, rms", "largest", "in OLD's 1σ: median, 95 %, largest", "corrected", "flags"),
    *("verdict", "effects", "coefficients", "also changed"),
)
SIGMA, FLAG = "HEADING_CORRECTED_UNCERTAINTY", "HEADING_CORRECTED_QC"
Cells = Callable[[Path, Path], tuple[str, ...]]  # cells that compare two folders of results
REQUIRED_VARIABLES = ("TIME", "HEADING_CORRECTED", "DECLINATION")
# Variables and attributes that follow from quantities with columns of their own.
TURNED = ("HEADING_CORRECTED", "HEADING_TRUE", "DEVIATION", "BRANCH_PROBABILITY", "UCUR", "VCUR")
EXPECTED_ATTRIBUTES = (
    *(*DATES, "history", "software_version", "product_version"),
    *("correction_method", "correction_coefficients", "effects"),
)


@dataclass(frozen=True)
class MooringRun:
    """Results of one run for one mooring."""

    series: Mapping[str, Any]  # variables of corrected.nc
    attributes: Mapping[str, Any]
    deviation: Mapping[str, Any]
    diagnosis: Mapping[str, Any]
    assessment: Mapping[str, Any]

    @property
    def true_deg(self) -> Floats:
        """The corrected true heading, (n,) degrees, NaN where there is none."""
        heading: Floats = self.series["HEADING_CORRECTED"] + self.series["DECLINATION"]
        return heading


def diff(asked: Namespace) -> int:
    """Print the differences of moorings and of calibrations, and the software of both, or that nothing changed.

    Raises:
        InputError: there are no results, or one of their files is damaged.
    """
    with results.unpack_deposit(asked.old) as old, results.unpack_deposit(asked.new) as new:
        return _print_differences(results.find_results(old), results.find_results(new))


def _print_differences(old: results.ResultFolders, new: results.ResultFolders) -> int:
    moorings = _rows(old.moorings, new.moorings, results.MOORING_FILES, _compare_moorings)
    calibrations = _rows(old.calibrations, new.calibrations, results.CALIBRATION_FILES, _compare_calibrations)
    changed = [(MOORING_HEADER, moorings), (CALIBRATION_HEADER, calibrations)]
    sections = [table(*entry) for entry in changed if any(entry[1].values())]
    both = {
        name: old.moorings.get(name) or next(iter(old.moorings.values())) for name, row in moorings.items() if row[1:]
    }
    differ = [f"  {k}: {text}" for k, side in both.items() for text in compare_jobs(side, new.moorings[k])]
    sections += ["\n".join(["Settings and raw files that differ:", *differ])] if differ else []
    made_by = {(_software(side), _software(new.moorings[k])) for k, side in both.items()}
    sections += [f"OLD by {a}\nNEW by {b}" for a, b in sorted(made_by) if a != b]
    if not sections:
        parts = ((moorings, "mooring"), (calibrations, "calibration"))
        compared = [words.plural(len(rows), noun) for rows, noun in parts if rows]
        sections = [f"nothing changed: {words.listed(compared)} compared"]
    print("\n\n".join(sections))
    return int(any(len(row) == 1 for rows in (moorings, calibrations) for row in rows.values()))


def _rows(
    old: Mapping[str, Path], new: Mapping[str, Path], needed: Sequence[str], compare: Cells
) -> dict[str, tuple[str, ...]]:
    """Compare folders by name; return no cells if nothing changed, one cell if two folders cannot be compared."""
    if len(old) == len(new) == 1:  # a folder and its copy under another name
        old = dict(zip(new, old.values(), strict=True))
    rows: dict[str, tuple[str, ...]] = {}
    for name in sorted({*old, *new}):
        if lacking := results.explain_missing(old.get(name), new.get(name), needed):
            rows[name] = (lacking,)
            continue
        with results.check_version(old[name]):
            cells = compare(old[name], new[name])
        rows[name] = cells if any(cell != SAME for cell in cells) else ()
    return rows


def compare_jobs(old: Path, new: Path) -> list[str]:
    """List the settings and raw files in which two folders of results differ, by the records of their jobs."""
    differ: dict[str, None] = {}
    for path in sorted((new / "logs").glob("*.json")):
        if not (before := old / "logs" / path.name).is_file():
            continue
        was, now = read_json(before), read_json(path)
        role = f"{now['of']['role']}: " if "role" in now["of"] else ""
        texts = provenance.changed_settings(was["parameters"], now["parameters"])
        raw = (file for file in sorted(was["read"].keys() & now["read"].keys()) if not file.startswith("results/"))
        texts += [f"{file} changed" for file in raw if was["read"][file] != now["read"][file]]
        differ |= dict.fromkeys(f"{role}{text}" for text in texts)
    return list(differ)


def _software(folder: Path) -> str:
    with open_netcdf(folder / "corrected.nc") as nc:
        return str(getattr(nc, "software_version", "software that is not named"))


def _read_mooring(folder: Path) -> MooringRun:
    with open_netcdf(folder / "corrected.nc") as nc:
        series = {name: read_variable(nc, name) for name in dict.fromkeys([*REQUIRED_VARIABLES, *nc.variables])}
        attributes = {name: nc.getncattr(name) for name in nc.ncattrs() if name not in EXPECTED_ATTRIBUTES}
    files = (results.read_content(folder / f"{file}.json") for file in ("deviation", "diagnosis", "assessment"))
    return MooringRun(series, attributes, *files)


def _compare_moorings(old_folder: Path, new_folder: Path) -> tuple[str, ...]:
    old, new = _read_mooring(old_folder), _read_mooring(new_folder)
    _, here, there = np.intersect1d(old.series["TIME"], new.series["TIME"], return_indices=True)
    turn = angles.difference(new.true_deg[there], old.true_deg[here])
    corrected = np.isfinite(old.true_deg).any() or np.isfinite(new.true_deg).any()
    turned = _rms_and_largest(turn, "none in both" if corrected else SAME)
    share = from_to(words.percent(_corrected_share(old)), words.percent(_corrected_share(new)))
    outcome = (
        from_to(old.diagnosis["verdict"], new.diagnosis["verdict"]),
        from_to(effects(old.diagnosis), effects(new.diagnosis)),
    )
    fitted = coefficients(old.deviation, new.deviation)
    shown = {"assessment": turned[0], "diagnosis": "".join(outcome).replace(2 * SAME, SAME), "deviation": fitted}
    keys = dict.fromkeys([*old.attributes, *new.attributes])
    names = dict.fromkeys([*old.series, *new.series])
    others = [name for name in names if not _equal(old.series.get(name), new.series.get(name))]
    if turned[0] != SAME:  # variables that turn with the heading are left out
        follow = {f"{name}{end}" for name in TURNED for end in ("", "_QC", "_UNCERTAINTY")} - {SIGMA}
        others = [name for name in others if name not in follow]
    others += [f"attribute {key}" for key in keys if not _equal(old.attributes.get(key), new.attributes.get(key))]
    alike = (file for file, cell in shown.items() if cell == SAME)
    others += [f"{file}.json" for file in alike if getattr(old, file) != getattr(new, file)]
    return (
        *turned,
        _change_in_sigmas(np.abs(turn), old.series.get(SIGMA, np.full(old.series["TIME"].shape, np.nan))[here]),
        share,
        _flag_changes(old.series, new.series, here, there),
        *outcome,
        fitted,
        ", ".join(others) or SAME,
    )


def _rms_and_largest(change: Floats, nowhere: str) -> tuple[str, str]:
    """Format rms and largest of changes of an angle where it is known, ``nowhere`` if that is nowhere."""
    change = change[np.isfinite(change)]
    if not change.size:
        return nowhere, nowhere
    if not change.any():
        return SAME, SAME
    return degrees(float(np.sqrt(np.mean(change**2)))), degrees(float(np.max(np.abs(change))))


def _change_in_sigmas(turn: Floats, stated: Floats) -> str:
    """Compute the changes of heading in units of OLD's 1σ, on which users relied; both runs use the same data."""
    known = np.isfinite(turn) & (stated > 0.0)
    if not turn[np.isfinite(turn)].any():
        return SAME
    if not known.any():
        return "OLD states none"
    ratio = turn[known] / stated[known]
    return ", ".join(words.significant(x, 2) for x in (*np.quantile(ratio, [0.5, 0.95]).tolist(), float(ratio.max())))


def _flag_changes(old: Mapping[str, Any], new: Mapping[str, Any], here: Any, there: Any) -> str:
    """Count the samples, at indices ``here`` and ``there``, whose flag changed, and list the most frequent changes."""
    if FLAG not in old or FLAG not in new:
        return SAME if FLAG not in {*old, *new} else "none on one side"
    before, after = old[FLAG][here], new[FLAG][there]
    steps, count = np.unique(np.stack([before, after])[:, before != after], axis=1, return_counts=True)
    most = np.argsort(-count, kind="stable")[:3]
    listed = (f"{steps[0, k]:.0f} → {steps[1, k]:.0f}: {count[k]}" for k in most)
    return f"{count.sum()} of {len(here)} ({', '.join(listed)})" if count.size else SAME


def _corrected_share(run: MooringRun) -> float:
    corrected = np.isfinite(run.series["HEADING_CORRECTED"])
    return float(corrected.mean()) if corrected.size else 0.0


def _equal(entry: Any, other: Any) -> bool:
    if entry is None or other is None:
        return False
    entry, other = np.asarray(entry), np.asarray(other)
    return entry.shape == other.shape and bool(np.array_equal(entry, other, equal_nan=entry.dtype.kind == "f"))


# Calibrations.

CALIBRATION_HEADER = (
    *("calibration", "deviation, rms", "largest", "uncertainty", "verdict", "effects", "coefficients", "also changed"),
)
# Keys that follow from quantities with columns of their own, or that state the software.
EXPECTED_KEYS = ("model", "coefficients", "covariance", "uncertainty", "software", "date_created")


@dataclass(frozen=True)
class CalibrationRun:
    """Results of one run for one calibration."""

    content: Mapping[str, Any]  # calibration.json
    table: DeviationTable
    diagnosis: Mapping[str, Any]


def _read_calibration(folder: Path) -> CalibrationRun:
    file = folder / "diagnosis.json"
    undiagnosed = {"verdict": "none", "findings": []}  # calibrations of some kinds are not diagnosed
    outcome = results.read_content(file) if file.is_file() else undiagnosed
    return CalibrationRun(
        results.read_content(folder / "calibration.json"), archive.read_table(folder / "table.csv"), outcome
    )


def _compare_calibrations(old_folder: Path, new_folder: Path) -> tuple[str, ...]:
    old, new = _read_calibration(old_folder), _read_calibration(new_folder)
    verdicts = from_to(*(str(entry.diagnosis["verdict"]) for entry in (old, new)))
    outcome = (verdicts, from_to(effects(old.diagnosis), effects(new.diagnosis)))
    sure = from_to(*(words.degrees(entry.content["uncertainty"]["expanded_deg"], 2) for entry in (old, new)))
    fitted = coefficients(_calibration_fit(old.content), _calibration_fit(new.content))
    keys = dict.fromkeys([*old.content, *new.content])
    others = [key for key in keys if key not in EXPECTED_KEYS and old.content.get(key) != new.content.get(key)]
    alike = all(cell == SAME for cell in outcome)
    others += ["diagnosis.json"] if alike and old.diagnosis != new.diagnosis else []
    _, here, there = np.intersect1d(old.table.heading_deg, new.table.heading_deg, return_indices=True)
    change = angles.difference(new.table.deviation_deg[there], old.table.deviation_deg[here])
    tabulated = old.table.heading_deg.size or new.table.heading_deg.size
    changed = _rms_and_largest(change, "none in both" if tabulated else SAME)
    return (*changed, sure, *outcome, fitted, ", ".join(others) or SAME)


def _calibration_fit(content: Mapping[str, Any]) -> dict[str, Any]:
    """Convert the known coefficients to the form of a mooring's fit; some kinds determine only the first of them."""
    known = {letter: value for letter, value in (content["coefficients"] or {}).items() if value is not None}
    n = len(known)
    sigma = np.array(content["covariance"] or np.zeros((n, n)), dtype=float)[:n, :n]
    return {"method": content["model"], "coefficients": known, "covariance": np.nan_to_num(sigma).tolist()}


# Format of cells and of the table.

SAME = "same"


def from_to(old: str, new: str) -> str:
    """Format the change of a value, ``SAME`` if there is none."""
    return SAME if old == new else f"{old} → {new}"


def degrees(value: float) -> str:
    """Format the size of a change, degrees."""
    return f"{words.significant(value, 3)}°" if value >= 0.01 else "below 0.01°"


def effects(diagnosis: Mapping[str, Any]) -> str:
    """List the effects identified in the content of diagnosis.json."""
    return ", ".join(entry["effect"] for entry in diagnosis["findings"]) or "none"


def coefficients(old: Mapping[str, Any], new: Mapping[str, Any], *, least: float = 0.01) -> str:
    """Format the changes of the coefficients that correct, or of the method if that differs.

    Changes below ``least`` standard deviations of OLD are numerical.
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
    worth = [
        f"{letter} {difference:+.2g}".replace("-", words.MINUS) + (f" ({abs(difference) / s:.2g}σ)" if s > 0.0 else "")
        for letter, difference, s in change
        if abs(difference) > least * s
    ]
    return ", ".join(worth) or f"below {least} of their 1σ"


def table(header: Sequence[str], rows: Mapping[str, tuple[str, ...]]) -> str:
    """Format a header and rows as a table; a row of one cell spans the columns.

    Args:
        rows: cells by name; none where nothing changed.
    """
    lines = [header, *((name, *(row or ("nothing changed",))) for name, row in rows.items())]
    columns = zip(*(line for line in lines if len(line) == len(header)), strict=True)
    widths = [max(len(cell) for cell in column) for column in columns]
    widths[0] = max(len(line[0]) for line in lines)
    padded = ([cell.ljust(width) for cell, width in zip(line, widths, strict=False)] for line in lines)
    return "\n".join("  ".join(cells).rstrip() for cells in padded)
