"""Safeguards of a run: it takes no code or profile from a cruise folder, and never writes over measured files."""

from __future__ import annotations

import json
import os
import re
import shlex
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any

from compasslib import __version__
from compasslib.archive import provenance
from compasslib.archive.files import HALF_WRITTEN, PLANNED
from compasslib.config.cruise import Cruise
from compasslib.errors import InputError
from compasslib.pipeline.job import ROOT
from compasslib.pipeline.settings import CONCEALED, Arguments, Compasses, Moorings, configuration

RESULTS = Path("results")
PROFILES = ("default", "profiles/default")  # where Snakemake looks in the folder that it is started in
# glibc releases large arrays and maps each new one page by page, which takes a quarter of a simulated mooring's time, a
# twentieth of an assessment's. With these settings it reuses arrays below 32 MB, for some 10 MB more memory.
MEMORY = {"MALLOC_MMAP_THRESHOLD_": str(2**25), "MALLOC_TRIM_THRESHOLD_": str(2**26)}
WITHOUT = "without"  # key of Snakemake's configuration: moorings and calibrations to leave out, separated by commas
WARNING = "warning: "
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


def needs(cruise: Cruise) -> Arguments:
    """Return the calibrations that each mooring needs, and the moorings and calibrations of each compass."""
    moorings = Moorings(cruise)
    shared = {name: [*each, *others] for name, (each, others) in Compasses(cruise).members.items()}
    return {"needed": {name: moorings.calibrations(name) for name in cruise.moorings}, "shared": shared}


def refuse_future(cruise: Cruise) -> None:
    """Refuse files dated in the future: Snakemake fails on such raw files, and takes such results for newer than them.

    Raises:
        InputError: a file is dated in the future.
    """
    given = {file for files in configuration(cruise).values() for file in files}
    given |= {file for name in cruise.moorings for file in Moorings(cruise).given_files(name)}
    given |= {file for each in cruise.calibrations.values() for file in each.raw_files}
    folders = sorted({shlex.quote(os.path.dirname(file) or ".") for file in given})
    # Results older than all raw files are made again where the content of a raw file has changed.
    made = "find results/ -newermt now -exec touch -t 200001010000 {} +"
    commands = dict.fromkeys(map(str, RESULTS.rglob("*")), made)
    commands |= dict.fromkeys(sorted(given), f"touch {' '.join(f'{folder}/*' for folder in folders)}")
    now = time.time()
    for file, command in commands.items():
        if (when := _modified(file)) > now:
            expected, found = (f"{datetime.fromtimestamp(second):%Y-%m-%d %H:%M:%S}" for second in (now, when))
            advice = f"correct the clock of this computer, or in the cruise folder: {command}"
            raise InputError(file, expected=f"a date of change before now, {expected}", found=found, advice=advice)


def _modified(file: str) -> float:
    """Return the time of the last change of a file, 0 where there is none."""
    with suppress(OSError):
        return os.stat(file).st_mtime
    return 0.0


def begin(refuse: Callable[[str], object]) -> float:
    """Delete incomplete files of killed runs, and return the time by the clock that dates the cruise's files.

    Ends the process with status 1 where results cannot be written.
    """
    try:
        RESULTS.mkdir(exist_ok=True)
        mark = RESULTS / f".begun.{os.getpid()}{HALF_WRITTEN}"
        mark.touch()
        begun = mark.stat().st_mtime
    except OSError as error:
        advice = "give yourself that right (chmod -R u+w), free some space, or copy the cruise to where you have it"
        refused = InputError(
            str(RESULTS), expected="room and the right to write here", found=error.strerror, advice=advice
        )
        refuse(f"error: {refused}")
        sys.exit(1)
    for folder, _, files in os.walk(RESULTS):  # links are not followed
        for name in files:
            if TEMPORARY.fullmatch(name):
                Path(folder, name).unlink(missing_ok=True)
    return begun


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


def truth_file(name: str) -> str:
    """Return the path of the truth of a simulated mooring, which no stage reads but ``concealed``."""
    return f"concealed/{name}.json" if name in CONCEALED else f"truth/{name}.csv"


def to_simulate(cruise: Cruise, warn: Callable[[str], object] = print, *, check: bool = True) -> dict[str, list[str]]:
    """List the raw files of each demonstration mooring that a rule may write; none for any other cruise.

    A mooring is left out if its files all exist and are not provably the simulation's: they are used as raw files.

    Args:
        check: whether the files are looked at, as once at the start of a run.

    Raises:
        InputError: some files of a mooring are missing and others are not the simulation's, or two moorings share one.
    """
    moorings = cruise.moorings.items() if cruise.options.demonstration else ()
    files = {
        name: [file for each in mooring.instruments.values() for file in (*each.files, *each.pressure_files)]
        for name, mooring in moorings
    }
    taken: dict[str, str] = {}
    for name, file in [(name, file) for name, listed in files.items() for file in listed]:
        if taken.setdefault(file, name) != name:
            found, where = f"that of {taken[file]}", f"{cruise.mooring_files[name]}: {file}"
            raise InputError(where, expected="a file of one simulated mooring", found=found, advice="give each its own")
    return {name: listed for name, listed in files.items() if not check or _may_write(name, listed, warn)}


def _may_write(name: str, files: list[str], warn: Callable[[str], object]) -> bool:
    """Return whether a simulation may write these files, which are absent or its own."""
    made = simulated(name)
    foreign = [file for file in (*files, truth_file(name)) if _is_foreign(file, made)]
    missing = [file for file in files if not os.path.isfile(file)]
    if foreign and missing:
        found = f"a file or link that is there already, while {missing[0]} is missing"
        advice = "measured files are never written over: add the missing one, or delete demonstration: true"
        raise InputError(foreign[0], expected="what the simulation wrote, or nothing", found=found, advice=advice)
    if foreign:
        warn(f"{name}: raw files used as they stand: no record says that the simulation wrote them")
    return not foreign


def simulated(name: str) -> set[tuple[str, str]]:
    """Collect paths and SHA-256 of the files that the simulation of one mooring has on record as its own."""
    wrote = set[tuple[str, str]]()
    for path in (RESULTS / name / "logs/simulate.json", PLANNED / f"{name}.json"):
        with suppress(OSError, ValueError, TypeError, KeyError):
            wrote |= set(dict(json.loads(path.read_bytes())["wrote"]).items())
    return wrote


def _is_foreign(file: str, made: set[tuple[str, str]]) -> bool:
    """Return whether a path is taken by anything that the simulation did not write, or by one of other case."""
    path = Path(file)
    folders = [folder for folder in path.parents if folder.name]
    if path.is_symlink() or any(folder.is_symlink() for folder in folders):
        return True
    if path.exists():
        return not path.is_file() or (file, provenance.sha256(path)) not in made
    absent = [place for place in (path, *folders) if not place.exists() and place.parent.is_dir()]
    return any(place.name.casefold() in map(str.casefold, os.listdir(place.parent)) for place in absent)


def storage_root(workflow: Any) -> str:
    """Return where a storage plug-in of Snakemake keeps copies of the cruise's files, for jobs too; "." without one."""
    os.environ[ROOT] = str(Path(workflow.inputfile(str(RESULTS))).parent)
    return os.environ[ROOT]
