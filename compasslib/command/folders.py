"""Where the results of moorings are, and whether they are whole."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from compasslib import archive
from compasslib.errors import InputError

NEEDED = ("corrected.nc", "deviation.json", "diagnosis.json", "assessment.json", "work/field.json")
KEYS = {
    "deviation.json": ("method", "coefficients", "covariance", "n_pairs", "folded", "why", "warnings", "applied"),
    "diagnosis.json": ("verdict", "findings", "unexplained", "separated_by", "not_testable", "why"),
    "assessment.json": ("before", "after"),
    "work/field.json": ("warnings",),
}
OTHERS = ("calibrations", "proof", "logs", "benchmarks")  # what stands in results/ beside moorings


def of_mooring(cruise: str, mooring: str) -> Path:
    """Return the folder of one mooring's results.

    Args:
        cruise: folder of a cruise.
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


def moorings(place: str) -> dict[str, Path]:
    """Return the folders of results by mooring.

    Args:
        place: a cruise, a folder of results, or one mooring's folder.

    Raises:
        InputError: there is none.
    """
    root = Path(place)
    if any((root / file).is_file() for file in NEEDED):
        return {root.resolve().name: root}
    found = _moorings(root / "results") or _moorings(root)
    if not found:
        missing = "no results in it" if root.is_dir() else "no such folder"
        advice = "name a cruise that was run, its folder results, or a copy of that"
        raise InputError(place, expected="a folder with results of moorings", found=missing, advice=advice)
    return found


def _moorings(root: Path) -> dict[str, Path]:
    folders = sorted(path for path in root.iterdir() if path.is_dir()) if root.is_dir() else []
    marks = ("work", "logs", *NEEDED)
    return {path.name: path for path in folders if path.name not in OTHERS and any((path / m).exists() for m in marks)}


def missing(folder: Path) -> list[str]:
    """Return which files a whole run would have left and this one has not.

    Args:
        folder: one mooring's results.
    """
    return [file for file in NEEDED if not (folder / file).is_file()]


def refuse_half(folder: Path) -> None:
    """Refuse results that a run did not finish.

    Args:
        folder: one mooring's results.

    Raises:
        InputError: a file is missing.
    """
    if files := missing(folder):
        found, advice = f"no {files[0]}", "run the cruise to its end"
        raise InputError(str(folder), expected="all results of a mooring", found=found, advice=advice)


@contextmanager
def of_this_version(folder: Path) -> Iterator[None]:
    """Turn what is missing deep in a file of the results into one line.

    Args:
        folder: one mooring's results.

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
    held = archive.read_json(file)
    keys = next(keys for name, keys in KEYS.items() if file.match(name))
    absent = [key for key in keys if not isinstance(held, dict) or key not in held]
    if absent:
        advice = "delete it and run the cruise again"
        raise InputError(str(file), expected=f"the key {absent[0]}", found="none", advice=advice)
    return dict(held)
