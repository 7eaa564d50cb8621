"""The manifest results/ro-crate-metadata.json: provenance of all results as a Process Run Crate (RO-Crate 1.1).

Each job of the workflow writes a record (``pipeline.job``), which becomes an action of the crate. Of the clock only
``datePublished`` is read, which SOURCE_DATE_EPOCH can fix. Profile: https://w3id.org/ro/wfrun/process/0.5
"""

from __future__ import annotations

import json
import platform
import re
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any
from urllib.parse import quote

from compasslib import plugins
from compasslib.archive import provenance
from compasslib.archive.files import read_json
from compasslib.errors import InputError

FOLDER = "results"
FILE = f"{FOLDER}/ro-crate-metadata.json"
LOCK = "requirements/run.txt"
PROFILE = "https://w3id.org/ro/wfrun/process/0.5"
CONTEXT = ["https://w3id.org/ro/crate/1.1/context", "https://w3id.org/ro/terms/workflow-run/context"]
Entity = dict[str, Any]
FORMATS = {
    ".nc": "application/x-netcdf",
    ".json": "application/json",
    ".yaml": "application/yaml",
    ".csv": "text/csv",
    ".png": "image/png",
    ".html": "text/html",
}
# Author and license of workflow and library, which are not those of the data.
MAKERS: tuple[Entity, ...] = (
    {"@id": "#compasslib-authors", "@type": "Organization", "name": "The compasslib authors"},
    {"@id": "https://spdx.org/licenses/MIT", "@type": "CreativeWork", "name": "MIT"},
)
OWN: Entity = {role: {"@id": entity["@id"]} for role, entity in zip(("author", "license"), MAKERS, strict=True)}
CONCEALED = "concealed/"  # truth of the demonstration, which no manifest lists
Record = Mapping[str, Any]  # of a job; see ``pipeline.job``


def job_name(record: Path) -> str:
    """Return the name of a job's action, by the path of its record from the cruise folder."""
    return "/".join(part for part in record.with_suffix("").parts[1:] if part != "logs")


def read_jobs(paths: Iterable[str | Path]) -> dict[str, Record]:
    """Read the records of jobs, without concealed files, by the names of their actions.

    Raises:
        InputError: a record cannot be read, or a job read another file than the one that its job wrote.
    """
    jobs: dict[str, Record] = {}
    for path in sorted(map(Path, paths)):
        record = read_json(path)
        for part in ("read", "wrote"):
            record[part] = {file: known for file, known in record[part].items() if not file.startswith(CONCEALED)}
        jobs[job_name(path)] = record
    written = {file: known for record in jobs.values() for file, known in record["wrote"].items()}
    for record in jobs.values():
        for file, known in record["read"].items():
            if written.get(file, known) != known:
                advice = f"make it again: compass run -- --forcerun {shlex.quote(file)}"
                raise InputError(file, expected="the file that its job wrote", found="another", advice=advice)
    return jobs


def crate(
    jobs: Mapping[str, Record],
    *,
    configuration: Mapping[str, Sequence[str]],
    attributes: Mapping[str, Any],
    stopped: Mapping[str, str] | None = None,
) -> dict[str, Any]:
    """Compose the crate as JSON-LD.

    Args:
        configuration: YAML files behind a job by its subject, e.g. "mooring EG4" or "calibration C1"; "" for others.
        attributes: of the cruise; ``project``, ``software_url`` and those of ``owners`` are used.
        stopped: reasons for missing results, by subject as in ``configuration``.
    """
    stopped, maker, url = stopped or {}, provenance.software(), str(attributes.get("software_url", ""))
    files = provenance.hashes(path for paths in configuration.values() for path in paths)
    for record in jobs.values():
        files |= record["read"] | record["wrote"]
    data = [
        {"@id": _id(path), "@type": "File", "name": path, "sha256": known}
        | {"encodingFormat": FORMATS.get(Path(path).suffix, "application/octet-stream")}
        for path, known in sorted(files.items())
    ]
    tools = list(_surroundings())
    required = {"softwareRequirements": [reference(entity["@id"]) for entity in tools], **OWN}
    makers = {record["software"] for record in jobs.values()} | ({maker} if stopped else set())
    software = {each: _software(each, url) | required for each in sorted(makers)}
    programs = {each: reference(entity["@id"]) for each, entity in software.items()}
    actions = [
        _action(name, programs[record["software"]], *_described(record, configuration), record["wrote"])
        for name, record in jobs.items()
    ]
    actions += [
        _action(f"stopped/{subject}", programs[maker], {"name": subject, "error": why}, configuration[subject])
        for subject, why in stopped.items()
    ]
    owned = owners(attributes)
    project = f": {attributes['project']}" if attributes.get("project") else ""
    about = [
        {
            "@id": "ro-crate-metadata.json",
            "@type": "CreativeWork",
            "conformsTo": reference("https://w3id.org/ro/crate/1.1"),
            "about": reference("./"),
        },
        {"@id": PROFILE, "@type": "CreativeWork", "name": "Process Run Crate", "version": PROFILE.rsplit("/", 1)[1]},
        {
            "@id": "./",
            "@type": "Dataset",
            "conformsTo": reference(PROFILE),
            "name": f"Compass deviations corrected{project}",
            "description": (
                "Moored current records and compass calibrations, with the jobs that made them and the SHA-256 of "
                "every file read or written."
            ),
            "datePublished": provenance.date_created(),
            "license": "not given",  # required by RO-Crate
            **{role: reference(entity["@id"]) for role, entity in owned.items()},
            "hasPart": _refs(files),
            "mentions": [reference(action["@id"]) for action in actions],
        },
        *{entity["@id"]: entity for entity in (*MAKERS, *owned.values())}.values(),
    ]
    return {"@context": CONTEXT, "@graph": [*about, *software.values(), *tools, *actions, *data]}


def listed(page: Mapping[str, Any]) -> dict[str, str]:
    """Return the SHA-256 of the files listed in a crate, by path from the cruise folder."""
    return {entity["name"]: entity["sha256"] for entity in page["@graph"] if entity["@type"] == "File"}


def made_from(page: Mapping[str, Any], file: str) -> list[str]:
    """List one file of each job that read a file, as paths from the cruise folder."""
    names = {entity["@id"]: entity["name"] for entity in page["@graph"] if entity["@type"] == "File"}
    actions = [entity for entity in page["@graph"] if entity["@type"] == "CreateAction"]
    of_file = [action for action in actions if file in map(names.get, identifiers(action, "object"))]
    return [names[made[0]] for action in of_file if (made := identifiers(action, "result"))]


def identifiers(action: Mapping[str, Any], part: str) -> list[str]:
    """List the identifiers in an action's ``object`` or ``result``."""
    given = action.get(part, [])
    return [item["@id"] for item in (given if isinstance(given, list) else [given])]


def owners(attributes: Mapping[str, Any]) -> dict[str, Entity]:
    """Compose the entities of the owners of the data, as far as the cruise states them, by their role at the root."""
    given = {key: str(value) for key, value in attributes.items()}
    entities: dict[str, Entity] = {}
    if name := given.get("principal_investigator"):
        identifier = given.get("principal_investigator_orcid", "#principal_investigator")
        entities["author"] = {"@id": identifier, "@type": "Person", "name": name}
    if name := given.get("institution"):
        url = given.get("publisher_url", "")
        entities["publisher"] = {"@id": url or "#institution", "@type": "Organization", "name": name}
        entities["publisher"] |= {"url": url} if url else {}
    if terms := given.get("license"):
        identifier = terms if "://" in terms else "#license"
        entities["license"] = {"@id": identifier, "@type": "CreativeWork", "name": terms}
    if entities.keys() >= {"author", "publisher"}:
        entities["author"]["affiliation"] = reference(entities["publisher"]["@id"])
    return entities


def reference(identifier: str) -> Entity:
    """Refer to an entity."""
    return {"@id": identifier}


def _surroundings() -> Iterator[Entity]:
    """Yield entities for Python, plug-in packages, the lock file and the installed version of each required package."""
    yield _software(f"python {platform.python_version()}", "https://www.python.org/")
    for package in plugins.plugin_packages():
        yield _software(package)
    lock = provenance.RELEASE_FILES / LOCK
    known = provenance.sha256(lock)
    yield {"@id": f"#{LOCK}", "@type": "SoftwareSourceCode", "name": LOCK, "sha256": known, "version": known[:12]}
    for package in re.findall(r"^([\w.-]+)==", lock.read_text(), re.MULTILINE):
        with suppress(PackageNotFoundError):  # the lock also lists build tools and packages of other platforms
            yield _software(f"{package} {version(package)}", f"https://pypi.org/project/{package}/")


def _software(program: str, url: str = "") -> Entity:
    """Compose the entity of a program, given as "name version"."""
    name, number = program.split(" ", 1)
    identifier = f"{url}#{quote(number)}" if url else f"#{quote(program)}"
    tool = {"@id": identifier, "@type": "SoftwareApplication", "name": name, "softwareVersion": number}
    return tool | ({"url": url} if url else {})


def _described(record: Record, configuration: Mapping[str, Sequence[str]]) -> tuple[Entity, set[str]]:
    """Describe a job, and list the files that it read, with the YAML files behind it."""
    subject = " ".join(next(iter(record["of"].items()), ""))
    parameters = json.dumps(record["parameters"], ensure_ascii=False)
    described = {
        "name": " ".join([record["rule"], *record["of"].values()]),
        "description": f"rule {record['rule']}, library {record['library']}, parameters {parameters}",
    }
    return described, {*record["read"], *configuration.get(subject, configuration[""])}


def _action(
    name: str, software: Entity, described: Entity, read: Iterable[str], wrote: Iterable[str] | None = None
) -> Entity:
    """Compose the action of a job, or of one that was stopped and wrote nothing."""
    status = "FailedActionStatus" if wrote is None else "CompletedActionStatus"
    action: Entity = {"@id": f"#{quote(name)}", "@type": "CreateAction", "instrument": software}
    action |= {"actionStatus": f"http://schema.org/{status}", **described, "object": _refs(read)}
    return action if wrote is None else action | {"result": _refs(wrote)}


def _id(path: str) -> str:
    """Derive the identifier of a file: its path relative to results/, where the crate is."""
    inside = path.removeprefix(f"{FOLDER}/")
    return quote(inside if inside != path else f"../{path}")


def _refs(paths: Iterable[str]) -> list[Entity] | Entity:
    """Compose references to files; a single reference is not in a list, as usual in RO-Crate."""
    entries = [reference(_id(path)) for path in sorted(paths)]
    return entries[0] if len(entries) == 1 else entries
