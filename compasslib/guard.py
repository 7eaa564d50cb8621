"""Around a run: nothing of a cruise folder is code or a setting, and a run that was killed is no obstacle."""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import sys
from pathlib import Path

from compasslib.errors import InputError

PROFILES = ("default", "profiles/default")  # where Snakemake looks in the folder that it is started in
LOCKS, OWN_LOCK = ".snakemake/locks", ".snakemake/compasslib.lock"
# glibc gives large arrays back and takes the next one anew, page by page: a quarter of a simulated mooring's time, a
# twentieth of an assessment's. Those under 32 MB stay with the process, which grows by some 10 MB.
MEMORY = {"MALLOC_MMAP_THRESHOLD_": str(2**25), "MALLOC_TRIM_THRESHOLD_": str(2**26)}
TEMPORARY = re.compile(r"\..+\.\d+")  # as archive_files.replacing names them

_held: list[int] = []  # open for as long as the process lives; the kernel lets go of it when that is killed


def enter(cruise: Path, project: Path) -> None:
    """Make a cruise folder safe to run in.

    Args:
        cruise: its folder.
        project: this pipeline's folder.

    Raises:
        InputError: the cruise folder holds a profile that Snakemake may have taken for its own.
    """
    for name, value in MEMORY.items():
        os.environ.setdefault(name, value)  # the jobs', which are processes of their own
    _keep_code_out(cruise, project)
    _refuse_profiles(cruise, project)
    with contextlib.suppress(OSError):  # a folder that cannot be written to has no lock; Snakemake says what is wrong
        _clear_after_a_kill(cruise)


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


def _clear_after_a_kill(cruise: Path) -> None:
    """Remove what a killed run has left, unless another one is running: locks, and files that were half written."""
    own = cruise / OWN_LOCK
    own.parent.mkdir(exist_ok=True)
    handle = os.open(own, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(handle)
        return
    _held.append(handle)
    left = [*(cruise / LOCKS).glob("*.lock"), *(cruise / "results").rglob(".*")]
    for path in left:
        if path.suffix == ".lock" or TEMPORARY.fullmatch(path.name):
            path.unlink(missing_ok=True)
