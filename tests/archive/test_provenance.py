"""Would catch a manifest that misses a file or its origin, changed files not told, results cleared by mistake."""

import json
import os
import re
import shutil
import subprocess
import sys
import zipfile
from contextlib import redirect_stderr, redirect_stdout
from datetime import UTC, datetime
from io import BytesIO, TextIOWrapper
from pathlib import Path
from urllib.parse import unquote

import netCDF4
import pytest
import yaml

from compasslib import __version__
from compasslib.archive import crate, deposit, provenance
from compasslib.cli import main
from compasslib.config import cruise as config
from compasslib.config import schema, values
from compasslib.errors import InputError
from compasslib.pipeline.process import process_mooring
from compasslib.stages import settings
from tests.world.bench import readings, write_calibration
from tests.world.launch import PROJECT, change, completed, copied_project
from tests.world.sea import cruise

SAMPLES = 120
INPUTS = {"config/config.yaml", "config/moorings/M1.yaml", "raw/M1/top.000", "raw/M1/deep.csv"}


@pytest.fixture(scope="module")
def processed(tmp_path_factory):
    """Process a cruise of one mooring with a non-ASCII project name."""
    folder = cruise(tmp_path_factory.mktemp("cruise"), ("M1",), n=SAMPLES)
    (folder / "config/config.yaml").write_text(
        "diagnose: {enabled: false}\nattributes: {project: Größe, institution: Sea, principal_investigator: A. Fram,"
        " license: CC-BY-4.0, publisher_url: https://example.org/, doi: 10.1/x}\n"
    )
    return completed(folder, drawn=False)


@pytest.fixture
def archive(processed, tmp_path):
    return Path(shutil.copytree(processed, tmp_path / "archive"))


def page_of(folder: Path) -> dict:
    return json.loads((folder / crate.FILE).read_text())


def flip(path: Path) -> None:
    """Change one bit of a file and restore the times of access and modification."""
    before = path.stat()
    content = bytearray(path.read_bytes())
    content[5000 % len(content)] ^= 1
    with path.open("r+b") as stream:
        stream.write(content)
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))


def of_type(page: dict, kind: str) -> list[dict]:
    return [entity for entity in page["@graph"] if entity["@type"] == kind]


def ids(reference: object) -> list[str]:
    """Return the identifiers of one reference or a list of them."""
    return [one["@id"] for one in (reference if isinstance(reference, list) else [reference])]


# --------------------------------------------------------------------------------------------------------- the deposit
@pytest.fixture(scope="module")
def unpacked(processed, tmp_path_factory):
    """Deposit the cruise as a ZIP file and unpack it elsewhere."""
    into = tmp_path_factory.mktemp("deposit")
    count = deposit.deposit(config.load_cruise(processed), into / "c.zip")
    with zipfile.ZipFile(into / "c.zip") as packed:
        assert packed.testzip() is None and len(packed.namelist()) == count
        packed.extractall(into / "there")
    return into / "there"


def test_diff_lists_changes_since_the_deposit(unpacked, archive, capsys):
    deposited = str(unpacked.parent / "c.zip")
    assert main(["diff", deposited, str(archive)]) == 0
    assert capsys.readouterr().out.startswith("nothing changed: ")
    with netCDF4.Dataset(archive / "results/M1/corrected.nc", "a") as nc:
        nc["DECLINATION"][:] = nc["DECLINATION"][:] + 1.0
    record = archive / "results/M1/logs/read_deep.json"
    record.write_text(record.read_text().replace('raw/M1/deep.csv": "', 'raw/M1/deep.csv": "f'))
    assert main(["diff", deposited, str(archive)]) == 0
    assert "DECLINATION" in (said := capsys.readouterr().out) and "deep: raw/M1/deep.csv changed" in said
    with zipfile.ZipFile(deposited) as packed:
        at = packed.getinfo("results/M1/corrected.nc").header_offset + 1000
    whole = Path(deposited).read_bytes()
    (archive / "cut.zip").write_bytes(whole[:at] + b"junk" + whole[at + 4 :])
    assert main(["diff", str(archive / "cut.zip"), str(archive)]) == 1
    assert "cut.zip: expected the ZIP of compass export --to rocrate" in capsys.readouterr().err


def test_product_states_changes_since_the_superseded_deposit(unpacked, archive):
    """In history and product_version of each product; a file that is no deposit is refused before processing."""
    shutil.copy(unpacked.parent / "c.zip", archive / "v1.zip")
    instruments = yaml.safe_load((archive / "config/moorings/M1.yaml").read_text())["instruments"]
    instruments["top"]["exclude"] = [{"from": "2007-09-05", "to": "2007-09-06"}]
    change(archive / "config/moorings/M1.yaml", water_depth=890, instruments=instruments)
    with open(archive / "raw/M1/deep.csv", "a") as stream:
        stream.write("\n")
    options = (archive / "config/config.yaml").read_text()
    (archive / "config/config.yaml").write_text(f"{options}supersedes: v1.zip\n")
    made = process_mooring(archive, "M1", archive / "again")
    window = '[{"from": "2007-09-05", "to": "2007-09-06"}]'
    changes = f"water_depth was 894, is 890; instruments.top.exclude was absent, is {window}"
    changes = f"since v1.zip: {changes}; raw/M1/deep.csv changed"
    for name in ("corrected.nc", "gridded.nc"):
        with netCDF4.Dataset(made / name) as nc:
            assert nc.product_version == f"{provenance.software()}; {changes}"
            assert f": {changes} (manifest sha256 {provenance.sha256(archive / crate.FILE)})" in nc.history
    described = settings.Moorings(config.load_cruise(archive)).superseded("M1")
    (archive / "v1.zip").write_bytes(deposit.excerpt(archive / "v1.zip"))  # as the later deposit holds it
    assert settings.Moorings(config.load_cruise(archive)).superseded("M1") == described
    (archive / "v1.zip").write_bytes(b"none")
    with pytest.raises(InputError, match=r"v1\.zip: expected the ZIP of compass export --to rocrate"):
        settings.check_cruise(config.load_cruise(archive))


DEPOSITED = {
    crate.FILE: '{"@graph": [{"@type": "SoftwareApplication", "name": "compasslib", "softwareVersion": "1"}]}',
    "config/config.yaml": "seed: 1\n",
}


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ({crate.FILE: '{"@graph": []}'}, "KeyError: 'compasslib'"),
        ({"config/config.yaml": "[1]"}, "config/config.yaml: expected keys with values, found a list"),
    ],
)
def test_deposit_of_odd_content_is_refused_in_one_line(tmp_path, content, expected):
    with zipfile.ZipFile(tmp_path / "v1.zip", "w") as packed:
        for name, text in (DEPOSITED | content).items():
            packed.writestr(name, text)
    (tmp_path / "config").mkdir()
    (tmp_path / "config/config.yaml").write_text("seed: 2\n")
    with pytest.raises(InputError, match=f"v1.zip: .*{expected}"):
        deposit.describe_superseded(tmp_path / "v1.zip", ["config/config.yaml"], tmp_path)


def test_deposit_is_a_complete_workflow_run_crate(unpacked):
    """Workflow Run Crate 0.5: every MUST, and the SHOULDs that the attributes and this software can provide."""
    page = json.loads((unpacked / "ro-crate-metadata.json").read_text())
    entities = {entity["@id"]: entity for entity in page["@graph"]}
    root, workflow = entities["./"], entities["workflow/Snakefile"]
    assert set(workflow["@type"]) == {"File", "SoftwareSourceCode", "ComputationalWorkflow"}
    assert ids(root["mainEntity"]) == [workflow["@id"]] and ids(entities["#run"]["instrument"]) == [workflow["@id"]]
    assert [entities[ids(root[role])[0]]["name"] for role in ("author", "publisher", "license")] == [
        "A. Fram", "Sea", "CC-BY-4.0",
    ]  # fmt: skip
    for action in of_type(page, "CreateAction"):
        assert ids(action["agent"]) == ids(root["author"]) and action["description"]
        assert re.fullmatch(r"[\d-]{10}T[\d:]{8}\+00:00", action["endTime"])
        assert all(item in entities for part in ("object", "result") for item in ids(action[part]))
    files = {unquote(identifier) for identifier in ids(root["hasPart"])}
    assert files | {"ro-crate-metadata.json", crate.FILE} == tree(unpacked, files_only=True)
    own = [root, workflow, entities[deposit.WHEEL], *of_type(page, "SoftwareApplication")[:1]]
    assert [entities[entity["license"]["@id"]]["name"] for entity in own] == ["CC-BY-4.0", "MIT", "MIT", "MIT"]
    assert [entities[entity["author"]["@id"]]["name"] for entity in own] == ["A. Fram", *["The compasslib authors"] * 3]
    hashed = [entity for entity in page["@graph"] if "File" in entity["@type"] and "sha256" in entity]
    known = {entity["name"]: entity["sha256"] for entity in hashed}
    assert all(provenance.sha256(unpacked / name) == digest for name, digest in known.items() if "/" in name)


def test_deposit_of_changed_results_is_refused(archive, tmp_path, capsys):
    assert main(["export", "--cruise", str(archive), "--to", "rocrate", "--into", str(tmp_path / "by_command")]) == 0
    assert "by_command" in capsys.readouterr().out
    (archive / "results/M1/corrected.nc").write_bytes(b"other")
    with pytest.raises(InputError, match=r"results/M1/corrected\.nc: expected the file that the manifest lists"):
        deposit.deposit(config.load_cruise(archive), tmp_path / "c.zip")
    options = archive / "config/config.yaml"
    options.write_text(options.read_text().replace("publisher_url", "address"))
    with pytest.raises(InputError, match="found no publisher_url; add publisher_url, its address"):
        deposit.deposit(config.load_cruise(archive), tmp_path / "c.zip")
    assert not (tmp_path / "c.zip").exists()


# ----------------------------------------------------------------------------------------------------------- the crate
def test_crate_satisfies_its_profiles_and_lists_every_file(processed):
    """RO-Crate 1.1 and Process Run Crate 0.5: every MUST, and no dangling references."""
    page = page_of(processed)
    entities = {entity["@id"]: entity for entity in page["@graph"]}
    assert len(entities) == len(page["@graph"]), "two entities of one identifier"
    descriptor, root = entities["ro-crate-metadata.json"], entities["./"]
    assert descriptor["@type"] == "CreativeWork" and ids(descriptor["about"]) == ["./"]
    assert ids(descriptor["conformsTo"]) == ["https://w3id.org/ro/crate/1.1"]
    assert root["@type"] == "Dataset" and entities[ids(root["conformsTo"])[0]]["@type"] == "CreativeWork"
    assert ids(root["conformsTo"])[0].startswith("https://w3id.org/ro/wfrun/process/")
    assert all(root[key] for key in ("name", "description", "datePublished", "license"))
    assert root["identifier"] == "https://doi.org/10.1/x"
    assert set(ids(root["hasPart"])) == {entity["@id"] for entity in of_type(page, "File")}
    assert ids(root["mentions"]) == [action["@id"] for action in of_type(page, "CreateAction")]
    for action in of_type(page, "CreateAction"):
        assert entities[ids(action["instrument"])[0]]["@type"] == "SoftwareApplication"
        assert all(entities[one]["@type"] == "File" for key in ("object", "result") for one in ids(action[key]))
    referred = re.findall(r'\{"@id": "([^"]*)"\}', json.dumps(page))
    assert set(referred) <= {*entities, "https://w3id.org/ro/crate/1.1"}
    listed = {entity["name"]: entity["sha256"] for entity in of_type(page, "File")}
    made = {path for path in tree(processed, files_only=True) if path.startswith("results/")}
    assert (
        listed.keys() == {name for name in made if not re.search("/(logs|benchmarks)/", name)} - {crate.FILE} | INPUTS
    )
    assert all(provenance.sha256(processed / name) == digest for name, digest in listed.items())


def test_other_names_in_results_are_reserved(processed):
    beside = {path.name for path in (processed / "results").iterdir()} - {"M1"}
    assert len(beside) >= 5 and beside <= set(schema.RESERVED)


def test_product_is_traced_to_raw_files_settings_and_software(processed):
    page = page_of(processed)
    made_by = {one: action for action in of_type(page, "CreateAction") for one in ids(action["result"])}
    waiting, reached = ["M1/corrected.nc"], set()
    while waiting:
        reached.add(one := waiting.pop())
        waiting += [other for other in ids(made_by[one]["object"]) if one in made_by] if one in made_by else []
    sources = {one for one in reached if one not in made_by}
    assert sources == {f"../{file}" for file in INPUTS}
    names = {entity["name"]: entity for entity in page["@graph"] if "name" in entity}
    assert names["compasslib"]["softwareVersion"] == provenance.software().removeprefix("compasslib ")
    assert names["numpy"]["softwareVersion"] and names["python"]["softwareVersion"]
    assert names["requirements/run.txt"]["sha256"] == provenance.sha256(PROJECT / "requirements/run.txt")
    assert '"max_minutes": 20.0' in made_by["M1/work/pairs/overlap.nc"]["description"]
    assert names["Compass deviations corrected: Größe"]["publisher"] == {"@id": "https://example.org/"}


def test_product_history_names_raw_files_with_hashes(processed):
    folder = processed / "results/M1"
    with netCDF4.Dataset(folder / "corrected.nc") as nc:
        for file in ("raw/M1/top.000", "raw/M1/deep.csv"):
            assert f"{file} (sha256 {provenance.sha256(processed / file)})" in nc.history
        assert "metadata_link" not in nc.ncattrs()  # ACDD asks for a URL; the crate has none before it is deposited
        assert nc.date_created == nc.date_modified == provenance.date_created()
    with netCDF4.Dataset(folder / "overlap.nc") as nc:
        assert provenance.sha256(folder / "work/top.nc") in nc.history


def test_derived_attributes_are_refused_in_yaml(processed):
    with netCDF4.Dataset(processed / "results/M1/corrected.nc") as nc:
        written = {*nc.ncattrs(), *(name for name in nc["HEADING"].ncattrs() if name.startswith("sensor_"))}
    assert set(values.STATED) <= written and {"history", "time_coverage_start", "id"} <= set(values.STATED)
    offered = dict.fromkeys(("title", "summary", "license", "creator_name", "sensor_mount", "publisher_url"), "mine")
    assert values.attributes(offered) == offered


def test_configuration_files_of_each_job_are_listed(tmp_path):
    folder = cruise(tmp_path, ("M1",), n=10)
    write_calibration(folder, "M1", readings())  # may have the name of a mooring
    assert settings.configuration(config.load_cruise(folder)) == {
        "": ["config/config.yaml"],
        "mooring M1": ["config/config.yaml", "config/moorings/M1.yaml"],
        "calibration M1": ["config/config.yaml", "config/calibrations/M1.yaml"],
    }


def test_manifest_refuses_a_result_that_its_job_did_not_write(archive, monkeypatch):
    monkeypatch.chdir(archive)
    record = Path("results/M1/logs/correct.json")
    record.write_text(record.read_text().replace('deviation.json": "', 'deviation.json": "f'))
    with pytest.raises(InputError, match=r"results/M1/deviation\.json: .* compass run -- --forcerun results/M1/dev"):
        crate.read_jobs(Path().glob("results/M1/logs/*.json"))


# ------------------------------------------------------------------------------------------------------------- verify
def verify(folder: Path, *options: str) -> tuple[int, list[str]]:
    said = TextIOWrapper(BytesIO(), encoding="utf-8", write_through=True)  # fails for surrogates in names
    with redirect_stdout(said), redirect_stderr(said):
        code = main(["verify", str(folder), *options])
    return code, said.buffer.getvalue().decode().splitlines()


def test_verification_of_an_unchanged_archive_writes_nothing(archive):
    before = {path: path.stat().st_mtime_ns for path in archive.rglob("*")}
    code, said = verify(archive)
    assert code == 0 and said == [f"{crate.FILE}: {len(crate.listed(page_of(archive)))} files as listed"]
    assert {path: path.stat().st_mtime_ns for path in archive.rglob("*")} == before


def test_changed_files_are_reported_one_per_line(archive):
    flip(archive / "results/M1/corrected.nc")
    (archive / "raw/M1/deep.csv").unlink()
    (archive / "results/M1/notes.txt").write_text("mine")
    code, said = verify(archive)
    untold = "cannot list results that are no longer configured"  # because a raw file is missing
    assert code == 1 and sorted(line.split(":")[0] for line in said) == [
        *(untold, "changed", "error", "mend", "missing", "new")
    ]
    assert {"missing: raw/M1/deep.csv", "new: results/M1/notes.txt"} < set(said)
    assert any(line.startswith("changed: results/M1/corrected.nc (sha256 ") for line in said)
    assert f"expected {len(crate.listed(page_of(archive)))} files as listed, found 3 that differ" in said[-1]


@pytest.mark.parametrize("content", [None, "[1, 2]", "not JSON", '{"@graph": [{"@type": "File"}]}', '{"@graph": []}'])
def test_missing_or_invalid_manifest_is_reported(archive, content):
    (archive / crate.FILE).unlink()
    if content is not None:
        (archive / crate.FILE).write_text(content)
    code, said = verify(archive)
    assert code == 1 and len(said) == 1 and said[0].startswith("error: ") and "ro-crate-metadata.json" in said[0]


PLANTED = {
    "in a new folder": "results/new/deep/x.csv",
    "among the logs": "results/M1/logs/notes.txt",
    "with a name that is no UTF-8": b"results/M1/caf\xe9.nc".decode(errors="surrogateescape"),
    "with a line break in its name": "results/M1/a\nb.nc",
}


@pytest.mark.parametrize("where", PLANTED)
def test_file_that_no_job_wrote_is_reported(archive, where):
    path = archive / PLANTED[where]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text('{"planted": true}')
    assert [each[:2] for each in crate.differences(archive, ["results/M1"])] == [("new", PLANTED[where])]
    if not where.startswith("with"):
        return
    code, said = verify(archive)
    assert code == 1 and said[0] == f"new: {PLANTED[where]!a}" and len(said) == 2
    assert verify(archive, "--clear", "--yes")[0] == 0 and path.exists()


def without(page: dict, *kinds: str, name: str = "") -> dict:
    kept = [entity for entity in page["@graph"] if entity["@type"] not in kinds or name not in entity["name"]]
    return page | {"@graph": kept}


def test_product_that_the_manifest_does_not_list_is_reported(archive):
    (archive / crate.FILE).write_text(json.dumps(without(page_of(archive), "File", "CreateAction", name="correct")))
    assert ("unlisted", "results/M1/corrected.nc") in [each[:2] for each in crate.differences(archive, ["results/M1"])]


# ----------------------------------------------------------------------------------------- results no longer configured
@pytest.fixture
def renamed(archive):
    """Return a cruise with results of a mooring and an instrument that are no longer configured."""
    shutil.copytree(archive / "results/M1", archive / "results/OLD")
    for path in (archive / "results/OLD/logs").glob("*.json"):
        path.write_text(path.read_text().replace("results/M1/", "results/OLD/"))
    record = (archive / "results/M1/logs/read_deep.json").read_text().replace("work/deep", "work/lower")
    (archive / "results/M1/logs/read_lower.json").write_text(record)
    shutil.copy2(archive / "results/M1/work/deep.nc", archive / "results/M1/work/lower.nc")
    return archive


def tree(folder: Path, *, files_only: bool = False) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file() or not files_only}


def test_obsolete_results_are_listed_and_cleared_on_request(renamed, processed):
    code, said = verify(renamed)
    old = sum(path.is_file() for path in (renamed / "results/OLD").rglob("*"))
    counts = {"M1": 1, "OLD": old}
    lines = [f"no longer configured: results/{name}, {n} files" for name, n in counts.items()]
    assert code == 1 and said[:-1] == lines and "compass verify --clear shows and removes" in said[-1]

    (renamed / "results/OLD/notes.txt").write_text("mine")
    (renamed / "results/OLD/corrected.nc").write_text("edited by hand")
    before = tree(renamed)
    code, said = verify(renamed, "--clear")
    kept = [f"kept: results/OLD/{name}, which no job wrote as it is" for name in ("corrected.nc", "notes.txt")]
    assert code == 0 and tree(renamed) == before and said[-3:-1] == kept
    assert said[-1] == f"{old} files of what is no longer configured; add --yes to remove them"

    code, removed = verify(renamed, "--clear", "--yes")
    assert code == 0 and [line.replace("would be ", "") for line in said[:-1]] == removed[:-1]
    left = {"results/M1/logs/read_lower.json", "results/OLD", "results/OLD/notes.txt", "results/OLD/corrected.nc"}
    assert tree(renamed) - tree(processed) == left
    assert tree(processed) <= tree(renamed)
    shutil.rmtree(renamed / "results/OLD")
    assert verify(renamed)[0] == 0 and verify(renamed, "--clear") == (0, ["0 files of what is no longer configured"])


def test_results_of_an_unfinished_or_stopped_run_are_not_cleared(archive):
    (archive / crate.FILE).write_text(json.dumps(without(page_of(archive), "File", "CreateAction", name="grid")))
    os.utime(archive / crate.FILE, (1.7e9, 1.7e9))
    assert verify(archive, "--clear") == (0, ["0 files of what is no longer configured"])
    os.utime(archive / crate.FILE)
    assert verify(archive, "--clear")[1][-1].startswith("1 files")  # as after "grid: false"
    (archive / "results/M1/stopped.json").write_text("{}")
    assert verify(archive, "--clear") == (0, ["0 files of what is no longer configured"])


def test_nothing_is_cleared_without_configuration(renamed):
    before = tree(renamed)
    (renamed / "raw/M1/top.000").unlink()
    code, said = verify(renamed, "--clear", "--yes")
    assert code == 1 and len(said) == 1 and "config/moorings/M1.yaml: instruments.top.files" in said[0]
    assert tree(renamed) | {"raw/M1/top.000"} == before
    code, said = verify(renamed)
    assert "missing: raw/M1/top.000" in said and not any(line.startswith("no longer configured:") for line in said)
    unread = "cannot list results that are no longer configured: config/moorings/M1.yaml"
    assert any(line.startswith(unread) for line in said)


# ---------------------------------------------------------------------------------------------------------------- jobs
def test_library_hash_is_of_its_content_alone(tmp_path):
    """The same for a copy at another path; another once a module, a rule or a template differs."""
    copies = [copied_project(tmp_path / name, "compasslib", "workflow") for name in ("one", "other")]
    (copies[1] / "compasslib/__pycache__").mkdir()
    (copies[1] / "compasslib/__pycache__/angles.cpython-311.pyc").touch()
    first, other = (told(copy)[2] for copy in copies)
    assert first == other and re.fullmatch("[0-9a-f]{16}", first)
    for name in ("compasslib/angles.py", "workflow/rules/cruise.smk", "compasslib/report/templates/style.css"):
        with (copies[1] / name).open("a") as stream:
            stream.write("\n")
        first, other = other, told(copies[1])[2]
        assert first != other, name


# --------------------------------------------------------------------------------------------------- commits and dates
def told(project: Path, **environment: str) -> list[str]:
    """Return software, date and hash by a copy of the project, without SOURCE_DATE_EPOCH unless given."""
    asked = "from compasslib.archive.provenance import *; print(software(), date_created(), library(), sep='\\n')"
    given = {key: value for key, value in os.environ.items() if key != "SOURCE_DATE_EPOCH"}
    whole = given | {"PYTHONPATH": str(project), "PYTHONDONTWRITEBYTECODE": "1"} | environment
    ran = subprocess.run(
        [sys.executable, "-c", asked], capture_output=True, text=True, check=True, env=whole, cwd=project
    )
    return ran.stdout.splitlines()


def commit(folder: Path) -> str:
    """Create a Git repository in a folder and return its first commit."""
    who = {f"GIT_{role}_{key}": "a@b" for role in ("AUTHOR", "COMMITTER") for key in ("NAME", "EMAIL")}
    when = {"GIT_AUTHOR_DATE": "2024-02-03T04:05:06Z", "GIT_COMMITTER_DATE": "2024-02-03T04:05:06Z"}
    for arguments in (["init", "--quiet"], ["add", "."], ["commit", "--quiet", "--message", "first"]):
        subprocess.run(["git", "-C", str(folder), *arguments], check=True, env=os.environ | who | when)
    command = ["git", "-C", str(folder), "rev-parse", "--short=12", "HEAD"]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


@pytest.fixture
def copied(tmp_path):
    """A copy of the library outside any checkout."""
    return copied_project(tmp_path / "held", "compasslib")


def test_software_outside_a_checkout_is_identified_by_hash(copied):
    before = datetime.now(UTC).replace(microsecond=0)
    software, date, library = told(copied)
    assert software.startswith(f"compasslib {__version__} ")
    assert f"no checkout, modules sha256 {library[:12]}" in software
    assert before <= datetime.fromisoformat(date) <= datetime.now(UTC)
    assert told(copied, SOURCE_DATE_EPOCH="1700000000")[1] == "2023-11-14T22:13:20Z"


def test_checkout_is_identified_by_commit_and_edits(copied):
    made = commit(copied)
    assert told(copied)[0].endswith(f"({made})")
    assert told(copied, GIT_TEST_ASSUME_DIFFERENT_OWNER="1")[0].endswith(f"({made})")
    with (copied / "compasslib/angles.py").open("a") as stream:
        stream.write("# edited\n")
    assert told(copied)[0].endswith(f"({made}, edited since)")


@pytest.mark.parametrize("harm", ["HEAD", "git"])
def test_module_hash_replaces_an_unknown_commit(copied, harm):
    commit(copied.parent)  # an enclosing repository, which must not be used instead
    commit(copied)
    if harm == "HEAD":
        (copied / ".git/HEAD").unlink()
    software, *_ = told(copied, **({"PATH": "/nowhere"} if harm == "git" else {}))
    assert software.startswith(f"compasslib {__version__} ") and "(commit unknown, modules sha256 " in software


def test_invalid_source_date_epoch_is_refused(monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "yesterday")
    with pytest.raises(InputError, match="SOURCE_DATE_EPOCH: expected whole seconds since 1970, found 'yesterday'"):
        provenance.date_created()
