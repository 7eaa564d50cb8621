"""Would catch code, YAML, links, commands or numbers of a page that do not work, and a site that does not build."""

import csv
import doctest
import importlib
import importlib.util
import json
import os
import re
import shlex
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image

import compasslib
from compasslib import angles
from compasslib.cli import _parser
from compasslib.config.cruise import load_cruise
from tests.world.launch import UNDRAWN, compass, copied_project
from tests.world.products import make_product, write
from tests.world.sea import cruise

PROJECT = Path(__file__).resolve().parents[2]
NAMES = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "paper.md", "config/README.md", "tests/README.md")
SITE = sorted((PROJECT / "docs").rglob("*.md"))
PAGES = [PROJECT / name for name in NAMES] + [page for page in SITE if page.parent.parent.name != "proof"]
LIBRARY, TUTORIAL = PROJECT / "docs/howto/library.md", PROJECT / "docs/tutorial.md"
WITH_YAML = [PROJECT / "README.md", *sorted((PROJECT / "docs/howto").glob("*.md"))]


def python(*words: object, **options: object) -> str:
    """Run Python in a process of its own, check that it succeeds, and return what it prints."""
    ran = subprocess.run([sys.executable, *map(str, words)], capture_output=True, text=True, check=False, **options)
    assert ran.returncode == 0, ran.stderr
    return ran.stdout


def blocks(page: Path, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL)


def test_library_page_runs_and_corrects_a_record(tmp_path):
    """In a separate process; errors of 24 degrees rms fall below a fifth, and below three stated standard errors."""
    check = (
        "np.savez('seen.npz', time=product.record.time_s, heading=product.heading_corrected_deg,"
        " sigma=product.heading_uncertainty_deg, t=truth.time_s, true=truth.heading_deg, read=truth.recorded_deg,"
        " again=corrected.heading_corrected_deg, weak=cl.compass.inverse(weak, recorded))"
    )
    said = python("-c", "\n".join([*blocks(LIBRARY, "python"), check]), cwd=tmp_path)
    seen = np.load(tmp_path / "seen.npz")
    np.testing.assert_allclose(seen["time"], seen["t"], atol=1.0)  # the file has hundredths of seconds
    before, after = (angles.difference(seen[name], seen["true"]) for name in ("read", "heading"))
    rms = [float(np.sqrt(np.nanmean(error**2))) for error in (before, after)]
    assert rms[0] == pytest.approx(24.4, abs=0.1)  # the number on the page is that of this mooring
    assert rms[1] < 3.0 * np.nanmedian(seen["sigma"]) and rms[1] < 0.2 * rms[0]
    assert np.nanmax(np.abs(before)) == pytest.approx(33.0, abs=0.5)
    np.testing.assert_allclose(np.sort(seen["weak"])[:, 0], [10.0, 100.0, 190.0, 280.0], atol=1e-9)
    assert "bench.csv" in said.splitlines()[-1]


def test_notebook_runs_and_states_the_transport_uncertainty(tmp_path):
    made = compasslib.process_mooring(cruise(tmp_path / "c", ("EG4",), n=300), "EG4", tmp_path / "made")
    (tmp_path / "results").mkdir()
    made.rename(tmp_path / "results/EG4")
    page = json.loads((PROJECT / "examples/currents.ipynb").read_text())
    code = "\n".join("".join(cell["source"]) for cell in page["cells"] if cell["cell_type"] == "code")
    assert not any(cell.get("outputs") for cell in page["cells"])
    said = python("-c", code, cwd=tmp_path, env=os.environ | {"MPLBACKEND": "agg"})
    along, joined, alone = map(float, re.findall(r"(-?[0-9.]+) ± ([0-9.]+) m³/s \(95 %\); ± ([0-9.]+)", said)[0])
    assert abs(along) > joined > alone > 0.0  # a heading error is common to all cells of a time


@pytest.mark.parametrize("room", ["", *sorted(path.parent.name for path in PROJECT.glob("compasslib/*/__init__.py"))])
def test_each_subpackage_has_a_worked_example(room, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    ran = doctest.testmod(importlib.import_module(f"compasslib.{room}".rstrip(".")), verbose=False)
    assert ran.attempted > 1 and not ran.failed


def test_public_names_are_documented_and_imported_lazily():
    page = LIBRARY.read_text()
    for name in compasslib.__all__:
        assert getattr(compasslib, name).__doc__, name
        assert f"`{name}`" in page, f"{name} is public and not on {LIBRARY.name}"
    python("-c", "import sys, compasslib; dir(compasslib); sys.exit('numpy' in sys.modules)")


@pytest.mark.parametrize(
    "paper", sorted((PROJECT / "docs/background/papers").glob("*.csv")), ids=lambda path: path.stem
)
def test_results_of_a_paper_are_held_by_existing_tests(paper):
    with paper.open(encoding="utf-8", newline="") as file:
        held = [row["test"] for row in csv.DictReader(file) if row["test"]]
    assert len(held) > 10
    for path, _, name in (test.partition("::") for test in held):
        assert f"def {name}(" in (PROJECT / "tests" / path).read_text(), (path, name)


def test_citation_files_agree_in_version_and_authors():
    cited, meta = (yaml.safe_load((PROJECT / name).read_text()) for name in ("CITATION.cff", "codemeta.json"))
    assert cited["version"] == meta["version"] == compasslib.__version__
    assert [one["name"] for one in cited["authors"]] == [one["name"] for one in meta["author"]]
    head = yaml.safe_load((PROJECT / "paper.md").read_text().split("---")[1])
    assert [one["name"] for one in head["authors"]] == [one["name"] for one in cited["authors"]]
    newest = re.search(r"^## (\S+)", (PROJECT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert newest and newest[1] == compasslib.__version__


def test_conda_environment_matches_the_project_requirements():
    project = tomllib.loads((PROJECT / "pyproject.toml").read_text())["project"]
    wanted = {*project["dependencies"], *project["optional-dependencies"]["workflow"]}
    *listed, pip = yaml.safe_load((PROJECT / "environment.yaml").read_text())["dependencies"]
    other = {"matplotlib-base": "matplotlib", "snakemake-minimal": "snakemake"}  # conda's names
    entries = {re.sub(r"^[\w-]+", lambda m: other.get(m[0], m[0]), line).lower() for line in (*listed, *pip["pip"])}
    assert entries - {"pip", ".", f"python{project['requires-python']}"} == {line.lower() for line in wanted}


@pytest.mark.parametrize("page", WITH_YAML, ids=lambda page: page.stem)
def test_yaml_of_a_page_is_valid(page, tmp_path):
    """Blocks that are whole files load without error, together with empty raw files."""
    wrote = {}
    for block in blocks(page, "yaml"):
        keys = yaml.safe_load(block)
        if "kind" in keys:
            wrote["config/calibrations/aqd.yaml"] = block
            wrote["config/calibrations/before.yaml"] = re.sub(r"^compare_with.*", "", block, flags=re.MULTILINE)
        elif "name" in keys:
            wrote[f"config/moorings/{keys['name']}.yaml"] = block
    raw = re.findall(r"raw/[\w/.*-]+", " ".join(wrote.values()))
    options = {
        "config/config.yaml": "moorings: config/moorings\n" if "config/moorings" in str(wrote) else "moorings: []\n"
    }
    for name, text in (options | wrote | {path.replace("*", "any"): "" for path in raw}).items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    cruise = load_cruise(tmp_path)
    assert len(cruise.moorings) + len(cruise.calibrations) == len(wrote)


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as formed by GitHub and the site."""
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    plain = (re.sub(r"[^\w\- ]", "", heading.lower()) for heading in re.findall(r"^#+ (.*)$", text, re.MULTILINE))
    return {heading.strip().replace(" ", "-") for heading in plain}


def of_included(page: Path) -> Path:
    """Return the file that a page includes, or else the page itself."""
    shown = re.match(r"```{include} (\S+)", page.read_text()) if page.suffix == ".md" else None
    return (page.parent / shown[1]).resolve() if shown else page


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(PROJECT)))
def test_links_lead_to_existing_files_and_headings(page):
    text = re.sub(r"^```(?!{).*?^```", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    for target in re.findall(r"\]\((?!https?://)([^)\s]+)\)", text):
        path, _, anchor = target.partition("#")
        led = of_included((page.parent / path).resolve()) if path else page
        assert led.exists(), target
        assert not anchor or anchor in anchors(led), target


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    """Build the site as ``make docs`` does; a broken internal link is a warning, which fails the build."""
    if any(importlib.util.find_spec(name) is None for name in ("sphinx", "furo", "myst_parser")):
        pytest.skip("no Sphinx: make docs installs it")
    folder = tmp_path_factory.mktemp("site")
    python("-m", "sphinx", "--fail-on-warning", "--quiet", PROJECT / "docs", folder)
    return folder


def test_site_loads_nothing_external_and_shows_docstrings(site):
    pages = sorted(site.rglob("*.html"))
    assert len(pages) >= len(SITE)
    for page in pages:
        text = page.read_text()
        loaded = re.findall(r"<(?:script|img|iframe)[^>]*\bsrc=\"([^\"]*)|<link[^>]*\bhref=\"([^\"]*)", text)
        assert not [one for pair in loaded for one in pair if re.match(r"\w+:|//", one)], page
    for sheet in site.rglob("*.css"):
        assert not re.search(r"@import|url\([\"']?(?:https?:)?//", sheet.read_text()), sheet
    assert not [page for page in pages if 'class="xref myst"' in page.read_text()]  # unresolved links
    assert "compasslib.deviation.fit_deviation" in (site / "reference/modules.html").read_text()
    assert "water_depth" in (site / "reference/keys.html").read_text()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(PROJECT)))
def test_commands_that_a_page_names_exist(page):
    text = page.read_text()
    targets = set(re.findall(r"^([a-z]+):", (PROJECT / "Makefile").read_text(), re.MULTILINE))
    assert set(re.findall(r"(?:`|^    )make ([a-z]+)", text, re.MULTILINE)) <= targets
    commands = {"init", "run", "check", "correct", "explain", "export", "diff", "verify"}
    assert set(re.findall(r"`compass ([a-z]+)`", text)) <= commands
    for words in re.findall(r"^(?:    (?:\.venv/bin/)?|\$ )compass ([^\n#]*)", text, re.MULTILINE):
        _parser().parse_args(shlex.split(words.partition(" -- ")[0]))  # options of Snakemake follow
    for script in re.findall(r"\b(?:benchmarks|tests|examples|compasslib|workflow)/[\w/]*\w\.py\b", text):
        assert "NAME" in script or (PROJECT / script).exists() or (PROJECT / "tests" / script).exists(), script


@pytest.fixture(scope="module")
def installed(tmp_path_factory) -> Path:
    """Build the wheel as ``pip install .`` does, from a copy, as setuptools leaves files behind, and unpack it."""
    if importlib.util.find_spec("setuptools") is None:
        pytest.skip("no setuptools: the wheel cannot be built")
    source, target = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("installed")
    files = "pyproject.toml", "setup.py", "README.md", "LICENSE", "docs/glossary.md"
    copied_project(source, "compasslib", "workflow", "requirements", *files)
    build = "from setuptools.build_meta import build_wheel; print(build_wheel('.'))"
    with zipfile.ZipFile(source / python("-c", build, cwd=source).split()[-1]) as wheel:
        wheel.extractall(target)
    return target


def test_tutorial_commands_print_what_the_page_shows(tmp_path):
    """From raw files to an archive, without figures; ``...`` matches anything, as in a doctest."""
    (tmp_path / "python").write_text(f'#!/bin/sh\nexec "{sys.executable}" "$@"\n')
    (tmp_path / "python").chmod(0o755)
    place = os.environ | {"PATH": f"{tmp_path}:{os.environ['PATH']}", "PYTHONPATH": f"{PROJECT}"}
    steps = re.findall(r"^\$ (.*\n(?:> .*\n)*)((?:(?!\$ ).*\n)*)", "".join(blocks(TUTORIAL, "console")), re.MULTILINE)
    assert len(steps) > 12
    for command, shown in steps:
        if command.startswith("compass "):
            ran = compass(tmp_path, *shlex.split(command)[1:], first=UNDRAWN, merged=True)
        else:
            script = ["bash", "-c", re.sub(r"^> ", "", command, flags=re.MULTILINE)]
            ran = subprocess.run(script, cwd=tmp_path, env=place, text=True, check=False, capture_output=True)
        lines = (re.escape(line).replace(r"\.\.\.", ".*") for line in shown.splitlines())
        expected = "".join(r"(?:.*\n)*?" if line == ".*" else f"{line}\n" for line in lines)
        said = re.sub("[\u00a0\u202f]", " ", ran.stdout)  # the page has plain instead of non-breaking spaces
        assert ran.returncode == 0 and re.fullmatch(expected, said), f"$ {command}{said}{ran.stderr}"


def test_wheel_alone_runs_the_workflow(installed, tmp_path):
    code, folder = "import sys; from compasslib.cli import main; sys.exit(main())", cruise(tmp_path / "c", n=50)
    words = "run", folder, "--", "results/M1/work/top.nc"
    python("-P", "-c", code, *words, cwd=tmp_path, env=os.environ | {"PYTHONPATH": f"{installed}"})
    assert (folder / "results/M1/work/top.nc").is_file()


def test_wheel_contains_every_file_of_the_package(installed):
    kept = {path.relative_to(PROJECT) for path in (PROJECT / "compasslib").rglob("*") if path.is_file()}
    kept = {path for path in kept if "__pycache__" not in path.parts}
    packed = {path.relative_to(installed) for path in (installed / "compasslib").rglob("*") if path.is_file()}
    packed = {path for path in packed if "__pycache__" not in path.parts}  # of the commands run before
    assert kept == {path for path in packed if path.parts[1] != "workflow"}
    assert {Path("compasslib/workflow", name) for name in ("Snakefile", "docs/glossary.md")} <= packed


def test_wheel_declares_the_command_and_the_licence(installed):
    (described,) = installed.glob("compasslib-*.dist-info")
    assert "compass = compasslib.cli:main" in (described / "entry_points.txt").read_text()
    assert "License-Expression: MIT" in (described / "METADATA").read_text()
    assert (described / "licenses/LICENSE").read_text() == (PROJECT / "LICENSE").read_text()


GREY, GREEN = (153, 153, 153), (44, 160, 44)  # colours of recorded and corrected sticks


def test_example_draws_recorded_and_corrected_currents(tmp_path):
    record = write(tmp_path / "corrected.nc", make_product(1500, 6))
    words = "-W", "error", PROJECT / "examples/plot_corrected.py", record, tmp_path / "figure.png"
    assert "Currents of mooring EG4, corrected" in python(*words, env=os.environ | {"MPLBACKEND": "Agg"})
    with Image.open(tmp_path / "figure.png") as drawn:
        pixels = np.asarray(drawn.convert("RGB"))
    for colour in (GREY, GREEN):
        assert (pixels == colour).all(axis=2).sum() > 100, colour
