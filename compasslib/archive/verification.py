"""Verification of a cruise's files against its manifest, and search for results that are no longer configured."""

from __future__ import annotations

import json
import os
import re
import shlex
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any

from compasslib.archive import crate, provenance
from compasslib.archive.files import read_json
from compasslib.errors import InputError

FORMER = "no longer configured: "
PROJECT_FOLDERS = ("bench", "proof")  # the project's own benchmarks, in the results folder of its demonstration cruise
OF_CRUISE = (f"{crate.FOLDER}/figures", f"{crate.FOLDER}/logs")
# Files of a job that no manifest lists: log, record, and benchmark (processor time).
JOB_FILE = re.compile(r"results(?:/[^/]+){0,2}/(?:logs/[^/]+\.(?:log|json)|benchmarks/[^/]+\.tsv|stopped\.json)")
# Files that options or instruments add, so that those of earlier ones may be left.
OPTIONAL = re.compile(
    r"results/(?:.+/)?(?:gridded(?:_daily)?\.nc|figures/[a-z_]+\.(?:png|pdf)|work/[^/]+\.(?:nc|json))"
)


@dataclass(frozen=True)
class Results:
    """The files below results/ of a cruise and the jobs that wrote them; links are not followed."""

    root: Path
    configured: Collection[str] | None  # folders of the configured moorings, calibrations and compasses; None: unknown

    @cached_property
    def files(self) -> list[str]:
        """Paths of all files and links, relative to the cruise folder, except the manifest."""
        entries: list[str] = []
        for folder, folders, names in os.walk(self.root / crate.FOLDER):
            place = Path(folder).relative_to(self.root)
            if place == Path(crate.FOLDER) and self.root.resolve() == provenance.PROJECT:
                folders[:] = [name for name in folders if name not in PROJECT_FOLDERS]
            links = [name for name in folders if os.path.islink(Path(folder, name))]
            entries += [(place / name).as_posix() for name in (*names, *links)]
        return sorted({*entries} - {crate.FILE})

    @cached_property
    def wrote(self) -> set[tuple[str, str]]:
        """Path and SHA-256 of each file that a job wrote, by the records of the jobs; damaged records are left out."""
        entries: set[tuple[str, str]] = set()
        for file in self.files:
            if self.of_job(file) and file.endswith(".json"):
                with suppress(OSError, ValueError, TypeError, KeyError):
                    entries |= set(dict(json.loads((self.root / file).read_bytes())["wrote"]).items())
        return entries

    @cached_property
    def former(self) -> list[str]:
        """Unmodified results of what is no longer configured, with its logs, and of options that are switched off.

        Raises:
            InputError: there is no valid manifest.
        """
        if self.configured is None:
            return []
        listed, folders = crate.listed(read_manifest(self.root)), (*self.configured, *OF_CRUISE)
        left = (file for file in self.files if file not in listed)
        return [file for file in left if self._is_former(file, tuple(f"{folder}/" for folder in folders))]

    def of_job(self, file: str) -> bool:
        """Return whether a file is the log, record or benchmark of a job."""
        return JOB_FILE.fullmatch(file) is not None and not (self.root / file).is_symlink()

    def as_written(self, file: str) -> bool:
        """Return whether a file is as a job wrote it."""
        path = self.root / file
        return not path.is_symlink() and path.is_file() and (file, provenance.sha256(path)) in self.wrote

    def foreign(self, apart: Collection[str] = ()) -> list[str]:
        """List the files except ``apart`` that no job wrote, or that were modified since."""
        left = (file for file in self.files if file not in apart and not self.of_job(file))
        return [file for file in left if not self.as_written(file)]

    def clear(self) -> None:
        """Delete the results that are no longer configured, and the folders that become empty."""
        folders = {folder for file in self.former for folder in PurePosixPath(file).parents[:-2]}
        for file in self.former:
            (self.root / file).unlink()
        for folder in sorted(folders, key=lambda each: -len(each.parts)):
            with suppress(OSError):  # the folder is not empty
                (self.root / folder).rmdir()

    def _is_former(self, file: str, configured: tuple[str, ...]) -> bool:
        if not file.startswith(configured):
            return len(PurePosixPath(file).parts) > 2 and (self.of_job(file) or self.as_written(file))
        path, names = self.root / file, {name for name, _ in self.wrote}
        unfinished = path.lstat().st_mtime > (self.root / crate.FILE).stat().st_mtime
        stopped = any((folder / "stopped.json").exists() for folder in path.parents)
        if unfinished or stopped or not OPTIONAL.fullmatch(file):
            return False
        # The record of a later job, of gridded.nc or figures/curves.png, does not name gridded_daily.nc or curves.pdf.
        replaced = file not in names and file.startswith(tuple(name.rpartition(".")[0] for name in names))
        return replaced or self.as_written(file)


def differences(cruise: str | Path, configured: Collection[str] | None) -> list[str]:
    """List differences from the manifest, one line per file, and results no longer configured, one line per folder.

    Args:
        cruise: folder of the cruise, which is only read.
        configured: folders of the configured moorings, calibrations and compasses; None where unknown.

    Raises:
        InputError: there is no valid manifest.
    """
    root = Path(cruise)
    page = read_manifest(root)
    listed, results = crate.listed(page), Results(root, configured)
    # Files that the manifest does not list, in folders outside results/ that a simulation wrote into.
    wrote = (path for path in crate.written(page) if path in listed and not path.startswith(f"{crate.FOLDER}/"))
    folders = {(root / path).parent for path in wrote}
    raw = (file for folder in folders if folder.is_dir() for file in folder.iterdir() if file.is_file())
    foreign = [
        *results.foreign({*listed, *results.former}),
        *(p for f in raw if (p := f.relative_to(root).as_posix()) not in listed),
    ]
    apart = {*listed, *results.former, *foreign}
    left = (file for file in results.files if file not in apart and not results.of_job(file))
    unlisted = [] if crate.has_failures(page) else [*left]
    former = Counter[str]()
    for file in results.former:  # by the folder of the mooring, calibration, compass or cruise
        parts = PurePosixPath(file).parts[:-1]
        former["/".join(parts[: 3 if parts[1:2] and parts[1] in ("calibrations", "compasses", "sites") else 2])] += 1
    differ = []
    for path, known in listed.items():
        if not (root / path).is_file():
            differ.append(f"missing: {path}")
        elif (now := provenance.sha256(root / path)) != known:
            differ.append(f"changed: {path} (sha256 {now[:12]}, listed {known[:12]})")
    return [
        *differ,
        *(f"new: {path}" for path in sorted(foreign)),
        *(f"unlisted: {path}" for path in unlisted),
        *(f"{FORMER}{folder}, {n} files" for folder, n in sorted(former.items())),
    ]


def verify(
    cruise: str | Path, configured: Collection[str] | None, say: Callable[[str], None], *, name: str = "."
) -> None:
    """Report the differences from the manifest, and the command that mends them, or that there are none.

    Args:
        cruise: folder of the cruise, which is only read; the user's name for it is ``name``.
        configured: as for ``differences``.

    Raises:
        InputError: there are differences, or there is no valid manifest.
    """
    entries, page = differences(cruise, configured), read_manifest(Path(cruise))
    for line in entries:
        say(escaped(line))
    if outputs := to_make_again(page, entries):
        say(escaped(f"mend: compass run {shlex.quote(name)} -- --forcerun {shlex.join(outputs)}"))
    files = f"{len(crate.listed(page))} files as listed"
    if entries:
        advice = "restore them, or make run again if the change was meant"
        if any(line.startswith(FORMER) for line in entries):
            advice += "; compass verify --clear shows and removes what is no longer configured"
        raise InputError(crate.FILE, expected=files, found=f"{len(entries)} that differ", advice=advice)
    say(f"{crate.FILE}: {files}")


def to_make_again(page: Mapping[str, Any], entries: Iterable[str]) -> list[str]:
    """List results that differ, and one file of each job that read a changed raw file; none for a missing raw file."""
    outputs: dict[str, None] = {}
    for what, _, told in (line.partition(": ") for line in entries):
        path = told.rpartition(" (")[0] if what == "changed" else told
        if what in ("changed", "missing") and path.startswith(f"{crate.FOLDER}/"):
            outputs[path] = None
        elif what == "changed" and path.endswith((".yaml", ".yml")):  # its keys decide what else runs
            outputs[crate.FILE] = None
        elif what == "changed":
            outputs |= dict.fromkeys(crate.made_from(page, path))
    return list(outputs)


def escaped(path: str) -> str:
    """Escape control characters and bytes that are not UTF-8 in a path, for printing."""
    text = path.encode("utf-8", "backslashreplace").decode()
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def read_manifest(root: Path) -> dict[str, Any]:
    """Read the manifest of a cruise.

    Raises:
        InputError: there is none, it is not a manifest, or it lists no file.
    """
    page: dict[str, Any] = read_json(root / crate.FILE)
    expected, advice = "a manifest that lists the files of a run", "make run writes it"
    try:
        crate.written(page), crate.has_failures(page)
        entries = "" if crate.listed(page) else "no file listed"
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        entries = repr(error)
    if entries:
        raise InputError(str(root / crate.FILE), expected=expected, found=entries, advice=advice)
    return page
