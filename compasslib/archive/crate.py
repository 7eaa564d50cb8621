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
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote

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
    files = provenance.hashes(path for paths in configuration.values() for path in paths)
    for record in jobs.values():
        files |= record["read"] | record["wrote"]
    data = [
        {"@id": _id(path), "@type": "File", "name": path, "sha256": files[path]}
        | {"encodingFormat": FORMATS.get(Path(path).suffix, "application/octet-stream")}
        for path in sorted(files)
    ]
    tools = list(_surroundings())
    required = {"softwareRequirements": [_ref(entity["@id"]) for entity in tools], **OWN}
    makers = {record["software"] for record in jobs.values()} | ({provenance.software()} if stopped else set())
    url = str(attributes.get("software_url", ""))
    software = {maker: _software(maker, url) | required for maker in sorted(makers)}
    actions = [_job(name, record, configuration, software[record["software"]]) for name, record in jobs.items()]
    for subject, why in (stopped or {}).items():
        actions.append(_failed(subject, why, configuration, software[provenance.software()]))
    parts = {"hasPart": _refs(files), "mentions": [_ref(action["@id"]) for action in actions]}
    about = [
        {
            "@id": "ro-crate-metadata.json",
            "@type": "CreativeWork",
            "conformsTo": _ref("https://w3id.org/ro/crate/1.1"),
            "about": _ref("./"),
        },
        {"@id": PROFILE, "@type": "CreativeWork", "name": "Process Run Crate", "version": PROFILE.rsplit("/", 1)[1]},
        _root(attributes) | parts,
        *{entity["@id"]: entity for entity in (*MAKERS, *owners(attributes).values())}.values(),
    ]
    return {"@context": CONTEXT, "@graph": [*about, *software.values(), *tools, *actions, *data]}


def listed(page: Mapping[str, Any]) -> dict[str, str]:
    """Return the SHA-256 of the files listed in a crate, by path from the cruise folder."""
    files = [entity for entity in page["@graph"] if entity["@type"] == "File"]
    return {entity["name"]: entity["sha256"] for entity in files}


def has_failures(page: Mapping[str, Any]) -> bool:
    """Return whether moorings or calibrations were stopped in the run of a crate."""
    return any(action["actionStatus"].endswith("FailedActionStatus") for action in _actions(page))


def written(page: Mapping[str, Any]) -> set[str]:
    """List the files that jobs wrote, as paths from the cruise folder."""
    return {path for action in _actions(page) for path in _paths(action, "result")}


def made_from(page: Mapping[str, Any], file: str) -> list[str]:
    """List one file of each job that read a file, as paths from the cruise folder."""
    jobs = [action for action in _actions(page) if file in _paths(action, "object")]
    return [made[0] for action in jobs if (made := _paths(action, "result"))]


def _paths(action: Mapping[str, Any], part: str) -> list[str]:
    """List the files in an action's ``object`` or ``result``, as paths from the cruise folder."""
    names = map(unquote, identifiers(action, part))
    return [name.removeprefix("../") if name.startswith("../") else f"{FOLDER}/{name}" for name in names]


def _actions(page: Mapping[str, Any]) -> list[Entity]:
    return [entity for entity in page["@graph"] if entity["@type"] == "CreateAction"]


def identifiers(action: Mapping[str, Any], part: str) -> list[str]:
    """List the identifiers in an action's ``object`` or ``result``."""
    given = action.get(part, [])
    return [item["@id"] for item in (given if isinstance(given, list) else [given])]


def _root(attributes: Mapping[str, Any]) -> Entity:
    project = attributes.get("project")
    roles = {role: _ref(entity["@id"]) for role, entity in owners(attributes).items()}
    return {
        "@id": "./",
        "@type": "Dataset",
        "conformsTo": _ref(PROFILE),
        "name": "Compass deviations corrected" + (f": {project}" if project else ""),
        "description": (
            "Moored current records and compass calibrations, with the jobs that made them and the SHA-256 of every "
            "file read or written."
        ),
        "datePublished": provenance.date_created(),
        "license": "not given",  # required by RO-Crate
    } | roles


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
        entities["author"]["affiliation"] = _ref(entities["publisher"]["@id"])
    return entities


def _surroundings() -> Iterator[Entity]:
    """Yield entities for Python, plug-in packages, the lock file and the installed version of each required package."""
    python = platform.python_version()
    yield _software(f"python {python}", "https://www.python.org/")
    for package in plugins.plugin_packages():
        yield _software(package)
    lock = provenance.RELEASE_FILES / LOCK
    known = provenance.sha256(lock)
    yield {"@id": f"#{LOCK}", "@type": "SoftwareSourceCode", "name": LOCK, "sha256": known, "version": known[:12]}
    for package in re.findall(r"^([\w.-]+)==", lock.read_text(), re.MULTILINE):
        if version := provenance.installed(package):  # the lock also lists build tools and packages of other platforms
            yield _software(f"{package} {version}", f"https://pypi.org/project/{package}/")


def _software(program: str, url: str = "") -> Entity:
    """Compose the entity of a program, given as "name version"."""
    name, version = program.split(" ", 1)
    identifier = f"{url}#{quote(version)}" if url else f"#{quote(program)}"
    tool = {"@id": identifier, "@type": "SoftwareApplication", "name": name, "softwareVersion": version}
    return tool | ({"url": url} if url else {})


def _job(name: str, record: Record, configuration: Mapping[str, Sequence[str]], software: Entity) -> Entity:
    parameters = json.dumps(record["parameters"], ensure_ascii=False)
    about = " ".join(record["of"].values())
    subject = " ".join(next(iter(record["of"].items()), ""))
    read = {*record["read"], *configuration.get(subject, configuration[""])}
    return {
        "@id": f"#{quote(name)}",
        "@type": "CreateAction",
        "name": f"{record['rule']} {about}".strip(),
        "description": f"rule {record['rule']}, library {record['library']}, parameters {parameters}",
        "instrument": _ref(software["@id"]),
        "actionStatus": "http://schema.org/CompletedActionStatus",  # only completed jobs lead to products
        "object": _refs(read),
        "result": _refs(record["wrote"]),
    }


def _failed(subject: str, why: str, configuration: Mapping[str, Sequence[str]], software: Entity) -> Entity:
    return {
        "@id": f"#{quote(f'stopped/{subject}')}",
        "@type": "CreateAction",
        "name": subject,
        "instrument": _ref(software["@id"]),
        "actionStatus": "http://schema.org/FailedActionStatus",
        "error": why,
        "object": _refs(configuration[subject]),
    }


def _id(path: str) -> str:
    """Derive the identifier of a file: its path relative to results/, where the crate is."""
    inside = path.removeprefix(f"{FOLDER}/")
    return quote(inside if inside != path else f"../{path}")


def _refs(paths: Iterable[str]) -> list[Entity] | Entity:
    """Compose references to files; a single reference is not in a list, as usual in RO-Crate."""
    entries = [_ref(_id(path)) for path in sorted(paths)]
    return entries[0] if len(entries) == 1 else entries


def _ref(identifier: str) -> Entity:
    return {"@id": identifier}
