"""Would catch a redeployed compass's records analysed apart, against the truth, or stages re-run in vain."""

import csv
import json
import shutil
from pathlib import Path

import netCDF4
import numpy as np
import pytest
import yaml

from compasslib import angles
from compasslib.cli import main
from tests.world import chain, redeployed
from tests.world.launch import PROJECT, change, completed, keeps_contract, planned

EXAMPLE = PROJECT / "examples/redeployed"
OPTIONS = "{overlap: {grid_minutes: 360, max_metres: 60}, diagnose: {surrogates: 19}}"
SHORT = {"R1": "2007-12-10", "R2": "2009-01-13", "R4": "2011-03-24"}  # ends of deployments of a hundred days


@pytest.fixture(scope="module")
def done(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("redeployed")
    shutil.copytree(EXAMPLE / "config", folder / "config")
    (folder / "config/moorings/R3.yaml").unlink()
    (folder / "config/config.yaml").write_text(f"{OPTIONS}\n")
    for name, end in SHORT.items():
        change(folder / f"config/moorings/{name}.yaml", end=end)
    redeployed.write_cruise(folder, seed=2, hours=2400, every=6)
    return completed(folder, drawn=False)


def result(folder: Path, path: str):
    return json.loads((folder / "results" / path).read_text())


def test_mooring_without_reference_is_corrected(done):
    with (done / "truth/R4.csv").open() as stream:
        truth = np.array([float(row["heading_true_magnetic_deg"]) for row in csv.DictReader(stream)])
    with netCDF4.Dataset(done / "results/R4/corrected.nc") as nc:
        names = ("HEADING", "HEADING_CORRECTED", "HEADING_CORRECTED_UNCERTAINTY")
        recorded, corrected, sigma = (nc[name][:].filled(np.nan) for name in names)
    before, after = (angles.difference(x, truth[: len(x)]) for x in (recorded, corrected))
    assert np.isfinite(after).all() and angles.rms(after) < 0.6 * angles.rms(before)
    assert np.mean(np.abs(after) < 1.96 * sigma) > 0.9
    deviation = result(done, "R4/deviation.json")
    assert deviation["n_pairs"] == 0 and deviation["coefficients"] is not None
    assert deviation["shared"]["from"] == ["R1", "R2", "deck"]
    assert deviation["shared"]["text"].startswith("the compass is carried by R1, R2, deck of compass wh8104")


def test_compass_has_results_and_a_report_section(done, capsys):
    keeps_contract(done)
    assert main(["explain", "wh8104", "--cruise", str(done)]) == 0
    assert "of one compass: R1, R2" in capsys.readouterr().out
    compass = result(done, "compasses/wh8104/compass.json")
    assert [one["name"] for one in compass["deployments"]] == ["R1", "R2", "R4", "deck"]
    assert compass["rejected"] == [] and compass["sigma_between"] > 0.0
    assert (done / "results/compasses/wh8104/figures/coefficients.png").is_file()
    page = (done / "results/report.html").read_text()
    assert 'id="compass-wh8104"' in page and "compass is carried by R1, R2, deck" in page


def test_mooring_without_compass_key_is_independent(done, tmp_path):
    file = done / "config/moorings/R1.yaml"
    before, mooring = file.read_text(), yaml.safe_load(file.read_text())
    mooring["instruments"]["top"].pop("compass")
    file.write_text(yaml.safe_dump(mooring))
    made = chain.make(done, "R1", tmp_path / "R1")
    file.write_text(before)
    other, alone = json.loads((made / "deviation.json").read_text()), result(done, "R1/work/alone/deviation.json")
    assert other["shared"] is None and other == alone
    assert json.loads((made / "diagnosis.json").read_text()) == result(done, "R1/work/alone/diagnosis.json")
    assert result(done, "R1/deviation.json")["coefficients"] != alone["coefficients"]


def test_changed_record_reruns_only_its_compass(done):
    file = done / "config/moorings/R2.yaml"
    before = file.read_text()
    instruments = yaml.safe_load(before)["instruments"]
    instruments["top"]["sphere"] = True
    change(file, instruments=instruments)
    again = planned(done)
    file.write_text(before)
    after = {"diagnose_jointly", "correct", "grid", "figures", "sections"}
    assert {rule for rule, name in again if name == "R2"} == {"fit", "diagnose_alone", *after}
    for name in ("R1", "R4"):
        assert {rule for rule, of in again if of == name} == after
    assert not [rule for rule, of in again if of == "deck"]
    assert {rule for rule, of in again if of not in ("R1", "R2", "R4")} == {
        *("combine_records", "joined_figures", "summary", "cruise_figures", "report", "provenance")
    }
