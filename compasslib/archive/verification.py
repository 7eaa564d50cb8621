"""Verification of a cruise's files against its manifest, and search for results that are no longer configured."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import Any

from compasslib.archive import crate, provenance
from compasslib.archive.files import read_json
from compasslib.errors import InputError

FORMER = "no longer configured"
CHANGED, MISSING, NEW, UNLISTED = "changed", "missing", "new", "unlisted"
OF_CRUISE = (f"{crate.FOLDER}/figures", f"{crate.FOLDER}/logs")
# Files of a job that no manifest lists: log, record, and benchmark (processor time).
JOB_FILE = re.compile(r"results(?:/[^/]+){0,2}/(?:logs/[^/]+\.(?:log|json)|benchmarks/[^/]+\.tsv|stopped\.json)")
# Files that options or instruments add, so that those of earlier ones may be left.
OPTIONAL = re.compile(
    r"results/(?:.+/)?(?:gridded(?:_daily)?\.nc|figures/[a-z_]+\.(?:png|pdf)|work/[^/]+\.(?:nc|json))"
)
Difference = tuple[str, str, str]  # what is different, path, details


def unlisted_files(root: Path, configured: Collection[str] | None) -> dict[str, str]:
    """Classify the files and links below results/ that the manifest does not list, except logs and records of jobs.

    Args:
        configured: folders of the configured moorings, calibrations and compasses; None where unknown.

    Returns:
        By path from the cruise folder: ``FORMER``, unchanged result of what is no longer configured; ``UNLISTED``,
        of a later job than the manifest; or ``NEW``, as no job wrote it.

    Raises:
        InputError: there is no valid manifest.
    """
    listed, manifest = crate.listed(read_manifest(root)), root / crate.FILE
    entries = [path for path in (root / crate.FOLDER).rglob("*") if path.is_symlink() or not path.is_dir()]
    paths = {path.relative_to(root).as_posix(): path for path in sorted(entries) if path != manifest}
    of_jobs = {file for file, path in paths.items() if JOB_FILE.fullmatch(file) and not path.is_symlink()}
    wrote = set[tuple[str, str]]()
    for path in (paths[file] for file in of_jobs if file.endswith(".json")):
        with suppress(OSError, ValueError, TypeError, KeyError):  # a damaged record
            wrote |= set(dict(json.loads(path.read_bytes())["wrote"]).items())
    folders = None if configured is None else tuple(f"{folder}/" for folder in (*configured, *OF_CRUISE))
    kinds = dict[str, str]()
    for file, path in ((file, path) for file, path in paths.items() if file not in listed):
        regular = path.is_file() and not path.is_symlink()
        as_written = file in of_jobs or (regular and (file, provenance.sha256(path)) in wrote)
        former = folders is not None and not file.startswith(folders) and len(PurePosixPath(file).parts) > 2
        if not as_written:
            kinds[file] = NEW
        elif former:
            kinds[file] = FORMER
        elif file not in of_jobs and not any((folder / "stopped.json").exists() for folder in path.parents):
            later = folders is None or path.stat().st_mtime > manifest.stat().st_mtime
            kinds[file] = UNLISTED if later or not OPTIONAL.fullmatch(file) else FORMER
    return kinds


def clear(root: Path, files: Iterable[str]) -> None:
    """Delete files below results/, and the folders that become empty."""
    folders = set[PurePosixPath]()
    for file in files:
        (root / file).unlink()
        folders |= {*PurePosixPath(file).parents[:-2]}
    for folder in sorted(folders, key=lambda each: -len(each.parts)):
        with suppress(OSError):  # the folder is not empty
            (root / folder).rmdir()


def differences(root: Path, configured: Collection[str] | None) -> list[Difference]:
    """List differences from the manifest, by file, and results no longer configured, by folder.

    Args:
        root: folder of the cruise, which is only read.
        configured: as for ``unlisted_files``.

    Raises:
        InputError: there is no valid manifest.
    """
    differ = list[Difference]()
    for file, known in crate.listed(read_manifest(root)).items():
        if not (root / file).is_file():
            differ.append((MISSING, file, ""))
        elif (now := provenance.sha256(root / file)) != known:
            differ.append((CHANGED, file, f" (sha256 {now[:12]}, listed {known[:12]})"))
    kinds, former = unlisted_files(root, configured), Counter[str]()
    differ += [(kind, file, "") for file, kind in kinds.items() if kind != FORMER]
    for parts in (PurePosixPath(file).parts[:-1] for file, kind in kinds.items() if kind == FORMER):
        former["/".join(parts[: 3 if parts[1] in ("calibrations", "compasses", "sites") else 2])] += 1
    return [*differ, *((FORMER, folder, f", {n} files") for folder, n in sorted(former.items()))]


def to_make_again(page: Mapping[str, Any], differ: Iterable[Difference]) -> list[str]:
    """List results that differ, and one file of each job that read a changed raw file; none for a missing raw file."""
    outputs = dict[str, None]()
    for what, file, _ in differ:
        if what in (CHANGED, MISSING) and file.startswith(f"{crate.FOLDER}/"):
            outputs[file] = None
        elif what == CHANGED and file.endswith((".yaml", ".yml")):  # its keys decide what else runs
            outputs[crate.FILE] = None
        elif what == CHANGED:
            outputs |= dict.fromkeys(crate.made_from(page, file))
    return list(outputs)


def read_manifest(root: Path) -> dict[str, Any]:
    """Read the manifest of a cruise.

    Raises:
        InputError: there is none, it is not a manifest, or it lists no file.
    """
    page: dict[str, Any] = read_json(root / crate.FILE)
    try:
        crate.made_from(page, "")
        fault = "" if crate.listed(page) else "no file listed"
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        fault = repr(error)
    if fault:
        expected, advice = "a manifest that lists the files of a run", "make run writes it"
        raise InputError(str(root / crate.FILE), expected=expected, found=fault, advice=advice)
    return page
