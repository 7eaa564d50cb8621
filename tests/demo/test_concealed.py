"""Would catch a truth that the analysis can read, or a page that compares findings with the wrong causes."""

import json
import re
import shutil
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from compasslib.archive import crate, netcdf
from compasslib.archive.files import write_json
from compasslib.demo import concealed
from compasslib.report.words import TEMPLATES
from compasslib.stages import Files
from compasslib.stages import demonstration as real
from compasslib.stages.demonstration import HeadingErrors, describe, named_level
from compasslib.stages.demonstration import concealed as set_beside
from tests.world.launch import PROJECT, completed, snakemake
from tests.world.sea import cruise


def test_only_the_page_reads_the_truth_and_no_manifest_lists_it(tmp_path):
    """By the inputs of all jobs for a corrected record, of either kind of simulation, and for the page."""
    shutil.copytree(PROJECT / "config", tmp_path / "config")
    targets = ("results/C1/corrected.nc", "results/EG1/corrected.nc", "results/concealed.html")
    inputs = re.findall(r"rule (\w+):\n +input: (.*)", snakemake(tmp_path, "--dry-run", *targets).stdout)
    assert {"read", "overlap", "fit", "diagnose", "correct"} < {rule for rule, _ in inputs}
    assert {rule for rule, files in inputs if re.search(r"\b(concealed|truth)/", files)} == {"concealed"}
    record = tmp_path / "results/C1/logs/simulate.json"
    write_json(record, {"read": {}, "wrote": {"raw/C1/top.000": "0", "concealed/C1.json": "1"}})
    (made,) = crate.read_jobs([record]).values()
    assert made["wrote"] == {"raw/C1/top.000": "0"}


def told(folder: Path, name: str) -> dict:
    return json.loads((folder / f"{name}.json").read_text())


@pytest.fixture(scope="module")
def written(tmp_path_factory) -> Path:
    """Write every case by one seed, and one of them by another too."""
    folder = tmp_path_factory.mktemp("written")
    for name, seed in (*((name, 1) for name in concealed.CASES), ("C4", 2)):
        concealed.write_mooring(name, folder / f"{seed}/raw", folder / f"{seed}/{name}.json", seed)
    return folder


def test_causes_have_the_stated_sizes(written):
    truths = {name: told(written / "1", name) for name in concealed.CASES}
    assert {name: len(truth["planted"]) for name, truth in truths.items()} == {"C1": 2, "C2": 1, "C3": 1, "C4": 0}
    start, end = (np.datetime64(text).astype("datetime64[s]").astype(float) for text in ("2014-08-01", "2014-12-04"))
    for truth in truths.values():
        assert all(3.5 < cause["z"] < 15.5 for cause in truth["planted"])
        assert start <= truth["time_s"][0] < truth["time_s"][-1] <= end  # as in config/moorings


def test_moorings_depend_on_the_seed(written):
    assert told(written / "1", "C4")["heading_deg"] != told(written / "2", "C4")["heading_deg"]
    first, second = ((written / f"{seed}/raw/C4/top.000").read_bytes() for seed in (1, 2))
    assert first != second


def test_signal_to_noise_is_that_of_generalized_least_squares():
    """Against the exact covariance of white and slow noise; of a slow cause the ratio is an upper limit."""
    rng, hours = np.random.default_rng(5), np.arange(2000.0)
    speed, heading = 0.2 + 0.05 * rng.random(2000), rng.uniform(0.0, 360.0, 2000)
    covariance = 0.02**2 * (np.eye(2000) + np.exp(-np.abs(hours[:, None] - hours) / 120.0))
    root, fitted = np.linalg.cholesky(covariance), concealed.waves(heading)
    noises = [root @ rng.normal(size=2000) for _ in range(10)]
    for turn, least, most in ((np.sin(np.deg2rad(3.0 * heading)), 0.95, 1.05), (hours > 800.0, 1.0, 2.0)):
        exact = concealed.beyond(np.linalg.solve(root, speed[:, None] * np.column_stack([turn, fitted])))
        found = [concealed.signal_to_noise(speed, heading, turn, noise) for noise in noises]
        assert least < np.mean(found) / np.linalg.norm(exact) < most


def test_what_is_named_of_a_cause_and_what_has_no_cause():
    cause = {"driver": "tilt", "effect": "heeling"}
    stated = {"side": "compass", "level": "effect", "effect": "heeling", "driver": "tilt"}
    assert named_level(cause, [stated | {"level": "side"}]) == ""
    assert named_level(cause, [stated | {"level": "driver", "driver": "pitch"}]) == "driver"
    assert named_level(cause, [stated | {"effect": "moving_iron"}, stated]) == "effect"
    assert (
        named_level(cause | {"effect": ""}, [stated]) == "driver"
    )  # a listed effect is not the one that is not listed


def test_the_pages_quote_the_sealed_proof():
    """Of corrections by ambiguous effects, which are justified by it, and of all."""
    (card,) = (PROJECT / "docs/proof").glob("seed-*/scorecard.json")
    every = json.loads(card.read_text())["moorings"]
    rows = [row for row in every if row["verdict"] == "ambiguous" and "compass" in row["found_sides"]]
    (better, worse, sizes), (all_better, all_worse, all_sizes) = map(changed, (rows, every))
    page, concealed, proof = (
        " ".join(file.read_text().split())
        for file in (
            TEMPLATES / "concealed.html",
            *map((PROJECT / "docs/background").joinpath, ("concealed.md", "proof.md")),
        )
    )
    said = f"by more than 0.1° and raised {worse} by as much"
    assert f"of {better} of {len(rows)} moorings {said}; together they fell from {sizes}" in page
    assert f"of {len(rows)} ambiguous moorings" in concealed and f"the errors of {better} {said}" in concealed
    assert f"improves {all_better} by over 0.1° and worsens {all_worse}; errors fall from {all_sizes[:4]}" in proof


def changed(rows):
    """Count the moorings with smaller and larger errors, and compose the rms of both."""
    before, after = (np.array([row[key] for row in rows]) for key in ("before_deg", "after_deg"))
    sizes = (f"{np.sqrt(np.mean(error**2)):.1f}°" for error in (before, after))
    return np.sum(after < before - 0.1), np.sum(after > before + 0.1), " to ".join(sizes)


@pytest.mark.parametrize(("scatter", "understated"), [(1.0, False), (2.0, True)])
def test_coverage_reveals_an_understated_uncertainty(scatter, understated):
    error = scatter * np.random.default_rng(3).normal(size=3000)
    errors = HeadingErrors(3600.0 * np.arange(3000.0), error, error, error, np.ones(3000))
    share, low, high = errors.coverage
    assert low < share < high and errors.understated == understated


@pytest.fixture(scope="module")
def processed(tmp_path_factory):
    """Results of a mooring, and a truth from which its corrected headings differ by 2, later by -2 degrees."""
    folder = cruise(tmp_path_factory.mktemp("cruise"), ("C1",), n=400)
    made = folder / "results/C1"
    completed(folder, "results/C1/work/pictures.json", drawn=False)
    product = netcdf.read_corrected(made / "corrected.nc", velocities=False)
    off = np.where(np.arange(400) < 200, 2.0, -2.0)
    planted = {"what": "a <planted> change", "driver": "time", "effect": "hard_iron_step", "z": 7.0}
    planted |= {"date": "2007-09-10T00:00:00", "size_deg": 2.0}
    planted |= {"field": {"forward": 12, "starboard": -3, "down": 4, "unit": "nT"}}
    truth = {
        "mooring": "C1", "title": "a case", "seed": 7, "undecidable": "", "planted": [planted],
        "time_s": product.record.time_s.tolist(),
        "heading_deg": [None, *(product.heading_corrected_deg - off)[1:].tolist()],
    }  # fmt: skip
    (folder / "concealed").mkdir()
    (folder / "concealed/C1.json").write_text(json.dumps(truth))
    return SimpleNamespace(folder=folder, sigma_deg=product.heading_uncertainty_deg[1:])


def test_the_page_compares_findings_with_planted_causes(processed):
    page, lines = processed.folder / "results/concealed.html", []
    said = page.parent / "C1/diagnosis.json"
    current = {"level": "side", "probability": 0.99, "driver": None, "size": 1.0, "unit": "m/s", "text": "It differs."}
    write_json(said, told(said.parent, said.stem) | {"current": [current]})
    truths = [str(processed.folder / f"concealed/{name}.json") for name in ("C1", "C2")]
    made = page.parent / "recordings.json"
    (refused,) = (one for one in real.RECORDINGS if one.name == "eight_headings")
    write_json(made, {"recordings": [describe(refused, refused.diagnose())]})
    corrected = [str(page.parent / "C1/corrected.nc")]
    set_beside(Files(page=str(page), truths=truths, corrected=corrected, recordings=str(made)), lines.append)
    text = page.read_text()
    assert "a &lt;planted&gt; change" in text and "<planted>" not in text and "on 2007-09-10 at 00:00" in text
    assert "Its field: forward 12, starboard −3, down 4 nT." in text
    assert "<strong>Not identified.</strong>" in text  # there is no finding
    levels = [int(level) for level in re.findall(r"<h(\d)", text)]
    assert all(below - above <= 1 for above, below in pairwise(levels))
    assert "2.0° (2.0–2.0)" in text  # the corrected headings' rms, with its interval
    within = f"{100 * np.mean(processed.sigma_deg * 1.959964 >= 2.0):.0f} %"
    assert within in text and text.count("data:image/png") == 3 and lines[0].endswith("1 moorings beside the truth")
