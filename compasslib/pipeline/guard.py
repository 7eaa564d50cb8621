"""Around a run: nothing of a cruise folder is code or a setting, and nothing is written but what is the run's own."""

from __future__ import annotations

import fcntl
import os
import re
import shlex
import stat
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

from compasslib.archive.files import HALF_WRITTEN
from compasslib.config.cruise import Cruise
from compasslib.errors import InputError
from compasslib.pipeline.ledger import RESULTS, KnownHashes, is_future, simulated

PROFILES = ("default", "profiles/default")  # where Snakemake looks in the folder that it is started in
SNAKEMAKES, OWN_LOCK = ".snakemake", ".snakemake/compasslib.lock"
BELOW = ("work", "work/alone", "wide", "figures", "logs", "benchmarks")  # in the folder of each mooring and calibration
# glibc gives large arrays back and takes the next one anew, page by page: a quarter of a simulated mooring's time, a
# twentieth of an assessment's. Those under 32 MB stay with the process, which grows by some 10 MB.
MEMORY = {"MALLOC_MMAP_THRESHOLD_": str(2**25), "MALLOC_TRIM_THRESHOLD_": str(2**26)}
TEMPORARY = re.compile(rf"\..+\.\d+{re.escape(HALF_WRITTEN)}")  # as archive_files.replacing names them

_locks: list[int] = []  # open for as long as the process lives; the kernel lets go of it when that is killed


def enter(cruise: Path, project: Path) -> None:
    """Make a cruise folder safe to plan a run in; nothing in it is written to.

    Raises:
        InputError: the cruise folder holds a profile that Snakemake may have taken for its own.
    """
    for name, value in MEMORY.items():
        os.environ.setdefault(name, value)  # the jobs', which are processes of their own
    _keep_code_out(cruise, project)
    _refuse_profiles(cruise, project)


def refuse_config(config: Mapping[str, object]) -> None:
    """Refuse settings of Snakemake's own, which would change nothing here and stand in no archive.

    Args:
        config: what ``--config`` and ``--configfile`` gave.

    Raises:
        InputError: there is one.
    """
    if config:
        expected, found = "settings in the cruise's YAML files alone", ", ".join(map(str, config))
        advice = "write it into config/config.yaml, or into the mooring's file, and run again"
        raise InputError("--config", expected=expected, found=found, advice=advice)


def refuse_links(folders: Sequence[str]) -> None:
    """Refuse a link where the run writes: what it leads to is somebody else's.

    Args:
        folders: of results, of each mooring and calibration, below results/.

    Raises:
        InputError: at the first link.
    """
    for path in _written(folders):
        if os.path.islink(path):
            advice = "put the cruise on the other disk and name it by --directory, or mount the disk there"
            raise InputError(path, expected="no link where results are written", found="one", advice=advice)


def file_clock() -> float:
    """Return the time, in seconds since 1970, by the clock that dates the files of the cruise: perhaps a server's."""
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
                f"set the clock of this machine if it is wrong, otherwise date the file anew: touch {shlex.quote(path)}"
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
                found = "a read-only file system" if os.statvfs(needed).f_flag & os.ST_RDONLY else "no right to write"
                advice = (
                    "give yourself that right (chmod -R u+w), or copy the cruise to where you have it, and run again"
                )
                raise InputError(needed, expected="the right to write here", found=found, advice=advice)


def alone() -> bool:
    """Return whether this process may call the cruise its own until it ends; False where no lock can be had.

    Raises:
        InputError: another run is under way.
    """
    try:
        os.makedirs(SNAKEMAKES, exist_ok=True)
        handle = os.open(OWN_LOCK, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
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


def to_simulate(cruise: Cruise, known: KnownHashes) -> dict[str, list[str]]:
    """Return the raw files of each demonstration mooring that a rule may write.

    None of a mooring whose files are all there and not provably the simulation's own: they are raw files like any.

    Raises:
        InputError: some files of a mooring are missing and others are not the simulation's, or one belongs to two.
    """
    files = simulated_names(cruise)
    taken: dict[str, str] = {}
    for name, file in [(name, file) for name, listed in files.items() for file in listed]:
        if taken.setdefault(file, name) != name:
            found, advice = f"that of {taken[file]}", "give each its own"
            where = f"{cruise.mooring_files[name]}: {file}"
            raise InputError(where, expected="a file of one simulated mooring", found=found, advice=advice)
    return {name: listed for name, listed in files.items() if _may_write(name, listed, known)}


def simulated_names(cruise: Cruise) -> dict[str, list[str]]:
    """Return the raw files of each mooring of a demonstration, nothing elsewhere."""
    return {name: _raw_files(cruise, name) for name in cruise.moorings if cruise.options.demonstration}


def _may_write(name: str, raw: Sequence[str], known: KnownHashes) -> bool:
    ours = simulated(name)
    foreign = [file for file in (*raw, f"truth/{name}.csv") if _foreign(file, known.sha256(file), ours.get(file, ()))]
    if foreign and not all(os.path.isfile(file) for file in raw):
        missing = next(file for file in raw if not os.path.isfile(file))
        found = f"a file or link that is there already, while {missing} is missing"
        advice = "measured files are never written over: add the missing one, or delete demonstration: true"
        raise InputError(foreign[0], expected="what the simulation wrote, or nothing", found=found, advice=advice)
    return not foreign


def _foreign(file: str, digest: str, ours: Sequence[str] | set[str]) -> bool:
    """Return whether a name is taken by what the simulation did not write: a file, a link, or another case of it."""
    path = Path(file)
    folders = [folder for folder in path.parents if folder.name]
    if any(folder.is_symlink() for folder in folders):
        return True
    try:
        return not stat.S_ISREG(path.lstat().st_mode) or digest not in ours
    except FileNotFoundError:
        return any(_other_case(place) for place in (path, *folders))


def _other_case(path: Path) -> bool:
    if path.exists() or not path.parent.is_dir():
        return False
    return path.name.casefold() in {other.casefold() for other in os.listdir(path.parent)}


def _raw_files(cruise: Cruise, name: str) -> list[str]:
    instruments = cruise.moorings[name].instruments.values()
    return [file for instrument in instruments for file in (*instrument.files, *instrument.pressure_files)]


def _written(folders: Sequence[str]) -> Iterator[str]:
    """Give the folders that a run writes into; a file in them is replaced, whatever it is a link to."""
    yield SNAKEMAKES
    yield from (str(path) for path in Path(SNAKEMAKES).glob("*"))
    yield from (RESULTS, f"{RESULTS}/calibrations", f"{RESULTS}/compasses")
    for name in folders:
        yield f"{RESULTS}/{name}"
    yield from (f"{RESULTS}/{below}" for below in BELOW)
    yield from (f"{RESULTS}/{name}/{below}" for name in folders for below in BELOW)


def _keep_code_out(cruise: Path, project: Path) -> None:
    # For the jobs too: the folder that they start in is not searched for modules.
    os.environ["PYTHONSAFEPATH"] = "1"
    if cruise.resolve() != project.resolve():
        sys.path[:] = [path for path in sys.path if Path(path or ".").resolve() != cruise.resolve()]


def _refuse_profiles(cruise: Path, project: Path) -> None:
    if cruise.resolve() == project.resolve():
        return
    for name in PROFILES:
        if (cruise / name).is_file() or any((cruise / name).glob("*.yaml")):
            expected = "no profile of Snakemake in a cruise folder, as settings are never taken from there"
            raise InputError(str(cruise / name), expected=expected, found="one", advice="remove or rename it")
