"""``compass diff``: compare two runs by mooring and calibration, for example after a correction of metadata."""

from argparse import Namespace
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import angles
from compasslib.archive import provenance
from compasslib.archive.attributes import DATES
from compasslib.archive.calibrations import read_table
from compasslib.archive.files import open_netcdf, read_json, read_variable
from compasslib.cli import results
from compasslib.report import words
from compasslib.types import Floats

MOORING_HEADER = (
    *("mooring", "true heading, rms", "largest", "in OLD's 1σ: median, 95 %, largest", "corrected", "flags"),
    *("verdict", "effects", "coefficients", "also changed"),
)
CALIBRATION_HEADER = (
    *("calibration", "deviation, rms", "largest", "uncertainty", "verdict", "effects", "coefficients", "also changed"),
)
SAME = "same"
SIGMA, FLAG = "HEADING_CORRECTED_UNCERTAINTY", "HEADING_CORRECTED_QC"
GRIDDED, AXES = ("gridded.nc", "gridded_daily.nc"), ("TIME", "DEPTH")
PAGES = ("deviation", "diagnosis", "assessment")
# Variables, attributes and keys that follow from quantities with columns of their own, or that state the software.
TURNED = ("HEADING_CORRECTED", "HEADING_TRUE", "DEVIATION", "BRANCH_PROBABILITY", "UCUR", "VCUR")
EXPECTED_ATTRIBUTES = (
    *(*DATES, "history", "software_version", "product_version"),
    *("correction_method", "correction_coefficients", "effects"),
)
EXPECTED_KEYS = ("model", "coefficients", "covariance", "uncertainty", "software", "date_created")
Cells = Callable[..., tuple[str, ...]]  # cells that compare two folders of results


def diff(asked: Namespace) -> int:
    """Print the differences of moorings and of calibrations, and the software of both, or that nothing changed."""
    with results.unpack_deposit(asked.old) as first, results.unpack_deposit(asked.new) as second:
        (old, old_checks), (new, new_checks) = results.find_results(first), results.find_results(second)
        moorings = _rows(old, new, results.MOORING_FILES, _compare_moorings)
        calibrations = _rows(old_checks, new_checks, results.CALIBRATION_FILES, _compare_calibrations)
        sections = []
        for header, rows in ((MOORING_HEADER, moorings), (CALIBRATION_HEADER, calibrations)):
            lines = [header, *((name, *(row or ("nothing changed",))) for name, row in rows.items())]
            sections += ["\n".join(results.align(lines))] if any(rows.values()) else []
        only = next(iter(old.values()), Path())
        both = {name: old.get(name, only) for name, row in moorings.items() if row[1:]}
        differ = [f"  {k}: {text}" for k, side in both.items() for text in compare_jobs(side, new[k])]
        sections += ["\n".join(["Settings and raw files that differ:", *differ])] if differ else []
        made_by = {(_software(side), _software(new[k])) for k, side in both.items()}
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
        sides = {"OLD": old.get(name), "NEW": new.get(name)}
        missing = {which: results.missing_files(folder, needed) for which, folder in sides.items() if folder}
        lacking = [f"not in {which}" for which in sides if which not in missing]
        lacking += [f"{which} is incomplete: no {files[0]}" for which, files in missing.items() if files]
        if lacking:
            rows[name] = (lacking[0],)
            continue
        with results.check_version(f"{old[name]} and {new[name]}"):
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
        for side in (was, now):
            side["parameters"].pop("superseded", None)  # the earlier deposit, itself compared with this run
        role = f"{now['of']['role']}: " if "role" in now["of"] else ""
        texts = provenance.changed_settings(was["parameters"], now["parameters"])
        raw = (file for file in sorted(was["read"].keys() & now["read"].keys()) if not file.startswith("results/"))
        texts += [f"{file} changed" for file in raw if was["read"][file] != now["read"][file]]
        differ |= dict.fromkeys(f"{role}{text}" for text in texts)
    return list(differ)


def _software(folder: Path) -> str:
    with open_netcdf(folder / "corrected.nc") as nc:
        return str(getattr(nc, "software_version", "software that is not named"))


def _compare_moorings(*folders: Path) -> tuple[str, ...]:
    (old, old_attributes), (new, new_attributes) = map(_read_product, folders)
    before, after = ({page: read_json(folder / f"{page}.json") for page in PAGES} for folder in folders)
    _, here, there = np.intersect1d(old["TIME"], new["TIME"], return_indices=True)
    if not len(here) and len(old["TIME"]) == len(new["TIME"]):  # by order, as the clock was corrected
        here = there = np.arange(len(old["TIME"]))
    true = [side["HEADING_CORRECTED"] + side["DECLINATION"] for side in (old, new)]
    turn = angles.difference(true[1][there], true[0][here])
    corrected = any(np.isfinite(heading).any() for heading in true)
    turned = _rms_and_largest(turn, "none in both" if corrected else SAME)
    shares = [words.percent(np.isfinite(heading).mean() if heading.size else 0.0) for heading in true]
    outcome = _outcome(before["diagnosis"], after["diagnosis"])
    fitted = _coefficients(before["deviation"], after["deviation"])
    flags = _flag_changes(old, new, here, there)
    names = _unequal(old, new)
    if turned[0] != SAME:  # variables that turn with the heading are left out
        ends = ("", "_UNCERTAINTY", *["_QC"] * (flags != SAME))
        follow = {f"{name}{end}" for name in TURNED for end in ends} - {SIGMA}
        names = [name for name in names if name not in follow]
    names += [f"attribute {key}" for key in _unequal(old_attributes, new_attributes)]
    shown = {"assessment": turned[0] == SAME, "diagnosis": {*outcome} == {SAME}, "deviation": fitted == SAME}
    names += [f"{page}.json" for page, alike in shown.items() if alike and before[page] != after[page]]
    sigma = old[SIGMA][here] if SIGMA in old else np.full(turn.shape, np.nan)
    in_sigmas = _change_in_sigmas(np.abs(turn), sigma)
    names += [text for file in GRIDDED if (text := _compare_grids(file, folders, turned[0] != SAME))]
    return (*turned, in_sigmas, _from_to(*shares), flags, *outcome, fitted, ", ".join(names) or SAME)


def _compare_grids(file: str, folders: Sequence[Path], turned: bool) -> str:
    """List what differs between two gridded files, only levels and times if headings turned; empty if nothing does."""
    sides = []
    for path in (folder / file for folder in folders):
        if path.is_file():
            with open_netcdf(path) as nc:
                names = AXES if turned else [name for name in nc.variables if nc[name].dimensions]
                sides.append({name: read_variable(nc, name) for name in names})
    if len(sides) < len(folders):
        return f"{file} (on one side)" if sides else ""
    names = _unequal(*sides)
    resized = [f"{name} {' → '.join(str(side[name].size) for side in sides)}" for name in names if name in AXES]
    return f"{file} ({', '.join(resized or names)})" if names else ""


def _read_product(folder: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Read the variables and the attributes of corrected.nc, of which some must be there."""
    with open_netcdf(folder / "corrected.nc") as nc:
        names = dict.fromkeys(["TIME", "HEADING_CORRECTED", "DECLINATION", *nc.variables])
        series = {name: read_variable(nc, name) for name in names}
        return series, {name: nc.getncattr(name) for name in nc.ncattrs() if name not in EXPECTED_ATTRIBUTES}


def _rms_and_largest(change: Floats, nowhere: str) -> tuple[str, str]:
    """Format rms and largest of changes of an angle where it is known, ``nowhere`` if that is nowhere."""
    change = change[np.isfinite(change)]
    if not change.size:
        return nowhere, nowhere
    if not change.any():
        return SAME, SAME
    sizes = [float(np.sqrt(np.mean(change**2))), float(np.max(np.abs(change)))]
    rms, largest = (f"{words.significant(x, 3)}°" if x >= 0.01 else "below 0.01°" for x in sizes)
    return rms, largest


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


def _unequal(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    """List the keys of which one side has none, or another value."""
    both = {key: [np.asarray(side[key]) for side in (old, new) if key in side] for key in (*old, *new)}
    alike = [
        key for key, x in both.items() if len(x) > 1 and np.array_equal(x[0], x[1], equal_nan=x[0].dtype.kind == "f")
    ]
    return [key for key in both if key not in alike]


def _compare_calibrations(*folders: Path) -> tuple[str, ...]:
    old, new = (read_json(folder / "calibration.json") for folder in folders)
    tables = [read_table(folder / "table.csv") for folder in folders]
    files, none = [folder / "diagnosis.json" for folder in folders], {"verdict": "none", "findings": []}
    diagnoses = [read_json(file) if file.is_file() else none for file in files]
    outcome = _outcome(*diagnoses)
    sure = _from_to(*(words.degrees(side["uncertainty"]["expanded_deg"], 2) for side in (old, new)))
    keys = [key for key in dict.fromkeys([*old, *new]) if key not in EXPECTED_KEYS and old.get(key) != new.get(key)]
    keys += ["diagnosis.json"] if {*outcome} == {SAME} and diagnoses[0] != diagnoses[1] else []
    _, here, there = np.intersect1d(tables[0].heading_deg, tables[1].heading_deg, return_indices=True)
    change = angles.difference(tables[1].deviation_deg[there], tables[0].deviation_deg[here])
    tabulated = any(table.heading_deg.size for table in tables)
    changed = _rms_and_largest(change, "none in both" if tabulated else SAME)
    return (*changed, sure, *outcome, _coefficients(*map(_fit, (old, new))), ", ".join(keys) or SAME)


def _fit(content: Mapping[str, Any]) -> dict[str, Any]:
    """Convert the known coefficients to the form of a mooring's fit; some kinds determine only the first of them."""
    known = {letter: value for letter, value in (content["coefficients"] or {}).items() if value is not None}
    n = len(known)
    sigma = np.array(content["covariance"] or np.zeros((n, n)), dtype=float)[:n, :n]
    return {"method": content["model"], "coefficients": known, "covariance": np.nan_to_num(sigma).tolist()}


def _from_to(old: str, new: str) -> str:
    return SAME if old == new else f"{old} → {new}"


def _outcome(old: Mapping[str, Any], new: Mapping[str, Any]) -> tuple[str, str]:
    """Compare verdict and effects of two diagnoses."""
    effects = (", ".join(entry["effect"] for entry in side["findings"]) or "none" for side in (old, new))
    return _from_to(old["verdict"], new["verdict"]), _from_to(*effects)


def _coefficients(old: Mapping[str, Any], new: Mapping[str, Any], *, least: float = 0.01) -> str:
    """Format the changes of coefficients, or of the method; those below ``least`` sigmas of OLD are numerical."""
    before, after = old["coefficients"], new["coefficients"]
    if old["method"] != new["method"]:
        return f"{old['method']} → {new['method']}"
    if before == after:
        return SAME
    if not (before and after):
        return "none → fitted" if after else "fitted → none"
    known = old["covariance"] or new["covariance"]
    worth = []
    for letter, s in zip(after, np.sqrt(np.diag(known)) if known else np.zeros(len(after)), strict=True):
        change = after[letter] - before[letter]
        if abs(change) > least * s:
            sigmas = f" ({abs(change) / s:.2g}σ)" if s > 0.0 else ""
            worth.append(f"{letter} {change:+.2g}{sigmas}".replace("-", words.MINUS))
    return ", ".join(worth) or f"below {least} of their 1σ"
