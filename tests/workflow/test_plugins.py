"""Would catch a package as in docs/howto/plugins.md that does not work, takes a name in use, or stops a run."""

import importlib
import json
import re
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
import yaml

from compasslib import plugins, readers
from compasslib.config import cruise as config
from compasslib.effects import CATALOGUE, all_effects, meanings, side_of
from compasslib.errors import InputError
from tests.world.launch import PROJECT, change, jobs_in, snakemake
from tests.world.sea import cruise

PAGE = (PROJECT / "docs/howto/plugins.md").read_text()


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


def as_tiltmeter(folder: Path) -> None:
    """Rewrite the table of a mooring's reference instrument in the format of the plug-in."""
    table = np.genfromtxt(folder / "raw/M1/deep.csv", delimiter=",", names=True, dtype=None, encoding="ascii")
    east, north = table["u_cm_s"], table["v_cm_s"]
    speed, towards = np.hypot(east, north), np.degrees(np.arctan2(east, north)) % 360.0
    rows = [f"{t[:19]};{s:.3f};{d:.3f};4.5" for t, s, d in zip(table["time_utc"], speed, towards, strict=True)]
    (folder / "raw/M1/deep.txt").write_text("\n".join(rows) + "\n")
    path = folder / "config/moorings/M1.yaml"
    instruments = yaml.safe_load(path.read_text())["instruments"]
    change(path, instruments=instruments | yaml.safe_load(blocks("yaml")[0])["instruments"])


def declare(folder: Path, points: dict[str, dict[str, str]], package: str = "tiltmeter") -> Path:
    """Write the module of the page and the metadata of its package into a folder, as an installation does."""
    there = folder / f"{package}-0.1.dist-info"
    there.mkdir(parents=True)
    (there / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 0.1\n")
    lines = [line for group, values in points.items() for line in (f"[{group}]", *map(" = ".join, values.items()))]
    (there / "entry_points.txt").write_text("\n".join(lines))
    (folder / "tiltmeter.py").write_text("\n".join(blocks("python")))
    return folder


def test_documented_package_runs_a_mooring(tmp_path):
    folder = cruise(tmp_path / "cruise", n=200)
    (folder / "config/config.yaml").write_text("diagnose: {enabled: false}\n")
    as_tiltmeter(folder)
    with pytest.raises(InputError, match=r"expected pd0, table, .* or nortek, found 'tiltmeter'"):
        config.load_cruise(folder)
    project = tomllib.loads(blocks("toml")[0])["project"]
    assert (project["name"], project["version"]) == ("tiltmeter", "0.1")
    there, results = declare(tmp_path / "site", project["entry-points"]), folder / "results"
    beside = f"import sys; sys.path.append({str(there)!r})\n"
    ran = snakemake(folder, first=beside, drawn=False)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    pairs = json.loads((results / "M1/deviation.json").read_text())["n_pairs"]
    assert pairs > 150
    entities = json.loads((results / "ro-crate-metadata.json").read_text())["@graph"]
    assert [one["softwareVersion"] for one in entities if one.get("name") == "tiltmeter"] == ["0.1"]
    page = (results / "report.html").read_text()
    assert "with tiltmeter 0.1" in page and "Read by tiltmeter 0.1" in page

    with (there / "tiltmeter.py").open("a") as module:
        module.write("# another way of reading\n")
    said = snakemake(folder, "--dry-run", "--quiet", "progress", first=beside).stdout
    assert ("read", "M1") in jobs_in(said) and "now: 'library=" in said


def installed(folder: Path, monkeypatch, group: str, name: str, value: str, package: str = "tiltmeter") -> None:
    """Put a package with one plug-in on the import path of this process."""
    monkeypatch.syspath_prepend(str(declare(folder, {group: {name: value}}, package)))
    for known in (plugins.declared_plugins, all_effects):
        known.cache_clear()


@pytest.fixture(autouse=True)
def _forget():
    yield
    sys.modules.pop("tiltmeter", None)
    for known in (plugins.declared_plugins, all_effects):
        known.cache_clear()


@pytest.mark.parametrize(
    ("group", "name", "value", "words"),
    [
        (plugins.READERS, "pd0", "tiltmeter:read", "expected a name that compasslib does not use, found 'pd0'"),
        (plugins.EFFECTS, "other", "tiltmeter:ClampCreep", "expected an Effect whose name is 'other', found <class"),
        (plugins.EFFECTS, "clamp_creep", "tiltmeter:absent", "expected an importable plug-in, found AttributeError"),
    ],
)
def test_name_conflicts_and_invalid_plugins_are_refused(tmp_path, monkeypatch, group, name, value, words):
    installed(tmp_path, monkeypatch, group, name, value)
    with pytest.raises(InputError) as caught:
        readers.format_names() if group == plugins.READERS else all_effects()
    assert str(caught.value).startswith("tiltmeter 0.1: ") and words in str(caught.value)


@pytest.mark.parametrize("error", ["SystemExit(0)", "ValueError('bad')"])
def test_any_exception_of_a_plugin_is_reported_in_one_line(tmp_path, monkeypatch, error):
    installed(tmp_path, monkeypatch, plugins.READERS, "tiltmeter", "tiltmeter:read")
    (tmp_path / "tiltmeter.py").write_text(f"def read(paths):\n    raise {error}\n")
    with pytest.raises(InputError, match=r"^tiltmeter 0\.1: tiltmeter:read: expected a Record, found .*line 2\); mend"):
        readers.read("tiltmeter", [tmp_path / "deep.txt"], {})
    sys.modules.pop("tiltmeter")
    (tmp_path / "tiltmeter.py").write_text(f"raise {error}\n")
    importlib.invalidate_caches()
    with pytest.raises(InputError, match=r"^tiltmeter 0\.1: .* expected an importable plug-in, found .*line 1\); mend"):
        readers.get_format("tiltmeter")


def test_two_packages_cannot_share_a_name(tmp_path, monkeypatch):
    for package in ("tiltmeter", "other"):
        installed(tmp_path / package, monkeypatch, plugins.READERS, "tiltmeter", "tiltmeter:read", package)
    with pytest.raises(InputError, match=r"expected a name that other 0\.1 does not use, found 'tiltmeter'"):
        readers.format_names()


def test_effect_of_a_plugin_is_appended_to_the_catalogue(tmp_path, monkeypatch):
    assert all_effects() == CATALOGUE
    installed(tmp_path, monkeypatch, plugins.EFFECTS, "clamp_creep", "tiltmeter:ClampCreep")
    *own, creep = all_effects()
    assert tuple(own) == CATALOGUE and creep.name == "clamp_creep"
    assert side_of("clamp_creep") == "compass"
    assert meanings("clamp_creep") == {"deg_root_year": "turn in the first year"}


def test_plugin_reader_takes_keyword_keys_and_returns_a_record(tmp_path, monkeypatch):
    installed(tmp_path, monkeypatch, plugins.READERS, "tiltmeter", "tiltmeter:read")
    found = readers.get_format("tiltmeter")
    assert found.keys == ("orientation",) and not found.takes_declination
    assert re.fullmatch(r"tiltmeter 0\.1 \(tiltmeter, sha256 [0-9a-f]{12}\)", found.plugin)
    (tmp_path / "deep.txt").write_text("2007-09-04T00:00:00;12.3;90;4.5\n")
    record = readers.read("tiltmeter", [tmp_path / "deep.txt"], {"orientation": "up", "columns": None})
    assert record.east[0, 0] == pytest.approx(0.123) and record.looks_up
    assert record.warnings == (f"Read by {found.plugin}.",)
    sys.modules["tiltmeter"].read = lambda paths: {}
    with pytest.raises(InputError, match="expected a Record, found dict"):
        readers.read("tiltmeter", [tmp_path / "deep.txt"], {})
