"""Safeguards of a run.

It takes no code from a cruise folder and no older results, leaves no incomplete files, and simulates no measured ones.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from compasslib import __version__
from compasslib.archive import provenance
from compasslib.archive.files import HALF_WRITTEN
from compasslib.config.cruise import Cruise
from compasslib.errors import InputError
from compasslib.pipeline.job import ROOT
from compasslib.stages.settings import CONCEALED

RESULTS = Path("results")
# Variables of the environment of jobs, which import no modules from their working folder, the cruise. glibc reuses
# arrays below 32 MB instead of mapping each new one page by page, which takes a quarter of a simulated mooring's time.
ENVIRONMENT = {"PYTHONSAFEPATH": "1", "MALLOC_MMAP_THRESHOLD_": str(2**25), "MALLOC_TRIM_THRESHOLD_": str(2**26)}
WITHOUT = "without"  # key of Snakemake's configuration: moorings and calibrations to leave out, separated by commas
WARNING = "warning: "
KILLED = (
    "killed before it could say why, if no error stands above, most often because memory ran out; run again with fewer "
    "--cores, on a cluster with more memory for each job (--default-resources mem_mb=N)"
)


def enter(config: Mapping[str, object], version: str, *, is_module: bool) -> None:
    """Prepare this process for a run by rules of a version, with the values of Snakemake's ``--config``.

    Raises:
        InputError: the library has another version, or a setting is given on the command line, as no archive would
            record it; the values of a workflow that uses this one as a module may be any.
    """
    if version != __version__:
        advice = f"install compasslib {version}, or take the rules of {__version__}"
        raise InputError("compasslib", expected=f"version {version}, as the rules", found=__version__, advice=advice)
    if (others := [str(key) for key in config if key != WITHOUT]) and not is_module:
        advice = "write it into config/config.yaml, or into the mooring's file, and run again"
        expected = f"{WITHOUT}, and other settings in the cruise's YAML files alone"
        raise InputError("--config", expected=expected, found=", ".join(others), advice=advice)
    for name, value in ENVIRONMENT.items():
        os.environ.setdefault(name, value)


def only(names: Iterable[str]) -> str:
    """Return a regular expression that matches these names only, as wildcard constraint."""
    return "|".join(map(re.escape, dict.fromkeys(names))) or "(?!)"


def left_out(cruise: Cruise, config: Mapping[str, object]) -> dict[str, list[str]]:
    """List the moorings, with all of their affected instruments, and the calibrations that a run leaves out."""
    asked = [name for name in str(config.get(WITHOUT) or "").split(",") if name]
    parts = {name: [name] for name in cruise.moorings} | cruise.whole
    if unknown := [name for name in asked if name not in parts and name not in cruise.calibrations]:
        expected = ", ".join((*parts, *cruise.calibrations))
        advice = "write names of moorings or calibrations, separated by commas"
        raise InputError(f"--config {WITHOUT}", expected=expected, found=", ".join(unknown), advice=advice)
    moorings = [part for name in asked for part in parts.get(name, [])]
    return {"moorings": moorings, "calibrations": [name for name in asked if name in cruise.calibrations]}


def delete_incomplete() -> None:
    """Delete the incomplete files of killed runs; links are not followed."""
    for path in RESULTS.rglob(f".*.*{HALF_WRITTEN}"):
        path.unlink(missing_ok=True)


def closing_text(started_s: float = 0.0) -> str:
    """Summarize a run since a time from the logs of its jobs: the moorings, all warnings, and killed jobs."""
    lines, warned, killed = list[str](), list[str](), list[str]()
    for log in sorted(RESULTS.glob("**/logs/*.log")):
        if log.stat().st_mtime < started_s - 2.0:  # the clock of a file server may be late
            continue
        said = log.read_text(encoding="utf-8", errors="replace").splitlines()
        warned += [line for line in said if WARNING in line]
        if not log.with_suffix(".json").exists() and not any(line.startswith("error: ") for line in said):
            killed.append(f"{log}: {KILLED}")
        lines += said if log == RESULTS / "logs/summary.log" else []
    for title, more in (("Warnings", warned), ("Killed", killed)):
        lines += [f"{title}: {len(more)}", *(f"  {line}" for line in more)] if more else []
    return "\n".join(lines)


def storage_root(workflow: Any) -> str:
    """Return where a storage plug-in of Snakemake keeps copies of the cruise's files, for jobs too; "." without one."""
    os.environ[ROOT] = str(Path(workflow.inputfile(str(RESULTS))).parent)
    return os.environ[ROOT]


def truth_file(name: str) -> str:
    """Return the path of the truth of a simulated mooring, which no stage reads but ``concealed``."""
    return f"concealed/{name}.json" if name in CONCEALED else f"truth/{name}.csv"


def to_simulate(cruise: Cruise, warn: Callable[[str], object] = print, *, check: bool = True) -> dict[str, list[str]]:
    """List the raw files of each demonstration mooring that a rule may write; none for any other cruise.

    A mooring is left out if its files all exist and are not provably the simulation's: they are used as raw files.

    Args:
        check: whether the files are looked at, as once at the start of a run.

    Raises:
        InputError: some files of a mooring are missing and others are not the simulation's.
    """
    ours: dict[str, list[str]] = {}
    for name, mooring in cruise.moorings.items() if cruise.options.demonstration else ():
        files = [file for each in mooring.instruments.values() for file in (*each.files, *each.pressure_files)]
        made = _simulated(name) if check else {}
        present = [file for file in (*files, truth_file(name)) if check and os.path.lexists(file)]
        foreign = [file for file in present if os.path.islink(file) or provenance.sha256(file) != made.get(file)]
        if foreign and (missing := [file for file in files if not os.path.isfile(file)]):
            actual = f"a file or link that is there already, while {missing[0]} is missing"
            advice = "measured files are never written over: add the missing one, or delete demonstration: true"
            raise InputError(foreign[0], expected="what the simulation wrote, or nothing", found=actual, advice=advice)
        if foreign:
            warn(f"{name}: raw files used as they stand: no record says that the simulation wrote them")
        else:
            ours[name] = files
    return ours


def _simulated(name: str) -> dict[str, str]:
    """Return the SHA-256 of the files that the simulation of a mooring has on record as its own, by path."""
    try:
        return dict(json.loads(Path(f"results/{name}/logs/simulate.json").read_bytes())["wrote"])
    except (OSError, ValueError, TypeError, KeyError):
        return {}
