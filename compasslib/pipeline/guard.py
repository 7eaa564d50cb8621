"""Around a run: nothing of a cruise folder is code or a setting, nothing is written but the run's own."""

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
# glibc gives large arrays back and takes the next one anew, page by page: a quarter of a simulated mooring's time, a
# twentieth of an assessment's. Those under 32 MB stay with the process, which grows by some 10 MB.
MEMORY = {"MALLOC_MMAP_THRESHOLD_": str(2**25), "MALLOC_TRIM_THRESHOLD_": str(2**26)}
CORES = "mooring_cores"  # key of Snakemake's configuration, which the profiles of clusters set
WARNING = "warning: "
KILLED = (
    "killed before it could say why, most often because memory ran out; run again with fewer --cores, on a cluster "
    "with more memory for each job (--default-resources mem_mb=N)"
)
TEMPORARY = re.compile(rf"\..+\.\d+{re.escape(HALF_WRITTEN)}")  # as archive_files.replacing names them

_locks: list[int] = []  # open for as long as the process lives; the kernel lets go of it when that is killed


def enter(cruise: Path, project: Path) -> None:
    """Make a cruise folder safe to plan a run in; nothing in it is written to.

    Raises:
        InputError: the cruise folder holds a profile that Snakemake may have taken for its own.
    """
    for name, value in MEMORY.items():
        os.environ.setdefault(name, value)  # the jobs', which are processes of their own
    os.environ["PYTHONSAFEPATH"] = "1"  # theirs too: the folder that they start in is not searched for modules
    if cruise.resolve() != project.resolve():
        sys.path[:] = [path for path in sys.path if Path(path or ".").resolve() != cruise.resolve()]
        for name in PROFILES:
            if (cruise / name).is_file() or any((cruise / name).glob("*.yaml")):
                expected = "no profile of Snakemake in a cruise folder, as settings are never taken from there"
                raise InputError(str(cruise / name), expected=expected, found="one", advice="remove or rename it")


def mooring_cores(config: Mapping[str, object], *, is_module: bool = False) -> int:
    """Read how many cores the one job of a mooring has; 0 where each stage is a job.

    Args:
        config: what ``--config`` and ``--configfile`` gave: nothing else, as it would stand in no archive.
        is_module: another workflow uses this one, whose settings ``config`` may hold too.

    Raises:
        InputError: there is another setting, or no such number.
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
    """Refuse to be a module whose results would stand elsewhere than in the folder of the run.

    Args:
        modifier: Snakemake's, of paths.

    Raises:
        InputError: the module has a prefix.
    """
    if modifier.prefix or modifier.modifies_prefixes:
        advice = "start the workflow that uses this one with --directory CRUISE, and leave prefix: out"
        raise InputError("module", expected="results in the folder of the run", found="a prefix", advice=advice)


def begin() -> float:
    """Take the cruise for this run alone, before its first job; return the time by ``file_clock``.

    Raises:
        InputError: another run is under way, or no result can be written.
    """
    refuse_read_only([RESULTS])
    if lock():
        sweep()
    return file_clock()


def listing(paths: Iterable[str], begun: float) -> list[str]:
    """List at the end of a run what each of its jobs said last, what was warned of, and which jobs were killed.

    Args:
        paths: records of all jobs.
        begun: when the run began, by ``file_clock``.
    """
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
        name, _, what = last.partition(": ")  # the name stands in the label already
        lines.append(f"  {label}: {what if name.split(' ')[0] == label.split(' ')[0] else last}")
    lines += [f"Warnings: {len(warned)}", *(f"  {line}" for line in warned)] if warned else []
    lines += [f"Killed: {len(killed)}", *(f"  {label}: {KILLED}" for label in killed)] if killed else []
    return lines if ran else []


def _label(record: Path) -> str:
    """Name a job by what it is of and its stage, as ``M1 read top``."""
    _, *folders = record.parent.parent.parts  # below results
    name, stage = (
        "/".join(folders[folders[:1] in (["calibrations"], ["compasses"]) :]),
        record.stem.replace("_", " ", 1),
    )
    return f"{name} {stage}" if name else stage


def refuse_links(folders: Sequence[str]) -> None:
    """Refuse a link where the run writes: what it leads to is somebody else's.

    ``results`` itself may be a link to a folder, on a scratch disk, that is no other cruise's.

    Args:
        folders: of results, of each mooring, calibration and compass.

    Raises:
        InputError: at the first link.
    """
    below = [f"{folder}/{name}" for folder in (RESULTS, *folders) for name in BELOW]
    ours = [
        SNAKEMAKES,
        *map(str, Path(SNAKEMAKES).glob("*")),
        RESULTS,
        f"{RESULTS}/calibrations",
        f"{RESULTS}/compasses",
    ]
    for path in [*ours, *folders, *below]:  # a file in them is replaced, whatever it is a link to
        scratch = path == RESULTS and os.path.isdir(path)
        if os.path.islink(path) and not (scratch and not Path(os.path.realpath(path), "../config").exists()):
            advice = "put the cruise on the other disk and name it by --directory, or mount the disk there"
            raise InputError(path, expected="no link where results are written", found="one", advice=advice)


def file_clock() -> float:
    """Read the time, in seconds since 1970, by the clock that dates the files of the cruise: perhaps a server's."""
    with suppress(OSError), tempfile.TemporaryFile(dir=SNAKEMAKES) as file:
        return os.fstat(file.fileno()).st_mtime
    return time.time()


def refuse_future(paths: Iterable[str], now: float) -> None:
    """Refuse an input dated in the future: Snakemake would make all that reads it again, and fail, in every run.

    Args:
        now: by ``file_clock``.

    Raises:
        InputError: at the first such file.
    """
    for path in paths:
        if is_future(path, now):
            date = datetime.fromtimestamp(os.stat(path).st_mtime, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
            present = datetime.fromtimestamp(now, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
            advice = (
                f"set the clock of this machine if it is wrong, otherwise redate the file: touch {shlex.quote(path)}"
            )
            raise InputError(path, expected=f"a date of change before now, {present}", found=date, advice=advice)


def refuse_read_only(outputs: Iterable[str]) -> None:
    """Refuse to begin where a result could not be written.

    Raises:
        InputError: at the first file or folder without the right to write.
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
    """Take the cruise for this process until it ends; False where no lock can be had.

    Raises:
        InputError: another run is under way.
    """
    try:
        os.makedirs(SNAKEMAKES, exist_ok=True)
        handle = os.open(LOCK, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        advice = "wait until it has ended, or stop it"
        raise InputError(str(Path.cwd()), expected="one run at a time", found="another", advice=advice) from None
    except OSError:  # a file system without locks, or one that is read only: Snakemake has its own way and words
        return False
    _locks.append(handle)
    return True


def sweep() -> None:
    """Delete what a killed run has left half written; no link is followed."""
    for folder, _, files in os.walk(RESULTS):
        for name in files:
            path = Path(folder, name)
            if TEMPORARY.fullmatch(name) and not path.is_symlink():
                path.unlink(missing_ok=True)


def to_simulate(cruise: Cruise, warn: Callable[[str], object] = print) -> dict[str, list[str]]:
    """List the raw files of each demonstration mooring that a rule may write.

    None of a mooring whose files are all there and not provably the simulation's own: they are raw files like any.

    Raises:
        InputError: some files of a mooring are missing and others are not the simulation's, or one belongs to two.
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
    """List the raw files of each mooring of a demonstration, nothing elsewhere."""
    moorings = cruise.moorings.items() if cruise.options.demonstration else ()
    return {
        name: [file for each in mooring.instruments.values() for file in (*each.files, *each.pressure_files)]
        for name, mooring in moorings
    }


def _foreign(file: str, digest: str, ours: Sequence[str] | set[str]) -> bool:
    """Return whether a name is taken by what the simulation did not write: a file, a link, or another case of it."""
    path = Path(file)
    folders = [folder for folder in path.parents if folder.name]
    if any(folder.is_symlink() for folder in folders):
        return True
    try:
        return not stat.S_ISREG(path.lstat().st_mode) or digest not in ours
    except FileNotFoundError:
        absent = [place for place in (path, *folders) if not place.exists() and place.parent.is_dir()]
        return any(place.name.casefold() in map(str.casefold, os.listdir(place.parent)) for place in absent)
