"""One mooring from its YAML file to its product without Snakemake: the workflow's stages, one after the other.

The stages and the files between them are the workflow's, so that the product is too, to the last bit. Figures, the
summary and the report are the workflow's own.
"""

from __future__ import annotations

import fcntl
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import chdir, contextmanager, suppress
from dataclasses import dataclass
from importlib import import_module
from inspect import signature
from pathlib import Path
from typing import Any

from compasslib.calibrations import at_mooring
from compasslib.config import cruise as config
from compasslib.config.cruise import Cruise
from compasslib.errors import InputError
from compasslib.pipeline import compasses, plan
from compasslib.statistics import single_threaded

FILES = {
    "field": "work/field.json",
    "pairs": "overlap.nc",
    "wide": "wide/overlap.nc",
    "fit": "work/fit.json",
    "diagnosis": "diagnosis.json",
    "deviation": "deviation.json",
    "assessment": "assessment.json",
    "forms": "forms.json",
    "corrected": "corrected.nc",
}  # of a mooring's folder, by the names that the workflow's rules give them
MODULES = {"carry": "fit", "share": "diagnose", "join": "diagnose", "compare": "correct"}  # of stages that share one
TEMPORARY, MARK = ".compass-correct.", "compass-correct.lock"  # of a folder of results until it is whole


@dataclass(frozen=True)
class Wildcards:
    """The wildcards of a job, as the workflow's rules know them."""

    mooring: str = ""
    role: str = ""
    calibration: str = ""
    compass: str = ""


def process_mooring(
    cruise: str | Path, mooring: str, folder: str | Path, say: Callable[[str], None] = lambda line: None
) -> Path:
    """Correct one mooring of a cruise and return the folder of its results, which appears whole or not at all.

    The working folder is the cruise's meanwhile, as in the workflow; not for several threads at once.

    Args:
        folder: of the results, which must not be there yet; as ``results/NAME`` of the workflow, without figures.
        say: takes what each stage says of its result.

    Raises:
        InputError: a mistake in the cruise, a raw file that cannot be read, or a folder that is there already.
    """
    loaded, there = config.load(Path(cruise)), Path(folder).absolute()
    if mooring not in loaded.moorings:
        expected = f"a mooring of {cruise} ({', '.join(loaded.moorings) or 'it has none'})"
        raise InputError(mooring, expected=expected, found="another name", advice="write one of these names")
    _refuse_taken(there, loaded.root.absolute() / "results")
    with _whole(there) as inside, chdir(loaded.root):
        run_stages(loaded, mooring, inside, say)
    return there


def run_stages(cruise: Cruise, mooring: str, folder: Path, say: Callable[[str], None] = lambda line: None) -> None:
    """Run the stages of one mooring into a folder, over what stands there; the cruise is the working folder.

    Args:
        folder: of the mooring's results, absolute.
    """
    planned = plan.plan(cruise, Path())
    given = _alone(planned, mooring, folder, say)
    compass = planned.compasses.moorings.get(mooring)
    if compass is None:
        _do("diagnose", Wildcards(mooring), given)
    else:
        made = _judged_alone(given, mooring, folder)
        joined = _joined(planned, compass, mooring, folder, made)
        alone = [made[name] for name in ("diagnosis", "deviation", "assessment")]
        _do("share", Wildcards(mooring), given | {"joined": joined, "alone": alone})
    for rule in ("compare", "correct"):
        _do(rule, Wildcards(mooring), given)


def _alone(planned: plan.Plan, mooring: str, folder: Path, say: Callable[[str], None]) -> dict[str, Any]:
    """Read one mooring, pair and fit it; return what all of its rules may name."""
    rules, job = planned.moorings, Wildcards(mooring)
    used = [Wildcards(mooring, role) for role in rules.roles([mooring])[mooring]]
    records = [str(folder / f"work/{each.role}.nc") for each in used]
    given = {name: str(folder / file) for name, file in FILES.items()} | {
        "record": records[0],
        "references": records[1:],
        "observatory": rules.observatory(job),
        "place": rules.place_and_declination(job),
        "rules": rules.pairing_rules(job),
        "method": rules.method(job),
        "tilt": rules.tilt(job),
        "options": rules.diagnose(job),
        "site": rules.site(job),
        "attributes": rules.attributes(job),
        "sources": rules.all_raw_files(job),
        "say": say,
    }
    for file in (*FILES.values(), "work/record"):
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
    for each, record in zip(used, records, strict=True):
        _do("read", each, given | read_settings(rules, each) | {"record": record})
    _do("overlap", job, given | {"upper": records[0], "lower": records[1:]})
    if given["method"] == at_mooring.METHOD:
        name = str(planned.cruise.moorings[mooring].fit.name)
        given["calibration"] = _calibrated(planned.calibrations, name, folder / "work/calibrations", say)
    _do("carry" if "calibration" in given else "fit", job, given)
    return given


def _judged_alone(given: Mapping[str, Any], mooring: str, folder: Path) -> dict[str, str]:
    """Judge a record of a shared compass by itself; return what it shows and what others may learn from it."""
    made = {name: str(folder / f"work/alone/{name}.json") for name in compasses.ALONE}
    (folder / "work/alone").mkdir(parents=True, exist_ok=True)
    _do("diagnose", Wildcards(mooring), {**given, **made})
    return made


def _joined(planned: plan.Plan, compass: str, mooring: str, folder: Path, own: Mapping[str, str]) -> str:
    """Join the records of a mooring's compass, the others made here and now, and return its compass.json.

    What others cannot be used is left out, as the workflow does.
    """
    moorings, given = planned.compasses.members[compass]
    there, say = folder / "work/compasses", lambda line: None
    there.mkdir(parents=True, exist_ok=True)
    summaries, calibrations = [], []
    for other in moorings:
        with suppress(InputError):
            made = own if other == mooring else None
            made = made or _judged_alone(_alone(planned, other, there / other, say), other, there / other)
            summaries.append(made["summary"])
    for name in given:
        with suppress(InputError):
            calibrations.append(_calibrated(planned.calibrations, name, folder / "work/calibrations", say))
    files = {"joined": str(there / "compass.json"), "diagnosis": str(there / "diagnosis.json")}
    job = Wildcards(compass=compass)
    rules = {
        "summaries": summaries,
        "calibrations": calibrations,
        "spheres": planned.compasses.spheres(job),
        "min_effect_deg": planned.cruise.options.diagnose.min_effect_deg,
        "say": say,
    }
    _do("join", job, rules | files)
    return files["joined"]


def _do(rule: str, job: Wildcards, given: Mapping[str, Any]) -> None:
    """Run the stage of a rule with what it takes by name, as the workflow does; only then is it imported."""
    stage = getattr(import_module(f"compasslib.stages.{MODULES.get(rule, rule)}"), rule)
    wildcards = [name for name in vars(job).values() if name]
    with single_threaded():
        stage(*wildcards, **{name: given[name] for name in signature(stage).parameters if name in given})


def read_settings(rules: plan.Moorings, job: Wildcards) -> dict[str, Any]:
    """Return the arguments of ``read.record_of`` for one instrument."""
    return {
        "raw": rules.raw_files(job),
        "form": rules.form(job),
        "reader": rules.reader_settings(job),
        "deployment": rules.deployment(job),
        "series": rules.series(job),
    }


def _calibrated(rules: plan.Calibrations, name: str, folder: Path, say: Callable[[str], None]) -> str:
    """Calibrate here and now, after those that it is compared with, and return its calibration.json."""
    job, other = Wildcards(calibration=name), rules.cruise.calibrations[name].compare_with
    files = {file.split(".")[0]: str(folder / name / file) for file in ("calibration.json", "table.csv", "points.csv")}
    (folder / name).mkdir(parents=True, exist_ok=True)
    given = {"raw": rules.raw_files(job), "kind": rules.kind(job), "settings": rules.settings(job), "say": say}
    given["earlier"] = [] if other is None else [_calibrated(rules, other, folder, say)]
    _do("calibrate", job, given | files)
    return files["calibration"]


def _refuse_taken(folder: Path, results: Path) -> None:
    if folder.resolve().is_relative_to(results.resolve()):
        expected, advice = "a folder outside the workflow's results", "name another folder"
        raise InputError(str(folder), expected=expected, found="one inside", advice=advice)
    if folder.exists():
        advice = "name another folder, or move that one away"
        raise InputError(str(folder), expected="a folder that is not there yet", found="it there", advice=advice)


@contextmanager
def _whole(folder: Path) -> Iterator[Path]:
    """Give a folder beside the wanted one that takes its place once the block has ended well."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    _clear_after_a_kill(folder)
    beside = Path(tempfile.mkdtemp(prefix=f".{folder.name}{TEMPORARY}", dir=folder.parent))
    try:
        with (beside / MARK).open("w") as mark:
            with suppress(OSError):  # a file system without locks: what a kill leaves there stays
                fcntl.flock(mark, fcntl.LOCK_EX | fcntl.LOCK_NB)
            yield beside
            beside.chmod(0o755)  # a temporary folder is its maker's alone
            (beside / MARK).unlink()
            beside.rename(folder)
    finally:
        shutil.rmtree(beside, ignore_errors=True)


def _clear_after_a_kill(folder: Path) -> None:
    """Remove temporary folders of earlier runs for the same results: their name, our mark, nobody's lock."""
    for left in folder.parent.iterdir():
        ours = left.name.startswith(f".{folder.name}{TEMPORARY}") and not left.is_symlink()
        mark = left / MARK
        if ours and mark.is_file() and not mark.is_symlink():
            with mark.open("r+") as stream, suppress(OSError):
                fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)  # held by a run that is alive: BlockingIOError
                shutil.rmtree(left, ignore_errors=True)
