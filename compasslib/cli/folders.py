"""Where the results of moorings are, and whether they are whole."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from compasslib.archive import netcdf
from compasslib.archive.files import MAKE_ANEW
from compasslib.config.schema import RESERVED
from compasslib.errors import InputError

NEEDED = ("corrected.nc", "deviation.json", "diagnosis.json", "assessment.json", "work/field.json")
KEYS = {
    "deviation.json": ("method", "coefficients", "covariance", "n_pairs", "folded", "why", "warnings", "applied"),
    "diagnosis.json": ("verdict", "findings", "unexplained", "separated_by", "not_testable", "why"),
    "assessment.json": ("before", "after"),
    "calibration.json": ("kind", "model", "coefficients", "covariance", "uncertainty", "why"),
    "work/field.json": ("warnings",),
}
CALIBRATION = ("calibration.json", "table.csv")


def of_mooring(cruise: str, mooring: str) -> Path:
    """Return the folder of one mooring's results.

    Args:
        mooring: a name in it, or the folder itself.

    Raises:
        InputError: there is no such folder.
    """
    for folder in (Path(cruise) / "results" / mooring, Path(cruise) / "corrected" / mooring, Path(mooring)):
        if folder.is_dir():
            return folder
    results = Path(cruise) / "results"
    there = ", ".join(_moorings(results)) if results.is_dir() else "no folder results"
    advice = "write the name of a mooring that was run, and --cruise FOLDER where it is not in this one"
    raise InputError(mooring, expected=f"a mooring with results in {cruise}", found=there or "none", advice=advice)


@dataclass(frozen=True)
class Found:
    """The folders of results by the names of moorings and calibrations."""

    moorings: Mapping[str, Path]
    calibrations: Mapping[str, Path]


def results(place: str) -> Found:
    """Return the folders of results.

    Args:
        place: a cruise, a folder of results, or the folder of one mooring or calibration.

    Raises:
        InputError: there is none.
    """
    root = Path(place)
    alone = {root.resolve().name: root}
    if (root / CALIBRATION[0]).is_file():
        return Found({}, alone)
    if any((root / file).is_file() for file in NEEDED):
        return Found(alone, {})
    for folder in (root / "results", root):
        found = Found(_moorings(folder), _calibrations(folder))
        if found.moorings or found.calibrations:
            return found
    missing = "no results in it" if root.is_dir() else "no such folder"
    advice = "name a cruise that was run, its folder results, or a copy of that"
    raise InputError(place, expected="a folder with results", found=missing, advice=advice)


def _calibrations(root: Path) -> dict[str, Path]:
    return {path.name: path for path in sorted((root / "calibrations").glob("*")) if path.is_dir()}


def _moorings(root: Path) -> dict[str, Path]:
    folders = sorted(path for path in root.iterdir() if path.is_dir()) if root.is_dir() else []
    marks = ("work", "logs", *NEEDED)
    own = [path for path in folders if path.name not in RESERVED]
    return {path.name: path for path in own if any((path / mark).exists() for mark in marks)}


def missing(folder: Path, needed: Sequence[str] = NEEDED) -> list[str]:
    """Return which files a whole run would have left and this one has not.

    Args:
        folder: one mooring's results, or one calibration's.
    """
    return [file for file in needed if not (folder / file).is_file()]


def lacking(old: Path | None, new: Path | None, needed: Sequence[str] = NEEDED) -> str:
    """Return why two results cannot be compared, nothing where they can.

    Args:
        old: one folder, None where there is none.
        needed: files that both must have.
    """
    for folder, which in ((old, "OLD"), (new, "NEW")):
        if folder is None:
            return f"not in {which}"
        if files := missing(folder, needed):
            return f"{which} is incomplete: no {files[0]}"
    return ""


def refuse_half(folder: Path) -> None:
    """Refuse results that a run did not finish.

    Raises:
        InputError: a file is missing.
    """
    if files := missing(folder):
        found, advice = f"no {files[0]}", "run the cruise to its end"
        raise InputError(str(folder), expected="all results of a mooring", found=found, advice=advice)


@contextmanager
def of_this_version(folder: Path) -> Iterator[None]:
    """Turn what is missing deep in a file of the results into one line.

    Raises:
        InputError: the block asks for what a file does not hold.
    """
    try:
        yield
    except (LookupError, TypeError, AttributeError, ValueError) as error:
        found, advice = f"{type(error).__name__}: {error}", "run the cruise again"
        raise InputError(str(folder), expected="results of this version", found=found, advice=advice) from error


def content(file: Path) -> dict[str, Any]:
    """Return what a JSON file of the results holds.

    Args:
        file: one of those of ``KEYS``.

    Raises:
        InputError: it is no JSON, or lacks a key that every run writes.
    """
    read = netcdf.read_json(file)
    keys = next(keys for name, keys in KEYS.items() if file.match(name))
    absent = [key for key in keys if not isinstance(read, dict) or key not in read]
    if absent:
        raise InputError(str(file), expected=f"the key {absent[0]}", found="none", advice=MAKE_ANEW)
    return dict(read)
