"""Process one mooring without Snakemake, from its YAML file to its product, by running the stages in sequence.

Stages and intermediate files are those of the workflow, and the product is identical to the last bit. Figures, summary
and report are made by the workflow only.
"""

from __future__ import annotations

import fcntl
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import chdir, contextmanager, suppress
from inspect import signature
from itertools import product
from pathlib import Path
from typing import Any

from compasslib.config import cruise as config
from compasslib.config.cruise import Cruise
from compasslib.errors import InputError
from compasslib.pipeline import plan, records
from compasslib.pipeline.records import RESULTS
from compasslib.pipeline.settings import Wildcards
from compasslib.pipeline.whole import load_stage
from compasslib.statistics import single_threaded

TEMPORARY, MARK = ".compass-correct.", "compass-correct.lock"  # in the name of an incomplete results folder; its lock


def process_mooring(
    cruise: str | Path, mooring: str, folder: str | Path, say: Callable[[str], None] = lambda line: None
) -> Path:
    """Correct one mooring of a cruise and return the folder of its results, which appears complete or not at all.

    Meanwhile the cruise folder is the working folder, as in the workflow; the function is not thread-safe.

    Args:
        folder: folder of the results, which must not exist yet; as ``results/NAME`` of the workflow, without figures.
        say: called with the report of each stage on its result.

    Raises:
        InputError: a mistake in the cruise, a raw file that cannot be read, or a folder that already exists.
    """
    loaded, there = config.load_cruise(Path(cruise)), Path(folder).absolute()
    if mooring not in (*loaded.moorings, *loaded.whole):
        expected = f"a mooring of {cruise} ({', '.join(loaded.moorings) or 'it has none'})"
        raise InputError(mooring, expected=expected, found="another name", advice="write one of these names")
    _refuse_taken(there, loaded.root.absolute() / "results")
    with _whole(there) as inside, chdir(loaded.root):
        run_stages(loaded, mooring, inside, say)
    return there


LAST = ("corrected.nc", "forms.json", "gridded.nc")  # final files of a mooring, which need all others except figures


def run_stages(
    cruise: Cruise,
    mooring: str,
    folder: Path,
    say: Callable[[str], None] = lambda line: None,
    last: Sequence[str] = LAST,
) -> None:
    """Run the stages of one mooring into a folder, overwriting files there; the cruise is the working folder.

    Calibrations and other moorings of its compass, where needed, are processed below ``work`` in that folder.

    Args:
        folder: folder of the mooring's results, absolute.
        last: files to be made, together with all that they need.
    """
    planned, done = plan.plan(cruise), set[str]()
    parts = cruise.whole.get(mooring, [])

    def make(record: str) -> None:
        """Run the stages that precede a job, then its own; a compass is joined without unusable records."""
        done.add(record)
        rule, job = planned.jobs[record]
        files, unusable = planned.files(rule, job), set[str]()
        for path in records.flat(files["reads"]):
            try:
                if (before := planned.writers.get(path, record)) not in done:
                    make(before)
            except InputError:
                if rule != "join":
                    raise
                unusable.add(path)
        reads = {
            name: (given if isinstance(given, str) else [path for path in given if path not in unusable])
            for name, given in files["reads"].items()
        }
        named = {name: _moved(given, mooring, folder) for name, given in (reads | files["writes"]).items()}
        speak = say if job.mooring in ("", mooring, *parts) else lambda line: None
        run_stage(planned.stages[rule], job, named | {"say": speak})

    for name, file in product(dict.fromkeys((*parts, mooring)), last):
        record = planned.writers.get(f"{RESULTS}/{name}/{file}")
        if record is not None and record not in done:
            make(record)


def run_stage(stage: plan.Stage, job: Wildcards, named: dict[str, Any]) -> None:
    """Import the function of a stage and run it with those files and settings that are among its arguments."""
    function = load_stage(stage.function)
    taken = signature(function).parameters
    settings = {name: given(job) for name, given in stage.settings.items()}
    with single_threaded():
        function(*filter(None, job), **{name: value for name, value in (settings | named).items() if name in taken})


def _moved(given: Any, mooring: str, folder: Path) -> Any:
    """Map result files of the workflow to the folder of a mooring that is processed alone."""
    if not isinstance(given, str):
        return [_moved(path, mooring, folder) for path in given]
    parts = Path(given).parts
    if parts[0] != RESULTS:
        return given
    if Path(given).is_relative_to(f"{RESULTS}/{mooring}"):
        path = folder / Path(given).relative_to(f"{RESULTS}/{mooring}")
    else:
        inside = {"calibrations": parts[1:], "compasses": ("compasses", *parts[3:])}
        path = folder.joinpath("work", *inside.get(parts[1], ("compasses", *parts[1:])))
    path.parent.mkdir(parents=True, exist_ok=True)
    return str(path)


def _refuse_taken(folder: Path, results: Path) -> None:
    if folder.resolve().is_relative_to(results.resolve()):
        expected, advice = "a folder outside the workflow's results", "name another folder"
        raise InputError(str(folder), expected=expected, found="one inside", advice=advice)
    if folder.exists():
        advice = "name another folder, or move that one away"
        raise InputError(str(folder), expected="a folder that is not there yet", found="it there", advice=advice)


@contextmanager
def _whole(folder: Path) -> Iterator[Path]:
    """Yield a temporary folder that is renamed to the requested one once the block has succeeded."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    for left in folder.parent.iterdir():  # leftovers of killed runs for the same results
        ours = left.name.startswith(f".{folder.name}{TEMPORARY}") and not left.is_symlink()
        if ours and (left / MARK).is_file() and not (left / MARK).is_symlink():
            with (left / MARK).open("r+") as stream, suppress(OSError):
                fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)  # BlockingIOError while a run holds it
                shutil.rmtree(left, ignore_errors=True)
    temporary = Path(tempfile.mkdtemp(prefix=f".{folder.name}{TEMPORARY}", dir=folder.parent))
    try:
        with (temporary / MARK).open("w") as mark:
            with suppress(OSError):  # on a file system without locks, leftovers of killed runs remain
                fcntl.flock(mark, fcntl.LOCK_EX | fcntl.LOCK_NB)
            yield temporary
            temporary.chmod(0o755)  # mkdtemp grants access to the owner only
            (temporary / MARK).unlink()
            temporary.rename(folder)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
