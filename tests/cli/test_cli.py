"""Would catch an output of ``compass`` that misstates a result, a refusal of several lines, a wrong exit status."""

import json
import re
import shutil
import signal
import subprocess
import sys
import time
from copy import deepcopy
from pathlib import Path

import netCDF4
import numpy as np
import pytest
import yaml

from compasslib import angles, calibrations, earthfield
from compasslib.archive import calibrations as calibration_files
from compasslib.archive import summary
from compasslib.archive.files import write_json
from compasslib.calibrations import result
from compasslib.calibrations.platform import BenchReadings
from compasslib.cli import _parser, main, results
from compasslib.cli.diff import compare_jobs
from tests.world import chain
from tests.world.bench import MILD, readings, ring, write_table
from tests.world.launch import change, snakemake
from tests.world.sea import cruise

DIAGNOSED = {
    **{"verdict": "consistent", "findings": [], "unexplained": None},
    **{"separated_by": None, "not_testable": [], "why": ""},
}
COMPASS = [sys.executable, "-c", "import sys; from compasslib.cli import main; sys.exit(main())"]


def test_an_interruption_within_netcdf4_is_raised_after_it():
    """An exception that a signal raises within netCDF4 can be lost: 9 of 180 terminated runs went on."""
    main(["explain", "nowhere"])  # sets the handlers
    within = compile("signal.getsignal(signal.SIGTERM)(signal.SIGTERM, sys._getframe())", "_netCDF4.pyx", "exec")
    exec(within, {"signal": signal, "sys": sys})
    with pytest.raises(KeyboardInterrupt):
        time.sleep(5.0)


def refused(capsys, *words: str) -> str:
    """Check that a command fails with one line on stderr, and return the line."""
    assert main(words) == 1
    out, err = capsys.readouterr()
    assert out == "" and err.startswith("error: ") and err.count("\n") == 1
    return err


@pytest.fixture(scope="module")
def runs(tmp_path_factory) -> Path:
    """Process the mooring of a cruise twice, the second time with another declination."""
    folder = cruise(tmp_path_factory.mktemp("cruise"), n=600)
    chain.make(folder, "M1", folder / "old/M1")
    change(folder / "config/moorings/M1.yaml", declination=-22.0)
    chain.make(folder, "M1", folder / "new/M1")
    return folder


@pytest.fixture
def copied(runs, tmp_path) -> Path:
    """Copy the earlier run, to be damaged."""
    shutil.copytree(runs / "old", tmp_path / "results")
    return tmp_path / "results/M1"


def test_help_lists_commands_without_heavy_imports():
    code = (
        "import sys\nfrom compasslib.cli import main\n"
        "try:\n    main(['--help'])\nexcept SystemExit:\n"
        "    print([m for m in ('numpy', 'pydantic', 'yaml', 'netCDF4', 'scipy', 'matplotlib') if m in sys.modules])\n"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert all(name in ran.stdout for name in ("check", "correct", "explain", "export", "diff"))
    assert ran.stdout.endswith("[]\n")


@pytest.mark.parametrize("name", ["check", "init", "correct", "explain", "export", "diff", "verify"])
def test_help_of_each_command_ends_with_a_valid_example(capsys, name):
    with pytest.raises(SystemExit) as ended:
        main([name, "--help"])
    told = capsys.readouterr().out.rstrip().splitlines()
    assert ended.value.code == 0 and told[-2] == "example:"
    words = told[-1].split()
    assert words[:2] == ["compass", name] and _parser().parse_args(words[1:]).command == name


@pytest.mark.parametrize(
    "words", [[], ["mend"], ["correct"], ["diff", "a"], ["check", "--loud"], ["verify", "c", "--yes"]]
)
def test_invalid_command_line_exits_with_status_2(capsys, words):
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert ended.value.code == 2 and "usage: compass" in capsys.readouterr().err


def test_check_summarizes_each_mooring(tmp_path, capsys):
    folder = cruise(tmp_path, ("M1", "M2"), n=5)
    change(folder / "config/moorings/M2.yaml", reference=None)
    assert main(["check", str(folder)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "M1: 65.3333° N, 32.9550° W; 2007-09-04 to 2007-09-04, by exact"
    seen = [line.split() for line in lines]
    assert seen[2][:6] == ["top", "affected", "pd0", "5", "1", "h"]
    assert seen[3][:4] == ["deep", "reference", "table", "5"]
    assert "  with deep: 5 pairs over 0 days, 10.2 m apart, " in lines[5]
    assert any("no reference, so nothing is corrected" in line for line in lines)
    assert lines[-1] == "2 moorings: can run, 0 problems"
    assert any(line.startswith("to deposit the results, add") and "license" in line for line in lines)
    told = lines.index("4 warnings:")
    assert [line.split(":")[0] for line in lines[told + 1 : -1]] == ["  M1 top", "  M1 deep", "  M2 top", "  M2 deep"]
    assert not (folder / "results").exists()


@pytest.mark.parametrize("change_it", ["latitude: 95.3", "latitud: 65", "raw"])
def test_check_reports_errors_like_the_workflow(tmp_path, capsys, change_it):
    folder = cruise(tmp_path, n=5)
    if change_it == "raw":
        (folder / "raw/M1/top.000").unlink()
    else:
        change(folder / "config/moorings/M1.yaml", **yaml.safe_load(change_it))
    assert main(["check", str(folder)]) == 1
    out, err = capsys.readouterr()
    assert out.splitlines()[-1] == "cannot run, 1 problem"
    assert "config/moorings/M1.yaml" in err and err.strip() in snakemake(folder).stderr


def test_check_reads_the_data_and_reports_every_mistake(tmp_path, capsys):
    folder = cruise(tmp_path, ("M1", "M2", "M3"), n=5)
    change(folder / "config/moorings/M1.yaml", latitude=95.3, water_depth=-1)
    (folder / "raw/M2/deep.csv").write_text("time_utc,depth\n")
    assert main(["check", str(folder)]) == 1
    out, err = capsys.readouterr()
    wrong = ("M1.yaml: latitude: expected", "M1.yaml: water_depth: expected", "M2: deep: raw/M2/deep.csv: column")
    assert all(text in line for text, line in zip(wrong, err.splitlines(), strict=True)) and "M3: 65" in out


TABLE = {"format": "table", "files": "raw/M1/current.csv", "columns": {"time": "time", "value": "mA"}}


def test_check_reads_unused_instruments_and_covariates(tmp_path, capsys):
    folder = cruise(tmp_path, n=50)
    path = folder / "config/moorings/M1.yaml"
    told = yaml.safe_load(path.read_text())
    later = deepcopy(told["instruments"]["deep"]) | {"files": "raw/M1/spare.csv"}
    change(path, instruments=told["instruments"] | {"spare": later}, covariates={"pump": TABLE})
    (folder / "raw/M1/spare.csv").write_text("no table\n")
    (folder / "raw/M1/current.csv").write_text("time,mA\n2001-09-04T00:00:00Z,3\n2001-09-04T01:00:00Z,4\n")
    assert main(["check", str(folder)]) == 1
    out, err = capsys.readouterr()
    assert (
        "M1: spare: raw/M1/spare.csv: column" in err
        and "covariates.pump: raw/M1/current.csv: expected values inside the deployment" in err
    )
    assert "  pump: table, 2 values, 2001-09-04 00:00 to 2001-09-04 01:00" in out
    assert out.splitlines()[-1] == "1 mooring: can run, 2 problems (stopped: M1)"
    (folder / "raw/M1/current.csv").write_text("time,mA\nyesterday,3\n")
    assert main(["check", str(folder)]) == 1 and "M1: covariates.pump: raw/M1/current.csv" in capsys.readouterr().err


def test_check_reports_missing_pairs_and_coefficients(tmp_path, capsys):
    folder = cruise(tmp_path, n=50)
    path = folder / "config/moorings/M1.yaml"
    change(path, instruments=yaml.safe_load(path.read_text().replace("depth: 105", "depth: 400"))["instruments"])
    table = (folder / "raw/M1/deep.csv").read_text()
    (folder / "raw/M1/deep.csv").write_text(table.replace(",105.0,", ",400.0,"))
    (folder / "config/calibrations").mkdir()
    (folder / "config/calibrations/turn.yaml").write_text("kind: swing\nfile: raw/turn.csv\ndeclination: 3\n")
    (folder / "raw/turn.csv").write_text("compass_deg,cog_deg\n10,20\n15,30\n20,40\n")
    assert main(["check", str(folder)]) == 1
    out, err = capsys.readouterr()
    assert "  with deep: no pairs" in out
    assert "M1: no pairs with deep, so nothing is corrected by it: no two veloc" in err
    assert "turn.yaml: no coefficients: 3 headings cannot carry the five coefficients" in err
    assert out.splitlines()[-1] == "1 mooring and 1 calibration: can run, 2 problems"


def test_check_reports_two_serial_numbers_of_one_compass(tmp_path, capsys):
    folder = cruise(tmp_path, ("M1", "M2"), n=50)
    for name in ("M1", "M2"):
        path = folder / f"config/moorings/{name}.yaml"
        told = yaml.safe_load(path.read_text())["instruments"]
        numbered = {"compass": "wh1", "attributes": {"serial_number": f"WH-810{name[1]}"}}
        year = {"M1": {}, "M2": {"start": "2009-09-04T00:00:00Z", "end": "2009-09-06T00:00:00Z"}}[name]
        change(path, instruments={"top": told["top"] | numbered, "deep": told["deep"]}, **year)
    assert main(["check", str(folder)]) == 1
    err = capsys.readouterr().err
    assert "compass wh1: serial number WH-8101 at M1 (top), WH-8102 at M2 (top): two instruments under one name" in err


def test_check_outside_a_cruise_is_refused(tmp_path, capsys):
    for place in (tmp_path, tmp_path / "nowhere"):
        assert "config/config.yaml: expected this file" in refused(capsys, "check", str(place))


def test_correct_writes_outside_the_workflow_results(tmp_path, capsys):
    folder = cruise(tmp_path / "c", n=60)
    assert main(["correct", "M1", "--cruise", str(folder)]) == 0
    out, err = capsys.readouterr()
    assert out.strip() == str(folder / "corrected/M1") and "60 of 60 headings corrected" in err
    stages, warnings = re.split(r"\d+ warnings?:\n", err)
    assert "warning" not in stages and all(line.startswith("  M1") for line in warnings.splitlines())
    assert "  M1 top: pitch and roll never change: " in warnings
    assert main(["explain", "M1", "--cruise", str(folder)]) == 0
    assert "M1: insufficient" in capsys.readouterr().out
    assert "expected a folder that is not there yet" in refused(capsys, "correct", "M1", "--cruise", str(folder))


def test_correct_refuses_an_unknown_mooring(tmp_path, capsys):
    folder = cruise(tmp_path / "c", n=5)
    assert "M2: expected a mooring of" in refused(capsys, "correct", "M2", "--cruise", str(folder))
    assert not (folder / "corrected").exists()


def test_explain_prints_verdict_uncertainty_and_limits(runs, capsys):
    assert main(["explain", str(runs / "old/M1")]) == 0
    told = capsys.readouterr().out
    diagnosis = json.loads((runs / "old/M1/diagnosis.json").read_text())
    assert told.splitlines()[0] == f"M1: {diagnosis['verdict']}"
    assert "\nCan it be used?\n  With care, with an uncertainty of" in told  # of a month in slow water
    assert re.search(r"Uncertainty of the heading \(1σ\): median \d+\.\d°, 95th percentile \d+\.\d°", told)
    assert "Limits of this record" in told and "Not testable in this record: " in told
    assert "stuck tilt (" in " ".join(told.split())
    assert max(map(len, told.splitlines())) <= 100


def test_explain_prints_findings_and_warnings(copied, capsys):
    finding = {
        "effect": "heeling", "side": "compass", "alternatives": ["stuck_tilt"], "rms_effect_deg": 3.1,
        "where": {"covariate": "pitch", "from": 4.0, "to": 11.0, "text": "pitch 4 to 11 degrees"},
        "when": {"from": "2007-11-02T00:00:00Z", "to": "2008-10-04T00:00:00Z"},
        "parameters": {"b_z_nT": {"value": 2100.0, "sigma": 140.0, "unit": "nT"}},
        "heldout": {"rms_before_deg": 11.9, "rms_after_deg": 11.3, "p_value": 0.001},
        "applied": False, "text": "The compass tilts over iron.",
    }  # fmt: skip
    rewrite(copied / "diagnosis.json", verdict="ambiguous", findings=[finding], separated_by="a swing at a tilt")
    rewrite(copied / "deviation.json", warnings=["few pairs in spring"])
    assert main(["explain", "M1", "--cruise", str(copied.parents[1])]) == 0
    told = capsys.readouterr().out.replace("\N{NO-BREAK SPACE}", " ")
    words = ("M1: ambiguous", "Finding: Heeling", "Alternatives: the tilt sensors are stuck", "Acts on: compass",
             "few pairs in spring", "field down: 2100 ± 140 nT", "Decisive observation: A swing at a tilt")  # fmt: skip
    assert [said for said in words if said not in told] == [] and "Figure: " not in told
    figure = copied / "figures/diagnosis.png"
    figure.parent.mkdir()
    figure.touch()
    assert main(["explain", "M1", "--cruise", str(copied.parents[1])]) == 0
    assert f"Figure: {figure}" in capsys.readouterr().out


def test_explain_describes_a_calibration(calibrated, tmp_path, capsys):
    assert main(["explain", str(calibrated / "old/calibrations/bench")]) == 0
    told = capsys.readouterr().out
    assert told.startswith("bench: not searched\n") and "model: exact compass" in told
    shutil.copytree(calibrated / "old/calibrations/few", tmp_path / "few")
    (tmp_path / "few/table.csv").unlink()
    assert "all results of a calibration, found no table.csv" in refused(capsys, "explain", str(tmp_path / "few"))


def rewrite(file: Path, **keys: object) -> None:
    file.write_text(json.dumps(json.loads(file.read_text()) | keys))


@pytest.mark.parametrize("file", results.MOORING_FILES)
@pytest.mark.parametrize("content", [None, "{}", "[1]", '{"verdict": '])
def test_incomplete_or_damaged_results_are_refused(copied, capsys, file, content):
    (copied / file).unlink() if content is None else (copied / file).write_text(content)
    line = refused(capsys, "explain", str(copied))
    if content is None:
        assert f"expected all results of a mooring, found no {file}; run the cruise to its end" in line
    assert file in line or f"{copied}: expected results of this version" in line


def test_a_mooring_without_results_is_refused(copied, capsys):
    root = str(copied.parents[1])
    assert f"M7: expected a mooring, calibration or compass with results in {root}, found M1;" in refused(
        capsys, "explain", "M7", "--cruise", root
    )
    assert "found no folder results" in refused(capsys, "explain", "M7", "--cruise", str(copied))


def test_explain_ends_quietly_if_the_pipe_is_closed(runs):
    end = subprocess.Popen([*COMPASS, "explain", str(runs / "old/M1")], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    end.stdout.close()
    assert end.stderr.read() == b"" and end.wait() == 1
    end.stderr.close()


def test_warnings_of_unconfigured_instruments_are_omitted(runs, copied):
    shutil.copy(copied / "work/top.nc", copied / "work/upper.nc")  # as left behind by a renamed instrument
    told = summary.summary_row("M1", copied, ["top", "deep"])["warnings"]
    assert "top: pitch and roll never change" in told and "upper: " not in told
    assert told == summary.summary_row("M1", runs / "old/M1")["warnings"]
    assert told != summary.summary_row("M1", copied)["warnings"]


def test_diff_reports_the_effects_of_another_declination(runs, capsys):
    """Both instruments are magnetic: a declination larger by 1.56 degrees rotates all true headings by as much."""
    assert main(["diff", str(runs / "old"), str(runs / "new/M1")]) == 0
    head, row = capsys.readouterr().out.splitlines()
    assert head.split("  ")[0] == "mooring" and row.startswith("M1")
    rms, largest = (float(x) for x in re.findall(r"(\d+\.\d+)°", row))
    assert rms == pytest.approx(1.56, abs=0.05) and rms <= largest < 1.7  # the fit differs in the solver's last digits
    also = row.rpartition("  ")[2].split(", ")
    assert "DECLINATION" in also and "UCUR" not in also and "HEADING_CORRECTED" not in also


@pytest.mark.parametrize(
    ("file", "keys", "shown"),
    [
        ("diagnosis.json", {"verdict": "unexplained"}, r"\w+ → unexplained"),
        ("diagnosis.json", {"findings": [{"effect": "heeling"}]}, "none → heeling"),
        ("diagnosis.json", {"why": "other words"}, "diagnosis.json"),
        ("deviation.json", {"coefficients": dict.fromkeys("ABCDE", 0.0)}, r"A [+−]0\.\d+ \(\d\.?\d*σ\), B [+−]0"),
        ("deviation.json", {"coefficients": None}, "fitted → none"),
        ("deviation.json", {"method": "von_appen"}, "exact → von_appen"),
        ("assessment.json", {"after": {}}, "assessment.json"),
    ],
)
def test_diff_reports_each_kind_of_change(runs, copied, capsys, file, keys, shown):
    rewrite(copied / file, **keys)
    assert main(["diff", str(runs / "old"), str(copied.parents[1])]) == 0
    assert re.search(shown, capsys.readouterr().out.splitlines()[1])


def test_diff_reports_lost_headings_changed_flags_and_variables(runs, copied, capsys):
    with netCDF4.Dataset(copied / "corrected.nc", "a") as nc:
        nc["HEADING_CORRECTED"][:300] = nc["HEADING_CORRECTED"]._FillValue
        nc["HEADING_CORRECTED_QC"][:100] = 3
        nc["HEADING_CORRECTED_QC"][100:120] = 4
        nc["PITCH"][:] = 7.0
        nc.license = "another"
    assert main(["diff", str(runs / "old"), str(copied)]) == 0
    row = capsys.readouterr().out.splitlines()[1]
    assert "100.0\N{NO-BREAK SPACE}% → 50.0\N{NO-BREAK SPACE}%" in row and "PITCH, attribute license" in row
    assert "120 of 600 (1 → 3: 100, 1 → 4: 20)" in row


def test_diff_reports_changes_of_gridded_products_and_of_velocity_flags(runs, copied, capsys):
    for folder, speed in ((runs / "old/M1", 0.4), (copied, 0.5)):
        with netCDF4.Dataset(folder / "gridded_daily.nc", "w") as nc:
            nc.createDimension("DEPTH", 3)
            nc.createVariable("UCUR", "f8", ("DEPTH",))[:] = speed
            nc.createVariable("DEPTH", "f8", ("DEPTH",))[:] = 10.0
            nc.createVariable("TIME", "f8", ("DEPTH",))[:] = 0.0
    assert main(["diff", str(runs / "old"), str(copied)]) == 0
    assert "gridded_daily.nc (UCUR)" in capsys.readouterr().out.splitlines()[1]
    (runs / "old/M1/gridded_daily.nc").unlink()
    with netCDF4.Dataset(copied / "corrected.nc", "a") as nc:
        nc["HEADING_CORRECTED"][:] = nc["HEADING_CORRECTED"][:] + 3.0
        nc["UCUR_QC"][:9] = 4
    assert main(["diff", str(runs / "old"), str(copied)]) == 0
    row = capsys.readouterr().out.splitlines()[1]
    assert "UCUR_QC" in row and "VCUR_QC" not in row and "gridded_daily.nc (on one side)" in row


def test_diff_compares_samples_by_order_if_the_clock_was_corrected(runs, copied, capsys):
    with netCDF4.Dataset(copied / "corrected.nc", "a") as nc:
        nc["TIME"][:] = nc["TIME"][:] + 95.0 / 86400.0
        nc["HEADING_CORRECTED"][:] = nc["HEADING_CORRECTED"][:] + 2.0
    assert main(["diff", str(runs / "old"), str(copied)]) == 0
    assert capsys.readouterr().out.splitlines()[1].split()[1:3] == ["2°", "2°"]


def test_diff_lists_moorings_that_it_cannot_compare(runs, copied, capsys):
    shutil.copytree(copied, copied.parent / "M2")
    shutil.copytree(copied, copied.parent / "M3")
    (copied.parent / "M3/corrected.nc").unlink()
    (copied.parent / "calibrations").mkdir()
    shutil.copytree(runs / "old", copied.parents[1] / "earlier")
    shutil.copytree(runs / "old/M1", copied.parents[1] / "earlier/M3")
    assert main(["diff", str(copied.parents[1] / "earlier"), str(copied.parent)]) == 1
    rows = [line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines()[1:]]
    assert rows == [["M1", "nothing changed"], ["M2", "not in OLD"], ["M3", "NEW is incomplete: no corrected.nc"]]


def test_diff_states_changes_in_sigmas_and_software(runs, copied, capsys):
    with netCDF4.Dataset(copied / "corrected.nc", "a") as nc:
        stated, turned = nc["HEADING_CORRECTED_UNCERTAINTY"][:].filled(), np.linspace(0.0, 2.0, len(nc["TIME"]))
        nc["HEADING_CORRECTED"][:] = angles.wrap360(nc["HEADING_CORRECTED"][:] + turned)
        nc["HEADING_CORRECTED_UNCERTAINTY"][:] = 2.0 * stated
        before, nc.software_version = nc.software_version, "compasslib 0.1.0"
    assert main(["diff", str(runs / "old/M1"), str(copied)]) == 0
    table, software = capsys.readouterr().out.split("\n\n")
    cells = dict(zip(*(re.split("  +", line) for line in table.splitlines()), strict=True))
    told = [float(x) for x in cells["in OLD's 1σ: median, 95 %, largest"].split(", ")]
    assert told == pytest.approx(np.quantile(turned / stated, [0.5, 0.95, 1.0]), rel=0.05)  # printed with two digits
    assert cells["flags"] == "same" and "UNCERTAINTY" in cells["also changed"]
    assert software == f"OLD by {before}\nNEW by compasslib 0.1.0\n"


def test_diff_lists_changed_settings_and_raw_files(tmp_path):
    """Only jobs of both runs are compared; intermediate files and new jobs are ignored."""
    read = {"rule": "read", "of": {"mooring": "M1", "role": "deep"}, "read": {"raw/M1/deep.csv": "a", "results/x": "1"}}
    settings = {"fit": {"method": "exact"}}
    fit = {"rule": "fit", "of": {"mooring": "M1"}, "parameters": settings, "read": {"results/y": "1"}}
    for side, depth, digest, more in (("old", 20.0, "a", {}), ("new", 16.2, "b", {"transfer": fit})):
        spans = {"end_s": 1188864000.0 + 10 * depth, "exclude": [[None, 10 * depth]]}
        now = read | {"parameters": {"deployment": {"nominal_depth": depth} | spans}}
        now |= {"read": read["read"] | {"raw/M1/deep.csv": digest, "results/x": digest}}
        for name, record in ({"read_deep": now, "fit": fit} | more).items():
            write_json(tmp_path / side / f"logs/{name}.json", record)
    assert compare_jobs(tmp_path / "old", tmp_path / "new") == [
        "deep: nominal_depth was 20.0, is 16.2",
        'deep: end was "2007-09-04T00:03:20Z", is "2007-09-04T00:02:42Z"',
        'deep: exclude was [[null, "1970-01-01T00:03:20Z"]], is [[null, "1970-01-01T00:02:42Z"]]',
        "deep: raw/M1/deep.csv changed",
    ]
    assert compare_jobs(tmp_path / "new", tmp_path / "new") == []


@pytest.mark.parametrize("lost", ["HEADING_CORRECTED_UNCERTAINTY", "HEADING_CORRECTED_QC", "DECLINATION", "PITCH"])
@pytest.mark.parametrize("side", ["old", "new"])
def test_diff_tolerates_or_refuses_a_missing_variable(runs, copied, capsys, lost, side):
    with netCDF4.Dataset(copied / "corrected.nc", "a") as nc:
        nc.renameVariable(lost, "LOST")
    places = [str(copied), str(runs / "new/M1")]
    status = main(["diff", *(places if side == "old" else places[::-1])])
    out, err = capsys.readouterr()
    assert (status == 1 and err.count("\n") == 1) if lost == "DECLINATION" else (status == 0 and out and not err)


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory) -> Path:
    """Run calibrations twice: one with changed iron, one unchanged, one refused, and one in the second run only."""
    folder = tmp_path_factory.mktemp("calibrated")
    for run, iron in (("old", MILD), ("new", (0.02, 0.2, 0.1, 0.03, -0.02))):
        made = {"bench": readings(coefficients=iron), "same": readings(seed=2), "few": readings(ring(3))}
        for name, seen in (made | ({"later": readings()} if run == "new" else {})).items():
            _calibrate(folder, run, name, seen)
    return folder


def _calibrate(folder: Path, run: str, name: str, seen: BenchReadings) -> None:
    there = folder / run / "calibrations" / name
    there.mkdir(parents=True)
    settings = earthfield.resolve_settings({"uncertainty": {}, "budget": None, "table_step_deg": 10.0})
    made = calibrations.calibrate("platform", [write_table(folder / "raw.csv", seen)], settings)
    files = {"calibration": there / "calibration.json", "table": there / "table.csv", "points": there / "points.csv"}
    calibration_files.write(page=result.to_json(name, made, settings), made=made, **files)


def test_diff_compares_calibrations(calibrated, capsys):
    """Hard iron along the bow increases by 0.05 of the field: B by 2.9 degrees, the deviation by 2.0 rms."""
    assert main(["diff", str(calibrated / "old"), str(calibrated / "new")]) == 1  # one is not in OLD
    head, *rows = capsys.readouterr().out.splitlines()
    assert head.startswith("calibration  deviation, rms  largest")
    told = dict(row.split(maxsplit=1) for row in rows)
    assert told["same"] == told["few"] == "nothing changed" and told["later"] == "not in OLD"
    rms, largest = (float(x) for x in re.findall(r"(\d+\.\d+)°", told["bench"])[:2])
    assert rms == pytest.approx(2.0, abs=0.2) and largest == pytest.approx(2.9, abs=0.3)
    assert re.search(r"B [+−]2\.\d", told["bench"])


def test_diff_of_one_calibration_reports_uncertainty_and_keys(calibrated, tmp_path, capsys):
    shutil.copytree(calibrated / "old/calibrations/same", tmp_path / "again")
    file = tmp_path / "again/calibration.json"
    known = json.loads(file.read_text())
    rewrite(file, uncertainty=known["uncertainty"] | {"expanded_deg": 9.0}, n=35)
    (tmp_path / "again/diagnosis.json").write_text(json.dumps(DIAGNOSED))
    assert main(["diff", str(calibrated / "old/calibrations/same"), str(tmp_path / "again")]) == 0
    row = capsys.readouterr().out.splitlines()[1]
    assert re.search(r"same +same +\d\.\d\d° → 9\.00° +none → consistent +same +same +n$", row)
    assert main(["diff", str(tmp_path / "again"), str(tmp_path / "again")]) == 0
    assert capsys.readouterr().out == "nothing changed: 1\N{NO-BREAK SPACE}calibration compared\n"
    (tmp_path / "again/table.csv").unlink()
    assert main(["diff", str(tmp_path / "again"), str(calibrated / "old/calibrations/same")]) == 1
    assert "OLD is incomplete: no table.csv" in capsys.readouterr().out


def test_diff_without_results_is_refused(runs, tmp_path, capsys):
    assert "found no results in it" in refused(capsys, "diff", str(runs / "old"), str(tmp_path))
    assert "found no such folder" in refused(capsys, "diff", str(tmp_path / "gone"), str(runs / "old"))


@pytest.mark.parametrize("content", ["", "{}", '{"verdict": '])
def test_diff_of_damaged_results_is_refused(runs, copied, capsys, content):
    (copied / "diagnosis.json").write_text(content)
    line = refused(capsys, "diff", str(runs / "old"), str(copied))
    assert "diagnosis.json" in line or f"and {copied}: expected results of this version" in line
    (copied / "corrected.nc").write_text(content)
    assert "corrected.nc" in refused(capsys, "diff", str(runs / "old"), str(copied))
