"""Safeguards of a run: it takes no code or profile from a cruise folder, and leaves no incomplete files."""

from __future__ import annotations

import json
import os
import re
import shlex
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from compasslib import __version__
from compasslib.archive import provenance
from compasslib.archive.files import HALF_WRITTEN
from compasslib.config.cruise import Cruise
from compasslib.errors import InputError
from compasslib.pipeline.job import ROOT

RESULTS = Path("results")
PROFILES = ("default", "profiles/default")  # where Snakemake looks in the folder that it is started in
# glibc releases large arrays and maps each new one page by page, which takes a quarter of a simulated mooring's time, a
# twentieth of an assessment's. With these settings it reuses arrays below 32 MB, for some 10 MB more memory.
MEMORY = {"MALLOC_MMAP_THRESHOLD_": str(2**25), "MALLOC_TRIM_THRESHOLD_": str(2**26)}
WITHOUT = "without"  # key of Snakemake's configuration: moorings and calibrations to leave out, separated by commas
WARNING = "warning: "
CLOCK_S = 2.0  # by which the clock of a file server may be late
KILLED = (
    "killed before it could say why, if no error stands above, most often because memory ran out; run again with fewer "
    "--cores, on a cluster with more memory for each job (--default-resources mem_mb=N)"
)
TEMPORARY = re.compile(rf"\..+\.\d+{re.escape(HALF_WRITTEN)}")  # names made by ``files.atomic_write``


def enter(config: Mapping[str, object], version: str, *, is_module: bool) -> None:
    """Prepare this process for a run in the working folder, a cruise.

    Args:
        config: Snakemake's values of ``--config`` and ``--configfile``.
        version: of the rules.
        is_module: whether another workflow uses this one, in which case ``config`` may contain its settings.

    Raises:
        InputError: the library has another version, a setting is given on the command line, as no archive would record
            it, the results cannot be written, or the cruise folder contains a profile that Snakemake may have used.
    """
    if version != __version__:
        advice = f"install compasslib {version}, or take the rules of {__version__}"
        raise InputError("compasslib", expected=f"version {version}, as the rules", found=__version__, advice=advice)
    if (others := [str(key) for key in config if key != WITHOUT]) and not is_module:
        advice = "write it into config/config.yaml, or into the mooring's file, and run again"
        expected = f"{WITHOUT}, and other settings in the cruise's YAML files alone"
        raise InputError("--config", expected=expected, found=", ".join(others), advice=advice)
    for place in (RESULTS, Path(".snakemake")):
        if not os.access(place if place.exists() else ".", os.W_OK):
            advice = f"give yourself that right (chmod -R u+w {place}), or copy the cruise to where you have it"
            raise InputError(str(place), expected="the right to write here", found="no such right", advice=advice)
    for name, value in MEMORY.items():
        os.environ.setdefault(name, value)  # for the jobs, which are separate processes
    os.environ["PYTHONSAFEPATH"] = "1"  # for the jobs too: modules are not imported from their working folder
    if Path.cwd() != provenance.PROJECT:
        sys.path[:] = [path for path in sys.path if Path(path or ".").resolve() != Path.cwd()]
        for name in PROFILES:
            if Path(name).is_file() or any(Path(name).glob("*.yaml")):
                expected = "no profile of Snakemake in a cruise folder, as settings are never taken from there"
                raise InputError(str(Path.cwd() / name), expected=expected, found="one", advice="remove or rename it")


def only(names: Iterable[str]) -> str:
    """Return a regular expression that matches these names only, as wildcard constraint."""
    return "|".join(map(re.escape, dict.fromkeys(names))) or "(?!)"


def group(stage: str, mooring: str) -> str:
    """Name a group of jobs of a mooring, all of its affected instruments together."""
    return f"{stage}_{mooring.partition('/')[0]}"


def left_out(cruise: Cruise, config: Mapping[str, object]) -> dict[str, list[str]]:
    """List the moorings, with all of their affected instruments, and the calibrations that a run leaves out.

    Raises:
        InputError: the cruise has no mooring or calibration of that name.
    """
    asked = [name for name in str(config.get(WITHOUT) or "").split(",") if name]
    parts = {name: [name] for name in cruise.moorings} | cruise.whole
    if unknown := [name for name in asked if name not in parts and name not in cruise.calibrations]:
        expected = ", ".join((*parts, *cruise.calibrations))
        advice = "write names of moorings or calibrations, separated by commas"
        raise InputError(f"--config {WITHOUT}", expected=expected, found=", ".join(unknown), advice=advice)
    moorings = [part for name in asked for part in parts.get(name, [])]
    return {"moorings": moorings, "calibrations": [name for name in asked if name in cruise.calibrations]}


def check_results(warn: Callable[[str], object]) -> None:
    """Warn of results of which Snakemake has no metadata, so that it cannot notice changed settings.

    Raises:
        InputError: there are results of a version whose rules made other files.
    """
    for record in RESULTS.glob("**/logs/read_*.json"):
        with suppress(OSError, ValueError):
            if "library" not in json.loads(record.read_bytes()):
                advice = "move them away, mv results results_before, and run again"
                raise InputError("results", expected="none, or those of this version", found="others", advice=advice)
    if any(RESULTS.glob("*/logs")) and not any(Path(".snakemake").glob("metadata/*")):
        warn(
            "results without .snakemake/metadata: settings changed since they were made are not noticed; "
            "-- --forceall makes everything again"
        )


def refuse_future(given: Iterable[str]) -> None:
    """Refuse files dated in the future: Snakemake fails on such raw files, and takes such results for newer than them.

    Args:
        given: raw and YAML files.

    Raises:
        InputError: a file is dated in the future.
    """
    now, later = time.time(), list[str]()
    for file in (*given, *map(str, RESULTS.rglob("*"))):
        with suppress(OSError):
            later += [file] if os.stat(file).st_mtime > now else []
    made = [file for file in later if file.startswith("results/")]
    if later:
        raw = f"touch {shlex.join(file for file in later if file not in made)}"
        # Results older than all raw files are made again where the content of a raw file has changed.
        command = "find results/ -newermt now -exec touch -t 200001010000 {} +" if made == later else raw
        advice = f"correct the clock of this computer, or in the cruise folder: {command}"
        raise InputError(later[0], expected="a date of change before now", found="one in the future", advice=advice)


def begin() -> float:
    """Delete incomplete files of killed runs, and return the time."""
    for folder, _, files in os.walk(RESULTS):  # links are not followed
        for name in files:
            if TEMPORARY.fullmatch(name):
                Path(folder, name).unlink(missing_ok=True)
    return time.time() - CLOCK_S


def closing_lines(begun: float = 0.0) -> list[str]:
    """Summarize a run since ``begun`` from the logs of its jobs: the moorings, all warnings, and killed jobs."""
    lines, warned, killed = list[str](), list[str](), list[str]()
    for log in sorted(RESULTS.glob("**/logs/*.log")):
        with suppress(OSError):
            if log.stat().st_mtime < begun:
                continue
            said = log.read_text(encoding="utf-8", errors="replace").splitlines()
            warned += [line for line in said if WARNING in line]
            if not log.with_suffix(".json").exists() and not any(line.startswith("error: ") for line in said):
                killed.append(f"{log}: {KILLED}")
            lines += said if log == RESULTS / "logs/summary.log" else []
    for title, more in (("Warnings", warned), ("Killed", killed)):
        lines += [f"{title}: {len(more)}", *(f"  {line}" for line in more)] if more else []
    return lines


def storage_root(workflow: Any) -> str:
    """Return where a storage plug-in of Snakemake keeps copies of the cruise's files, for jobs too; "." without one."""
    os.environ[ROOT] = str(Path(workflow.inputfile(str(RESULTS))).parent)
    return os.environ[ROOT]
