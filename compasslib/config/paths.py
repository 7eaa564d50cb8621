"""Paths in a cruise's YAML files: inside the cruise folder, there, and globs written out."""

from __future__ import annotations

import os
import posixpath
import re
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath
from typing import Any

from pydantic import ValidationInfo

from compasslib.config.values import problem, shown, text

RESULTS = "results"


@dataclass(frozen=True)
class RawFolder:
    """Where raw files are looked for, given to the models as their validation context."""

    root: Path
    made_later: bool  # a demonstration: rules make the raw files, so that their absence is no error


def paths(value: Any) -> tuple[str, ...]:
    """Return one path or a list of them, inside the cruise folder and relative to it."""
    listed = value if isinstance(value, list | tuple) else [value]
    return tuple(_relative(text(path)) for path in listed)


def _relative(path: str) -> str:
    if path.startswith(("/", "\\", "~")) or PureWindowsPath(path).drive or ".." in re.split(r"[/\\]", path):
        inside = "copy or link the file into the cruise folder and write its path from there"
        raise problem(None, "a path inside the cruise folder, relative to it", shown(path), inside)
    _refuse_unusable(path)
    return posixpath.normpath(path)


def _refuse_unusable(path: str) -> None:
    if not path.isprintable():  # nor are bytes that are no UTF-8, which Python holds as half characters
        raise problem(None, "a path in UTF-8 without control characters", shown(path), "rename the file")
    if "{" in path or "}" in path:  # Snakemake would put the mooring's name or the role there
        raise problem(None, "a path without braces", shown(path), "rename the file")


def mooring_paths(value: Any) -> str | tuple[str, ...]:
    """Return a folder as a text or mooring files as a tuple."""
    return paths(value) if isinstance(value, list | tuple) else paths(value)[0]


def raw_files(value: Any, info: ValidationInfo) -> tuple[str, ...]:
    """Return existing raw files, globs expanded and sorted; only checked for form where no place is given.

    Args:
        info: its context is a ``RawFolder`` or None.
    """
    listed, place = paths(value), info.context
    if not listed:
        raise problem(None, "at least one file", "an empty list")
    found = [file for path in listed for file in ([path] if place is None else _expand(path, place))]
    for file in found:
        _refuse_results(file, place)
    return tuple(dict.fromkeys(found))


def _refuse_results(file: str, place: RawFolder | None) -> None:
    """Refuse a raw file that a run may write over, be it by way of a link."""
    inside = file.startswith(f"{RESULTS}/")
    if place is not None and not inside:
        results = os.path.realpath(place.root / RESULTS)
        inside = os.path.realpath(place.root / file).startswith(f"{results}{os.sep}")
    if inside:
        apart = "copy it to another folder, for example raw"
        raise problem(None, f"a file outside {RESULTS}/, which each run may write over", shown(file), apart)


def _expand(path: str, place: RawFolder) -> list[str]:
    is_glob = any(mark in path for mark in "*?[")
    if os.path.isfile(place.root / path) or (place.made_later and not is_glob):
        return [path]
    if place.made_later:
        raise problem(
            None, "plain paths, as the files of a demonstration are made later", shown(path), "list the files"
        )
    if os.path.isdir(place.root / path):
        raise problem(None, "a file", f"the folder {path}", f"write {path}/* for all files in it")
    files = _matches(place.root, path) if is_glob else []
    for file in files:
        _refuse_unusable(file)
    if not files:
        other = os.path.lexists(place.root / path)
        found = f"no file that matches {path}" if is_glob else f"no file {path}"
        found = f"{path}, a pipe, a device or a link that leads nowhere" if other else found
        raise problem(
            None, "an existing file", found, "put it there or correct the path, relative to the cruise folder"
        )
    return files


def _matches(root: Path, pattern: str) -> list[str]:
    """Return the files of a glob, none of them hidden; ``**`` does not go through links, which may lead in circles."""
    pattern = f"{pattern}/*" if pattern.endswith("**") else re.sub(r"\*\*+(?=[^/*])|(?<=[^/*])\*\*+", "*", pattern)
    found = [path.relative_to(root) for path in root.glob(pattern) if path.is_file()]
    return sorted(str(path) for path in found if not any(part.startswith(".") for part in path.parts))
