"""Would catch a changed key that re-runs too little or too much, a command of ``compass verify`` that does not mend."""

import json
import os
import re
import shlex
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from functools import reduce
from pathlib import Path

import numpy as np
import pytest
import yaml

from compasslib.archive.files import read_json
from compasslib.cli import main
from compasslib.config.cruise import load_cruise
from compasslib.pipeline import job
from compasslib.stages import settings
from tests.world.bench import BREST, readings, write_calibration
from tests.world.launch import completed, hashes, snakemake
from tests.world.sea import cruise, mooring
from tests.world.two_heads_files import cast

HOURS = 60
FIGURES = re.compile("(?<=calibration_figures)_.*")  # names of figures in the name of a rule
Job = tuple[str, ...]  # rule and wildcards


def varied(folder: Path, *, heads: bool = True) -> Path:
    """Write a cruise: a plain mooring, two affected instruments, a shared compass, given coefficients; calibrations."""
    names = ("M1", "M2", "M3", "M4")
    cruise(folder, names, n=HOURS)
    plain, two, shared, given = moorings = [mooring(name, HOURS) for name in names]
    plain["covariates"] = {"supply_mA": {"format": "table", "files": "raw/M1/deep.csv"}}
    plain["covariates"]["supply_mA"]["columns"] = {"time": "time_utc", "value": "u_cm_s"}
    plain["instruments"]["spare"] = plain["instruments"]["deep"] | {"depth": 300}
    two["compromised"] = ["top", "mid"]
    fit = {"method": "calibration", "name": ["before", "after"]}
    two["instruments"]["mid"] = two["instruments"]["top"] | {"fit": fit, "parts": ["frame"]}
    shared["instruments"]["top"] |= {"compass": "wh1", "sphere": "s1", "sphere_distance_m": 0.5}
    del given["reference"]
    coefficients = {"A": 0.02, "B": 0.3, "C": 0.1, "D": 0.03, "E": -0.02}
    given["fit"] = {"method": "coefficients", "coefficients": coefficients}
    for each in moorings:
        (folder / f"config/moorings/{each['name']}.yaml").write_text(json.dumps(each))
    write_calibration(folder, "before", readings(), budget="le_menn")
    write_calibration(folder, "after", readings(seed=2), compare_with="before")
    write_calibration(folder, "bench", readings(seed=3), compare_with=["before", "after"], compass="wh1")
    course = np.arange(0.0, 360.0, 10.0)
    rows = [f"{x + 3 * np.sin(np.deg2rad(x)) + 5},{x},{6 + k % 3}" for k, x in enumerate(course)]
    (folder / "raw/swing.csv").write_text("\n".join(["compass_deg,cog_deg,speed_kn", *rows]) + "\n")
    calibrations = {"swing": {"kind": "swing", "file": "raw/swing.csv"} | BREST}
    if heads:
        cast(folder / "raw")
        calibrations["heads"] = {"kind": "two_heads", "file": ["raw/a.000", "raw/b.000"]}
    for name, said in calibrations.items():
        (folder / f"config/calibrations/{name}.yaml").write_text(json.dumps(said))
    (folder / "config/config.yaml").write_text("moorings: config/moorings\ndiagnose: {enabled: false}\n")
    return folder


def stated(folder: Path) -> dict[Job, set[str]]:
    """List for each job the parameters and files that the YAML files state for it, as the rules do."""
    cruise = load_cruise(folder)
    of, curves, shared = settings.Moorings(cruise), settings.Calibrations(cruise), settings.Compasses(cruise)
    moorings, calibrations = [(name,) for name in cruise.moorings], [(name,) for name in cruise.calibrations]
    instruments = [(name, role) for name in cruise.moorings for role in of.roles(name)]
    carried = {(name,) for name in cruise.moorings if cruise.moorings[name].fit.method == "calibration"}
    joined, of_compasses = {(name,) for name in shared.moorings}, [(name,) for name in cruise.compasses]
    daily = {(name,) for name, files in of.gridded.items() if files[1:]}
    gridded, diagnosed = [(name,) for name in of.gridded], [(name,) for name in curves.diagnosed]

    def none(*_: str) -> dict:
        return {}

    def drawn(*_: str) -> dict:
        return {"formats": cruise.options.figures.formats}

    def records(name: str) -> list[str]:
        return [of.affected(name), *of.references(name), *of.observatory(name)]

    def figures(name: str) -> list[str]:
        return [figure for figures, names in curves.figures.items() if name in names for figure in figures]

    def described() -> dict:
        return {"attributes": cruise.options.attributes, "configuration": settings.configuration(cruise)}

    def needed() -> dict:
        without = {"moorings": [], "calibrations": []}
        return settings.needs(cruise) | {"without": without, "order": list(cruise.moorings)}

    rules = [
        ("read", of.read, instruments, of.raw_files, of.companion_files),
        ("overlap", of.overlap, moorings, records, of.ready_pairs),
        ("fit", of.fit, [name for name in moorings if name not in carried]),
        ("transfer_calibration", of.transfer_calibration, carried, of.calibrations),
        ("diagnose", of.diagnose, [name for name in moorings if name not in joined], records),
        ("diagnose_alone", of.diagnose, joined, records),
        ("diagnose_jointly", of.diagnose, joined, records, lambda name: [shared.moorings[name]]),
        ("correct", of.correct, moorings, records),
        ("figures", drawn, moorings),
        ("grid", of.grid, [name for name in gridded if name not in daily], of.references, of.observatory),
        ("grid_with_daily_means", of.grid, daily, of.references, of.observatory),
        ("sections", drawn, gridded),
        ("calibrate", curves.calibrate, calibrations, curves.raw_files),
        ("compare_calibrations", curves.compare_calibrations, calibrations, curves.compared_with),
        ("calibration_figures", drawn, calibrations, figures),
        ("diagnose_calibration", curves.diagnose, diagnosed, curves.raw_files),
        ("combine_records", shared.combine_records, of_compasses, lambda name: map(str, cruise.compasses[name])),
        ("joined_figures", drawn, of_compasses),
        ("usable", needed, [()], lambda: [*cruise.moorings, *cruise.calibrations]),
        ("summary", lambda: {"roles": {name: of.roles(name) for name in cruise.moorings}}, [()]),
        ("cruise_figures", lambda: {"array": settings.array(cruise)} | drawn(), [()]),
        ("report", lambda: settings.report(cruise), [()]),
        ("provenance", described, [()]),
    ]
    return {
        (rule, *subject): {*job.flatten(arguments(*subject)).values(), *(x for each in files for x in each(*subject))}
        for rule, arguments, subjects, *files in rules
        for subject in subjects
    }


# Keys of a file, new values, and the rules of the jobs that they concern; what follows from these runs again too.
CHANGES = """
config/config.yaml
overlap.max_minutes: 15 | overlap
overlap.max_metres: 15 | overlap
overlap.predict: false | overlap
fit.method: von_appen | fit overlap
diagnose.enabled: true | diagnose diagnose_alone diagnose_jointly diagnose_calibration
diagnose.surrogates: 39 | diagnose diagnose_alone diagnose_jointly diagnose_calibration
diagnose.min_effect_deg: 1 | diagnose diagnose_alone diagnose_jointly diagnose_calibration combine_records
product.grid.step_m: 4 | grid
product.flags: [1] | grid
product.daily: true | grid_with_daily_means
figures.formats: [png, pdf] | figures sections calibration_figures joined_figures cruise_figures
quality.percent_good: 50 | read
attributes.institution: Sea | correct grid report provenance
config/moorings/M1.yaml
latitude: 65.4 | read overlap correct grid cruise_figures report
water_depth: 900 | read correct grid cruise_figures report
start: 2007-09-04T03:00Z | read overlap report
end: 2007-09-06 | read overlap report
declination: -22 | overlap
reference: [deep, spare] | read overlap diagnose correct grid summary cruise_figures report
attributes.comment: A mooring | correct grid
fit: {method: von_appen} | overlap fit
fit: {method: calibration, name: before} | transfer_calibration usable
confirmed.constant: true | diagnose
covariates.supply_mA.unit: mA | read
covariates.supply_mA.columns.value: v_cm_s | read
covariates.obs: {format: iaga2002, files: raw/M1/deep.csv} | overlap diagnose correct grid
instruments.top.depth: 101 | read cruise_figures report
instruments.top.orientation: down | read cruise_figures
instruments.top.declination_applied: 1 | read overlap
instruments.top.heading_alignment: 10 | read
instruments.top.clock_offset_seconds: 60 | read
instruments.top.pressure_offset: 1 | read
instruments.top.direction_reference: 'true' | read
instruments.top.exclude: [{from: 2007-09-05, to: 2007-09-06}] | read
instruments.top.compass: wh2 | usable diagnose_alone diagnose_jointly combine_records joined_figures report provenance
instruments.top.sphere: s2 | fit
instruments.top.sphere_distance_m: 0.5 | fit diagnose
instruments.top.attributes.serial_number: 8104 | read correct grid
instruments.deep.columns.scale: 0.02 | read
instruments.deep.timezone: '+01:00' | read
instruments.deep.depth: 106 | read cruise_figures report
instruments.deep.direction_reference: 'true' | read overlap diagnose grid
instruments.deep.compass_sigma_deg: 3 | overlap grid
instruments.deep.kind: rotor | overlap grid
instruments.spare.depth: 301 | cruise_figures
config/moorings/M2.yaml
compromised: [mid, top] | usable grid
instruments.mid.fit.name: [after, before] | usable transfer_calibration
instruments.mid.parts: [frame, battery] | transfer_calibration
config/moorings/M3.yaml
instruments.top.sphere: s2 | combine_records
instruments.top.sphere_distance_m: 0.6 | diagnose_alone diagnose_jointly
config/moorings/M4.yaml
fit.coefficients.B: 0.31 | fit
fit.model: von_appen | fit diagnose
config/calibrations/before.yaml
declination: 1 | calibrate diagnose_calibration
date: 2022-09-30 | calibrate diagnose_calibration
withhold: [time_utc] | calibrate diagnose_calibration
table_step_deg: 15 | calibrate
object: {distance_m: 0.6, size_m: 0.2} | calibrate
budget: null | calibrate
uncertainty.slope_deg: 0.2 | calibrate
compass: wh1 | combine_records usable provenance
config/calibrations/bench.yaml
compare_with: [after, before] | compare_calibrations
compare_with: null | compare_calibrations calibration_figures
config/calibrations/swing.yaml
min_speed_kn: 1 | calibrate diagnose_calibration
declination_sigma_deg: 1 | calibrate diagnose_calibration
visual: [{compass_deg: 40, true_deg: 42}] | calibrate diagnose_calibration
config/calibrations/heads.yaml
file: [raw/b.000, raw/a.000] | calibrate diagnose_calibration
orientation: [up, down] | calibrate diagnose_calibration
"""
# Other ways to write the same, and keys that no result depends on.
UNUSED = """
config/config.yaml
seed: 7
moorings: [config/moorings/M4.yaml, config/moorings/M3.yaml, config/moorings/M2.yaml, config/moorings/M1.yaml]
overlap: {bins: 2, max_minutes: 20.0}
config/moorings/M1.yaml
latitude: 6.53333e+1
start: 2007-09-04
compromised: [top]
reference: [deep]
fit: {method: exact}
instruments.top.files: raw/M1/*.000
instruments.top.parts: [frame]
instruments.top.kind: rotor
instruments.spare.clock_offset_seconds: 60
instruments.deep.columns: {scale: 0.01, north: v_cm_s, east: u_cm_s, depth: depth_m, time: time_utc}
"""


def lines(table: str) -> list[tuple[str, str]]:
    """List file and content of each line."""
    listed, file = [], ""
    for line in table.split("\n")[1:-1]:
        if line.startswith("config/"):
            file = line
        else:
            listed.append((file, line))
    return listed


@contextmanager
def edited(folder: Path, file: str, *keys: str) -> Iterator[None]:
    """Set keys, written as ``outer.inner: value``, in a YAML file for a while; null deletes one."""
    before = (folder / file).read_text()
    content = yaml.safe_load(before)
    for name, value in (yaml.safe_load(key).popitem() for key in keys):
        *outer, last = name.split(".")
        inner = reduce(lambda each, part: each.setdefault(part, {}), outer, content)
        inner[last] = value
        if value is None:
            del inner[last]
    (folder / file).write_text(yaml.safe_dump(content, sort_keys=True))
    try:
        yield
    finally:
        (folder / file).write_text(before)


def changed(before: dict[Job, set[str]], after: dict[Job, set[str]]) -> set[Job]:
    """List jobs that are new, or whose parameters or files differ."""
    return {job for job, texts in after.items() if before.get(job) != texts}


def belongs(job: Job, file: str) -> bool:
    """Whether a job is of the whole cruise, of the mooring or calibration of a YAML file, or of a compass with it."""
    name = Path(file).stem
    return name == "config" or not job[1:] or job[1].split("/")[0] in (name, "wh1", "wh2")


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = varied(tmp_path_factory.mktemp("cruise"))
    return folder, stated(folder)


@pytest.mark.parametrize(("file", "line"), lines(CHANGES))
def test_changed_key_concerns_exactly_its_jobs(written, file, line):
    folder, before = written
    key, rules = line.rsplit(" | ", 1)
    with edited(folder, file, key):
        jobs = changed(before, stated(folder))
    assert {rule for rule, *_ in jobs} == {*rules.split()}
    assert all(belongs(job, file) for job in jobs)


@pytest.mark.parametrize(("file", "line"), lines(UNUSED))
def test_unused_key_concerns_no_job(written, file, line):
    folder, before = written
    with edited(folder, file, line):
        assert changed(before, stated(folder)) == set()


# ------------------------------------------------------------------------------------------------------ by Snakemake
@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """Process the cruise."""
    folder = varied(tmp_path_factory.mktemp("done"), heads=False)
    return completed(folder, drawn=False)


def planned(folder: Path, *options: str) -> dict[Job, str]:
    """Return the reason of each job that Snakemake would run now."""
    ran = snakemake(folder, "--dry-run", "--quiet", "progress", *options)
    assert ran.returncode == 0, ran.stderr
    jobs = {}
    for rule, said in re.findall(r"(?:rule|checkpoint) (\w+):\n((?: +[a-z].*\n)+)", ran.stdout):
        wildcards = re.search(r" wildcards: (.*)", said)
        of = [each.partition("=")[2] for each in wildcards[1].split(", ")] if wildcards else []
        jobs[(FIGURES.sub("", rule), *of)] = re.search(r" reason: (.*)", said)[1]
    return {job: reason for job, reason in jobs.items() if job[0] not in ("all", "complete")}


def key_lines(jobs: dict[Job, str]) -> list[str]:
    """List the parts of reasons that tell the keys."""
    return [found[0] for reason in jobs.values() if (found := re.search(r"Params have changed.*?before: .*", reason))]


def surplus(jobs: dict[Job, str], expected: set[Job]) -> set[Job]:
    """List jobs that run for another reason than a job before them, besides those expected and the manifest."""
    due = {job for job, reason in jobs.items() if not reason.startswith("Input files updated by another job")}
    return due - expected - {("provenance",)}


def test_jobs_are_given_the_parameters_and_files_of_the_table(done):
    given = stated(done)
    records = [read_json(path) for path in (done / "results").glob("**/logs/*.json")]
    for record in records:
        texts = given.get((FIGURES.sub("", record["rule"]), *record["of"].values()), set())
        assert {text for text in texts if "=" in text} == {*job.flatten(record["parameters"]).values()}
        assert {text for text in texts if text.startswith(("raw/", "results/"))} <= record["read"].keys()
    assert given.keys() <= {(FIGURES.sub("", record["rule"]), *record["of"].values()) for record in records}


REAL = (
    *("overlap.max_metres", "figures.formats", "attributes.institution"),
    *("instruments.top.exclude", "instruments.mid.fit.name", "uncertainty.slope_deg"),
)


@pytest.mark.parametrize(("file", "line"), [each for each in lines(CHANGES) if each[1].split(": ")[0] in REAL])
def test_snakemake_reruns_what_the_table_says(done, file, line):
    before = stated(done)
    with edited(done, file, line.rsplit(" | ", 1)[0]):
        expected, jobs = changed(before, stated(done)), planned(done)
    assert expected <= jobs.keys() and not surplus(jobs, expected)
    assert {("provenance",)} <= jobs.keys()
    name = line.split(": ")[0].rsplit(".", 1)[-1]
    told = key_lines(jobs)
    assert told or name in ("check", "formats")  # reason: missing files
    assert all(len(text) < 400 and " now: " in text and "=" in text for text in told)


def test_comment_reruns_the_manifest_only(done):
    """It lists the hash of the YAML file."""
    file = done / "config/moorings/M1.yaml"
    before = file.read_text()
    assert planned(done) == {}
    file.write_text(f"{before} # a comment")
    assert planned(done).keys() == {("provenance",)}
    file.write_text(before)
    assert planned(done) == {}


def test_results_that_were_copied_together_need_pages_only(done, tmp_path):
    """Parts of a cruise that ran elsewhere are merged so, with Snakemake's records and under the dates of the files."""
    whole = shutil.copytree(done, tmp_path / "whole")
    pages = {"usable", "summary", "cruise_figures", "report", "provenance"}
    assert {job[0] for job in planned(whole, "--forcerun", "usable")} == pages


def test_without_the_records_of_snakemake_every_job_runs_again(done, tmp_path):
    """A changed key would go unnoticed."""
    whole = shutil.copytree(done, tmp_path / "whole", ignore=shutil.ignore_patterns(".snakemake"))
    assert {("read", "M1", "top"), ("correct", "M1"), ("summary",)} <= planned(whole).keys()


def test_results_of_a_later_date_are_refused(done, tmp_path):
    """Snakemake would take a replaced raw file for an older one."""
    whole = shutil.copytree(done, tmp_path / "whole")
    os.utime(whole / "results/logs/summary.json", (4e9, 4e9))
    ran = snakemake(whole, "--dry-run")
    assert ran.returncode == 1 and "found some of a later date" in ran.stderr and "--forceall" in ran.stderr
    assert snakemake(whole, "--dry-run", "--forceall").returncode == 0


def replaced(path: Path, old: str, new: str) -> None:
    """Replace a text in a file once, under its old date."""
    status, content = path.stat(), path.read_bytes()
    assert old.encode() in content
    path.write_bytes(content.replace(old.encode(), new.encode(), 1))
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))


def mend(folder: Path, capsys) -> list[str]:
    """Run the command that ``compass verify`` prints and return the other lines; none where nothing differs."""
    status = main(["verify", str(folder)])
    *said, command = capsys.readouterr().out.splitlines()
    if status == 0:
        return []
    named, _, options = command.partition(" -- ")
    assert named == f"mend: compass run {folder}"
    completed(folder, *shlex.split(options), drawn=False)
    return said


def test_verify_prints_the_command_that_mends(done, capsys):
    before = hashes(done / "results", "logs", "benchmarks")
    raw = done / "raw/M1/deep.csv"
    value = raw.read_text().split(",")[-1].strip()
    replaced(raw, f",{value}", f",1{value}")
    replaced(done / "results/M2/mid/deviation.json", "0", "1")
    assert planned(done) == {}
    (done / "results/M3/table.csv").unlink()
    assert {("correct", "M3"), ("figures", "M3")} < planned(done).keys()
    said = mend(done, capsys)
    assert [line.partition(" (")[0] for line in said] == [
        "changed: raw/M1/deep.csv", "changed: results/M2/mid/deviation.json", "missing: results/M3/table.csv",
    ]  # fmt: skip
    assert mend(done, capsys) == [] and hashes(done / "results", "logs", "benchmarks") != before
    replaced(raw, f",1{value}", f",{value}")
    assert len(mend(done, capsys)) == 1 and mend(done, capsys) == []
    assert hashes(done / "results", "logs", "benchmarks") == before
