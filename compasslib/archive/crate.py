"""The manifest results/ro-crate-metadata.json, a Process Run Crate (RO-Crate 1.1), and verification of files by it.

Each job of the workflow writes a record (``pipeline.job``), which becomes an action of the crate. Of the clock only
``datePublished`` is read, which SOURCE_DATE_EPOCH can fix. Profile: https://w3id.org/ro/wfrun/process/0.5

Reading the manifest raises InputError where there is none, it is not a manifest, or it lists no file.
"""

import json
import platform
import re
import shlex
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path, PurePosixPath
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
    **{".nc": "application/x-netcdf", ".json": "application/json", ".yaml": "application/yaml"},
    **{".csv": "text/csv", ".png": "image/png", ".html": "text/html"},
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
    """Read the records of jobs by the names of their actions; refuse a file read that is not as its job wrote it.

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
    tools = list(_surroundings())
    required = {"softwareRequirements": references(entity["@id"] for entity in tools), **OWN}
    makers = {record["software"] for record in jobs.values()} | ({maker} if stopped else set())
    software = {each: _software(each, url) | required for each in sorted(makers)}
    actions = [_action(name, record, configuration, software[record["software"]]) for name, record in jobs.items()]
    for subject, why in stopped.items():
        given = {"name": subject, "error": why, "object": _files(configuration[subject])}
        actions.append(_create_action(f"stopped/{subject}", "Failed", software[maker], given))
    owned = owners(attributes)
    project = f": {attributes['project']}" if attributes.get("project") else ""
    doi = str(attributes.get("doi", "")).rpartition("doi.org/")[2].removeprefix("doi:")
    about: list[Entity] = [
        {
            "@id": "ro-crate-metadata.json",
            "@type": "CreativeWork",
            "conformsTo": {"@id": "https://w3id.org/ro/crate/1.1"},
            "about": {"@id": "./"},
        },
        {"@id": PROFILE, "@type": "CreativeWork", "name": "Process Run Crate", "version": PROFILE.rsplit("/", 1)[1]},
        {
            "@id": "./",
            "@type": "Dataset",
            "conformsTo": {"@id": PROFILE},
            "name": f"Compass deviations corrected{project}",
            "description": (
                "Moored current records and compass calibrations, with the jobs that made them and the SHA-256 of "
                "every file read or written."
            ),
            "datePublished": provenance.date_created(),
            "license": "not given",  # required by RO-Crate
            **({"identifier": f"https://doi.org/{doi}"} if doi else {}),
            **{role: {"@id": entity["@id"]} for role, entity in owned.items()},
            "hasPart": _files(files),
            "mentions": [{"@id": action["@id"]} for action in actions],
        },
        *{entity["@id"]: entity for entity in (*MAKERS, *owned.values())}.values(),
    ]
    data = [
        {"@id": _id(path), "@type": "File", "name": path, "sha256": known}
        | {"encodingFormat": FORMATS.get(Path(path).suffix, "application/octet-stream")}
        for path, known in sorted(files.items())
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
        entities["author"]["affiliation"] = {"@id": entities["publisher"]["@id"]}
    return entities


def references(identifiers: Iterable[str]) -> list[Entity]:
    """Refer to several entities."""
    return [{"@id": identifier} for identifier in identifiers]


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


def _action(name: str, record: Record, configuration: Mapping[str, Sequence[str]], software: Entity) -> Entity:
    """Compose the action of a job, which also read the YAML files behind it."""
    subject = " ".join(next(iter(record["of"].items()), ""))
    parameters = json.dumps(record["parameters"], ensure_ascii=False)
    given = {
        "name": " ".join([record["rule"], *record["of"].values()]),
        "description": f"rule {record['rule']}, library {record['library']}, parameters {parameters}",
        "object": _files({*record["read"], *configuration.get(subject, configuration[""])}),
        "result": _files(record["wrote"]),
    }
    return _create_action(name, "Completed", software, given)


def _create_action(name: str, status: str, software: Entity, given: Entity) -> Entity:
    action = {"@id": f"#{quote(name)}", "@type": "CreateAction", "instrument": {"@id": software["@id"]}}
    return action | {"actionStatus": f"http://schema.org/{status}ActionStatus"} | given


def _id(path: str) -> str:
    """Derive the identifier of a file: its path relative to results/, where the crate is."""
    inside = path.removeprefix(f"{FOLDER}/")
    return quote(inside if inside != path else f"../{path}")


def _files(paths: Iterable[str]) -> list[Entity] | Entity:
    """Refer to files; a single reference is not in a list, as usual in RO-Crate."""
    entries = references(map(_id, sorted(paths)))
    return entries[0] if len(entries) == 1 else entries


# Kinds of differences from the manifest.
FORMER = "no longer configured"
CHANGED, MISSING, NEW, UNLISTED = "changed", "missing", "new", "unlisted"
OF_CRUISE = (f"{FOLDER}/figures", f"{FOLDER}/logs")
# Files of a job that no manifest lists: log, record, and benchmark (processor time).
JOB_FILE = re.compile(r"results(?:/[^/]+){0,2}/(?:logs/[^/]+\.(?:log|json)|benchmarks/[^/]+\.tsv|stopped\.json)")
# Files that options or instruments add, so that those of earlier ones may be left.
OPTIONAL = re.compile(
    r"results/(?:.+/)?(?:gridded(?:_daily)?\.nc|figures/[a-z_]+\.(?:png|pdf)|work/[^/]+\.(?:nc|json))"
)
Difference = tuple[str, str, str]  # what is different, path, details


def unlisted_files(root: Path, configured: Collection[str] | None) -> dict[str, str]:
    """Classify the files and links below results/ that the manifest does not list, except logs and records of jobs.

    Args:
        configured: folders of the configured moorings, calibrations and compasses; None where unknown.

    Returns:
        By path from the cruise folder: ``FORMER``, unchanged result of what is no longer configured; ``UNLISTED``,
        of a later job than the manifest; or ``NEW``, as no job wrote it.
    """
    known, manifest = listed(read_manifest(root)), root / FILE
    entries = [path for path in (root / FOLDER).rglob("*") if path.is_symlink() or not path.is_dir()]
    paths = {path.relative_to(root).as_posix(): path for path in sorted(entries) if path != manifest}
    of_jobs = {file for file, path in paths.items() if JOB_FILE.fullmatch(file) and not path.is_symlink()}
    wrote = set[tuple[str, str]]()
    for path in (paths[file] for file in of_jobs if file.endswith(".json")):
        with suppress(OSError, ValueError, TypeError, KeyError):  # a damaged record
            wrote |= set(dict(json.loads(path.read_bytes())["wrote"]).items())
    folders = None if configured is None else tuple(f"{folder}/" for folder in (*configured, *OF_CRUISE))
    kinds = dict[str, str]()
    for file, path in ((file, path) for file, path in paths.items() if file not in known):
        regular = path.is_file() and not path.is_symlink()
        as_written = file in of_jobs or (regular and (file, provenance.sha256(path)) in wrote)
        former = folders is not None and not file.startswith(folders) and len(PurePosixPath(file).parts) > 2
        if not as_written:
            kinds[file] = NEW
        elif former:
            kinds[file] = FORMER
        elif file not in of_jobs and not any((folder / "stopped.json").exists() for folder in path.parents):
            later = folders is None or path.stat().st_mtime > manifest.stat().st_mtime
            kinds[file] = UNLISTED if later or not OPTIONAL.fullmatch(file) else FORMER
    return kinds


def clear(root: Path, files: Iterable[str]) -> None:
    """Delete files below results/, and the folders that become empty."""
    folders = set[PurePosixPath]()
    for file in files:
        (root / file).unlink()
        folders |= {*PurePosixPath(file).parents[:-2]}
    for folder in sorted(folders, key=lambda each: -len(each.parts)):
        with suppress(OSError):  # the folder is not empty
            (root / folder).rmdir()


def differences(root: Path, configured: Collection[str] | None) -> list[Difference]:
    """List differences from the manifest, by file, and results no longer configured, by folder.

    Args:
        root: folder of the cruise, which is only read.
        configured: as for ``unlisted_files``.
    """
    differ = list[Difference]()
    for file, known in listed(read_manifest(root)).items():
        if not (root / file).is_file():
            differ.append((MISSING, file, ""))
        elif (now := provenance.sha256(root / file)) != known:
            differ.append((CHANGED, file, f" (sha256 {now[:12]}, listed {known[:12]})"))
    kinds, former = unlisted_files(root, configured), Counter[str]()
    differ += [(kind, file, "") for file, kind in kinds.items() if kind != FORMER]
    for parts in (PurePosixPath(file).parts[:-1] for file, kind in kinds.items() if kind == FORMER):
        former["/".join(parts[: 3 if parts[1] in ("calibrations", "compasses", "sites") else 2])] += 1
    return [*differ, *((FORMER, folder, f", {n} files") for folder, n in sorted(former.items()))]


def to_make_again(page: Mapping[str, Any], differ: Iterable[Difference]) -> list[str]:
    """List results that differ, and one file of each job that read a changed raw file; none for a missing raw file."""
    outputs = dict[str, None]()
    for what, file, _ in differ:
        if what in (CHANGED, MISSING) and file.startswith(f"{FOLDER}/"):
            outputs[file] = None
        elif what == CHANGED and file.endswith((".yaml", ".yml")):  # its keys decide what else runs
            outputs[FILE] = None
        elif what == CHANGED:
            outputs |= dict.fromkeys(made_from(page, file))
    return list(outputs)


def read_manifest(root: Path) -> dict[str, Any]:
    """Read the manifest of a cruise."""
    if not (root / FILE).exists():
        advice = "compass run writes it, or says which result was changed and how to make it again"
        raise InputError(str(root / FILE), expected="the manifest of a complete run", found="none", advice=advice)
    page: dict[str, Any] = read_json(root / FILE)
    try:
        made_from(page, "")
        fault = "" if listed(page) else "no file listed"
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        fault = repr(error)
    if fault:
        raise InputError(str(root / FILE), "a manifest that lists the files of a run", fault, "make run writes it")
    return page
