"""One mooring from its YAML file to its product without Snakemake: the workflow's stages, one after the other.

The files between the stages are the workflow's, so that the product is too, to the last bit. Figures, the summary and
the report are the workflow's own.
"""

from __future__ import annotations

import fcntl
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import chdir, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from compasslib import calibration, deviation, observatory, readers
from compasslib.archive import netcdf, provenance
from compasslib.calibration import at_mooring, content
from compasslib.config import calibrations
from compasslib.config import cruise as config
from compasslib.core import earthfield
from compasslib.core.errors import InputError
from compasslib.core.records import EarthField, Pairs, Record
from compasslib.deviation import assessment, correction
from compasslib.deviation.model import Fit
from compasslib.preparation import deployment, overlap
from compasslib.search import covariates, moored
from compasslib.search import product as products
from compasslib.search.product import Product
from compasslib.stages import plan as stages

TEMPORARY, MARK = ".compass-correct.", "compass-correct.lock"  # of a folder of results until it is whole


@dataclass(frozen=True)
class Job:
    """What a rule of the workflow knows of its job."""

    mooring: str
    role: str = ""


@dataclass(frozen=True)
class Task:
    """One mooring of a cruise, and where its files come."""

    plan: stages.Plan
    job: Job
    folder: Path  # of the results, absolute
    say: Callable[[str], None]

    @property
    def name(self) -> str:
        """Return the mooring's name."""
        return self.job.mooring


@dataclass(frozen=True)
class Measured:
    """What the stages after the overlap start from."""

    record: Record
    pairs: Pairs
    wide: Pairs  # they may stand further apart
    field: EarthField


def process(
    cruise: str | Path, mooring: str, folder: str | Path, say: Callable[[str], None] = lambda line: None
) -> Path:
    """Correct one mooring of a cruise and return the folder of its results, which appears whole or not at all.

    The working folder is the cruise's meanwhile, as in the workflow; not for several threads at once.

    Args:
        cruise: folder that holds config/config.yaml.
        folder: of the results, which must not be there yet; as ``results/NAME`` of the workflow, without figures.
        say: takes what each stage says of its result.

    Raises:
        InputError: a mistake in the cruise, a raw file that cannot be read, or a folder that is there already.
    """
    loaded = config.load(Path(cruise))
    plan, there = stages.plan(loaded, Path()), Path(folder).absolute()
    if mooring not in loaded.moorings:
        expected = f"a mooring of {cruise} ({', '.join(loaded.moorings) or 'it has none'})"
        raise InputError(mooring, expected=expected, found="another name", advice="write one of these names")
    _refuse_taken(there, loaded.root.absolute() / "results")
    with _whole(there) as inside, chdir(loaded.root):
        _run(Task(plan, Job(mooring), inside, say))
    return there


def _refuse_taken(folder: Path, results: Path) -> None:
    if folder.resolve().is_relative_to(results.resolve()):
        expected, advice = "a folder outside the workflow's results", "name another folder"
        raise InputError(str(folder), expected=expected, found="one inside", advice=advice)
    if folder.exists():
        advice = "delete it or name another folder"
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
            with mark.open("r+") as held, suppress(OSError):
                fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)  # held by a run that is alive: BlockingIOError
                shutil.rmtree(left, ignore_errors=True)


def _run(task: Task) -> None:
    measured = _measured(task)
    _fit(task, measured)
    _diagnose(task, measured)
    made_by = products.from_json(netcdf.read_json(task.folder / "deviation.json"))
    refuted = _assess(task, measured, made_by)
    _correct(task, measured, made_by, refuted=refuted)


def _measured(task: Task) -> Measured:
    field = _field(task)
    mooring = task.plan.cruise.moorings[task.name]
    upper = _record(task, mooring.compromised)
    lower = [_record(task, mooring.reference)] if mooring.reference else []
    rules = overlap.Rules(**task.plan.cruise.options.overlap.model_dump())
    clocks = overlap.clocks(upper, lower, rules)
    pairs, wide = (
        _pairs(task.folder / file, overlap.find(upper, lower, field, each, clocks))
        for file, each in (("overlap.nc", rules), ("wide/overlap.nc", overlap.widened(rules)))
    )
    task.say(overlap.log_line(task.name, pairs))
    return Measured(upper, pairs, wide, field)


def _pairs(file: Path, found: Pairs) -> Pairs:
    file.parent.mkdir(exist_ok=True)
    netcdf.write_pairs(file, found)
    return netcdf.read_pairs(file)


def _record(task: Task, role: str) -> Record:
    job, file = Job(task.name, role), task.folder / f"work/{role}.nc"
    paths = [Path(path) for path in task.plan.raw_files(job)]
    raw = readers.read(task.plan.form(job), paths, task.plan.reader_settings(job))
    netcdf.write_record(file, deployment.settle(raw, **task.plan.deployment(job)))
    record = netcdf.read_record(file)
    task.say(deployment.log_line(task.name, role, record))
    return record


def _field(task: Task) -> EarthField:
    file = task.folder / "work/field.json"
    place = task.plan.place_and_declination(task.job)
    along = observatory.with_observatory(earthfield.along_time(**place), task.plan.observatory(task.job), place)
    netcdf.write_json(file, vars(along))
    field = earthfield.from_json(netcdf.read_json(file))
    task.say(earthfield.log_line(task.name, field))
    return field


def _fit(task: Task, measured: Measured) -> None:
    method = task.plan.method(task.job)
    fit, origin = _carried(task, measured) if method == at_mooring.METHOD else (_fitted(task, measured), {})
    netcdf.write_json(task.folder / "work/fit.json", deviation.described(fit, measured.record) | origin)
    task.say(deviation.told(task.name, fit))


def _fitted(task: Task, measured: Measured) -> Fit:
    dip_ratio = task.plan.tilt(task.job) * earthfield.dip_ratio(measured.field)
    return deviation.fit(task.plan.method(task.job), measured.pairs, dip_ratio=dip_ratio)


def _carried(task: Task, measured: Measured) -> tuple[Fit, dict[str, object]]:
    """Return the fit of a calibration that is made here and now, and what deviation.json says of it."""
    name = str(task.plan.cruise.moorings[task.name].fit.name)
    given = task.plan.cruise.calibrations[name]
    settings = calibration.settled(calibrations.settings(given))
    made = calibration.calibrate(str(given.kind), given.files, settings)
    file = task.folder / "work/calibration.json"
    netcdf.write_json(file, content.described(name, made, settings, {}) | provenance.stamp(given.files))
    elsewhere = netcdf.read_json(file)
    fit = at_mooring.carried(elsewhere, measured.field, measured.record, measured.pairs)
    return fit, at_mooring.origin(elsewhere, measured.field)


def _diagnose(task: Task, measured: Measured) -> None:
    configured = netcdf.read_json(task.folder / "work/fit.json")
    fit, series = deviation.from_json(configured), _series(task, measured, at=measured.pairs)
    chosen = task.plan.diagnose(task.job)
    found = moored.diagnose(measured.pairs, series, fit, measured.field, wide=measured.wide, **chosen)
    netcdf.write_json(task.folder / "diagnosis.json", found.to_json())
    netcdf.write_json(task.folder / "deviation.json", configured | {"applied": products.of(fit, found).to_json()})
    task.say(moored.told(task.name, found))


def _series(task: Task, measured: Measured, at: Pairs | None = None) -> products.Series:
    return covariates.logged(measured.record, task.plan.observatory(task.job), at=at)


def _correct(task: Task, measured: Measured, made_by: Product, *, refuted: bool) -> None:
    record, pairs, field = measured.record, measured.pairs, measured.field
    at = products.along(made_by, record, field, _series(task, measured))
    doubt_deg = correction.doubt(refuted, made_by.left_deg)
    product = correction.in_pieces(record, made_by.fit, field, pairs, at, doubt_deg=doubt_deg)
    netcdf.write_corrected(
        task.folder / "corrected.nc",
        product,
        site=netcdf.Site(**task.plan.site(task.job)),
        attributes=task.plan.attributes(task.job),
        processing=provenance.processing(made_by, field, task.plan.all_raw_files(task.job)),
    )
    task.say(correction.told(task.name, product))


def _assess(task: Task, measured: Measured, made_by: Product) -> bool:
    series = _series(task, measured)
    plain = products.plain(made_by, measured.pairs, measured.record, measured.field, series)
    verdict = assessment.assess(measured.pairs, made_by.fit, plain)
    netcdf.write_json(task.folder / "assessment.json", verdict)
    netcdf.write_json(task.folder / "forms.json", {"forms": assessment.compare_forms(measured.pairs, made_by.fit)})
    task.say(assessment.told(task.name, verdict))
    return bool(verdict["refuted"])
