"""Safeguards of a run: it takes no code or profile from a cruise folder, and writes only its own files."""

from __future__ import annotations

import fcntl
import os
import re
import shlex
import stat
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from compasslib.archive.files import HALF_WRITTEN
from compasslib.config.cruise import Cruise
from compasslib.errors import InputError
from compasslib.pipeline.records import RESULTS, is_future, read_hashes, simulated, truth_file

PROFILES = ("default", "profiles/default")  # where Snakemake looks in the folder that it is started in
SNAKEMAKES, LOCK = ".snakemake", ".snakemake/compasslib.lock"
BELOW = ("work", "work/alone", "wide", "figures", "logs")  # in the folder of each mooring and calibration
# glibc releases large arrays and maps each new one page by page, which takes a quarter of a simulated mooring's time, a
# twentieth of an assessment's. With these settings it reuses arrays below 32 MB, for some 10 MB more memory.
MEMORY = {"MALLOC_MMAP_THRESHOLD_": str(2**25), "MALLOC_TRIM_THRESHOLD_": str(2**26)}
CORES = "mooring_cores"  # key of Snakemake's configuration, which the profiles of clusters set
WARNING = "warning: "
KILLED = (
    "killed before it could say why, most often because memory ran out; run again with fewer --cores, on a cluster "
    "with more memory for each job (--default-resources mem_mb=N)"
)
TEMPORARY = re.compile(rf"\..+\.\d+{re.escape(HALF_WRITTEN)}")  # names made by ``files.atomic_write``

_locks: list[int] = []  # kept open until the process ends, when the kernel releases the lock


def enter(cruise: Path, project: Path) -> None:
    """Prepare this process for planning a run in a cruise folder, to which nothing is written.

    Raises:
        InputError: the cruise folder contains a profile that Snakemake may have used.
    """
    for name, value in MEMORY.items():
        os.environ.setdefault(name, value)  # for the jobs, which are separate processes
    os.environ["PYTHONSAFEPATH"] = "1"  # for the jobs too: modules are not imported from their working folder
    if cruise.resolve() != project.resolve():
        sys.path[:] = [path for path in sys.path if Path(path or ".").resolve() != cruise.resolve()]
        for name in PROFILES:
            if (cruise / name).is_file() or any((cruise / name).glob("*.yaml")):
                expected = "no profile of Snakemake in a cruise folder, as settings are never taken from there"
                raise InputError(str(cruise / name), expected=expected, found="one", advice="remove or rename it")


def mooring_cores(config: Mapping[str, object], *, is_module: bool = False) -> int:
    """Return the number of cores of the one job of a mooring; 0 where each stage is a job.

    Args:
        config: values of ``--config`` and ``--configfile``; other keys are refused, as no archive would record them.
        is_module: whether another workflow uses this one, in which case ``config`` may contain its settings.

    Raises:
        InputError: there is another setting, or the number is invalid.
    """
    if (others := [str(key) for key in config if key != CORES]) and not is_module:
        expected, actual = f"{CORES}, and other settings in the cruise's YAML files alone", ", ".join(others)
        advice = "write it into config/config.yaml, or into the mooring's file, and run again"
        raise InputError("--config", expected=expected, found=actual, advice=advice)
    cores = config.get(CORES, 0)
    if not isinstance(cores, int) or cores < 0:
        expected, advice = "the cores of a mooring's job, or 0: each stage is a job", f"write --config {CORES}=2"
        raise InputError(f"--config {CORES}", expected=expected, found=str(cores), advice=advice)
    return cores


def refuse_prefix(modifier: Any) -> None:
    """Raise InputError for a module with a prefix, whose results would not be in the folder of the run."""
    if modifier.prefix or modifier.modifies_prefixes:
        advice = "start the workflow that uses this one with --directory CRUISE, and leave prefix: out"
        raise InputError("module", expected="results in the folder of the run", found="a prefix", advice=advice)


def begin() -> float:
    """Lock the cruise before the first job of this run, and return the time by ``file_clock``.

    Raises:
        InputError: another run is in progress, or results cannot be written.
    """
    refuse_read_only([RESULTS])
    if lock():
        sweep()
    return file_clock()


def listing(paths: Iterable[str], begun: float) -> list[str]:
    """Summarize a run since ``begun``: last log line of each of its jobs, by record, all warnings, and killed jobs."""
    ran = []
    for record in map(Path, paths):
        with suppress(OSError):
            log = record.with_suffix(".log")
            if (when := log.stat().st_mtime) >= begun:
                ran.append((when, record, log.read_text(encoding="utf-8", errors="replace").splitlines()))
    ran.sort()
    said = [
        (_label(record), [line for line in log if WARNING not in line and line[:1] != " "]) for _, record, log in ran
    ]
    warned = [line for _, _, log in ran for line in log if WARNING in line]
    killed = [_label(r) for _, r, log in ran if not r.exists() and not any(x.startswith("error: ") for x in log)]
    lines = [f"Stages: {len(ran)}"]
    for label, texts in said:
        last = texts[-1] if texts else "nothing said"
        name, _, what = last.partition(": ")  # the label already has the name
        lines.append(f"  {label}: {what if name.split(' ')[0] == label.split(' ')[0] else last}")
    lines += [f"Warnings: {len(warned)}", *(f"  {line}" for line in warned)] if warned else []
    lines += [f"Killed: {len(killed)}", *(f"  {label}: {KILLED}" for label in killed)] if killed else []
    return lines if ran else []


def _label(record: Path) -> str:
    """Compose the label of a job from its subject and stage, such as ``M1 read top``."""
    _, *folders = record.parent.parent.parts  # below results
    name = "/".join(folders[folders[:1] in (["calibrations"], ["compasses"]) :])
    stage = record.stem.replace("_", " ", 1)
    return f"{name} {stage}" if name else stage


def refuse_links(folders: Sequence[str]) -> None:
    """Refuse symbolic links where the run writes, because their targets may belong to others.

    Only ``results`` may be a link, to a folder that is not another cruise's, for example on a scratch disk.

    Raises:
        InputError: there is a link.
    """
    below = [f"{folder}/{name}" for folder in (RESULTS, *folders) for name in BELOW]
    ours = [SNAKEMAKES, *map(str, Path(SNAKEMAKES).glob("*")), RESULTS]
    common = [f"{RESULTS}/calibrations", f"{RESULTS}/compasses"]
    for path in [*ours, *common, *folders, *below]:  # linked files in them do no harm: the link is replaced
        scratch = path == RESULTS and os.path.isdir(path)
        if os.path.islink(path) and not (scratch and not Path(os.path.realpath(path), "../config").exists()):
            advice = "put the cruise on the other disk and name it by --directory, or mount the disk there"
            raise InputError(path, expected="no link where results are written", found="one", advice=advice)


def file_clock() -> float:
    """Return the time, seconds since 1970, by the clock that dates the cruise's files, which may be a server's."""
    with suppress(OSError), tempfile.TemporaryFile(dir=SNAKEMAKES) as file:
        return os.fstat(file.fileno()).st_mtime
    return time.time()


def refuse_future(paths: Iterable[str], now: float) -> None:
    """Refuse inputs dated in the future, with which every run of Snakemake would repeat jobs and fail.

    Args:
        now: present time by ``file_clock``.

    Raises:
        InputError: there is such a file.
    """
    for path in paths:
        if is_future(path, now):
            date = datetime.fromtimestamp(os.stat(path).st_mtime, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
            present = datetime.fromtimestamp(now, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
            redate = f"touch {shlex.quote(path)}"
            advice = f"set the clock of this machine if it is wrong, otherwise redate the file: {redate}"
            raise InputError(path, expected=f"a date of change before now, {present}", found=date, advice=advice)


def refuse_read_only(outputs: Iterable[str]) -> None:
    """Refuse to begin a run whose results could not be written.

    Raises:
        InputError: a file or folder is not writable.
    """
    for path in outputs:
        place = path if os.path.lexists(path) else next(str(p) for p in Path(path).parents if os.path.lexists(p))
        for needed in (place, os.path.dirname(place) or "."):
            if not os.access(needed, os.W_OK):
                actual = "a read-only file system" if os.statvfs(needed).f_flag & os.ST_RDONLY else "no right to write"
                advice = (
                    "give yourself that right (chmod -R u+w), or copy the cruise to where you have it, and run again"
                )
                raise InputError(needed, expected="the right to write here", found=actual, advice=advice)


def lock() -> bool:
    """Lock the cruise until this process ends; return False where locking is impossible.

    Raises:
        InputError: another run is in progress.
    """
    try:
        os.makedirs(SNAKEMAKES, exist_ok=True)
        handle = os.open(LOCK, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        advice = "wait until it has ended, or stop it"
        raise InputError(str(Path.cwd()), expected="one run at a time", found="another", advice=advice) from None
    except OSError:  # a file system without locks, or a read-only one, which Snakemake will report
        return False
    _locks.append(handle)
    return True


def sweep() -> None:
    """Delete the incomplete files of killed runs; links are not followed."""
    for folder, _, files in os.walk(RESULTS):
        for name in files:
            path = Path(folder, name)
            if TEMPORARY.fullmatch(name) and not path.is_symlink():
                path.unlink(missing_ok=True)


def to_simulate(cruise: Cruise, warn: Callable[[str], object] = print) -> dict[str, list[str]]:
    """List the raw files of each demonstration mooring that a rule may write.

    A mooring is left out if its files all exist and are not provably the simulation's: they are used as raw files.

    Raises:
        InputError: some files of a mooring are missing and others are not the simulation's, or two moorings share one.
    """
    files = simulated_names(cruise)
    taken: dict[str, str] = {}
    for name, file in [(name, file) for name, listed in files.items() for file in listed]:
        if taken.setdefault(file, name) != name:
            actual, advice = f"that of {taken[file]}", "give each its own"
            where = f"{cruise.mooring_files[name]}: {file}"
            raise InputError(where, expected="a file of one simulated mooring", found=actual, advice=advice)
    known = read_hashes()
    ours = {}
    for name, listed in files.items():
        made = simulated(name)
        foreign = [
            file for file in (*listed, truth_file(name)) if _foreign(file, known.sha256(file), made.get(file, ()))
        ]
        if foreign and not all(os.path.isfile(file) for file in listed):
            missing = next(file for file in listed if not os.path.isfile(file))
            actual = f"a file or link that is there already, while {missing} is missing"
            advice = "measured files are never written over: add the missing one, or delete demonstration: true"
            raise InputError(foreign[0], expected="what the simulation wrote, or nothing", found=actual, advice=advice)
        if not foreign:
            ours[name] = listed
    for name in files.keys() - ours.keys():
        warn(f"{name}: raw files used as they stand: no record says that the simulation wrote them")
    return ours


def simulated_names(cruise: Cruise) -> dict[str, list[str]]:
    """List the raw files of each mooring of a demonstration cruise; empty for any other cruise."""
    moorings = cruise.moorings.items() if cruise.options.demonstration else ()
    return {
        name: [file for each in mooring.instruments.values() for file in (*each.files, *each.pressure_files)]
        for name, mooring in moorings
    }


def _foreign(file: str, digest: str, ours: Sequence[str] | set[str]) -> bool:
    """Return whether a path is taken by anything that the simulation did not write, or by one of other case."""
    path = Path(file)
    folders = [folder for folder in path.parents if folder.name]
    if any(folder.is_symlink() for folder in folders):
        return True
    try:
        return not stat.S_ISREG(path.lstat().st_mode) or digest not in ours
    except FileNotFoundError:
        absent = [place for place in (path, *folders) if not place.exists() and place.parent.is_dir()]
        return any(place.name.casefold() in map(str.casefold, os.listdir(place.parent)) for place in absent)
