"""Pack a cruise as a ZIP file for deposit: a Workflow Run Crate (RO-Crate 1.1) whose root is the cruise folder.

Profile: https://w3id.org/ro/wfrun/workflow/0.5. The ZIP contains the files listed in the manifest, each compared with
its hash while packing; the manifest, by which the unpacked folder can be verified; the rules of the workflow; and the
job records, from which ``compass diff`` finds settings and raw files that changed since.
"""

from __future__ import annotations

import hashlib
import json
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from urllib.parse import quote

from compasslib.archive import crate, provenance
from compasslib.archive.attributes import Site
from compasslib.archive.crate import Entity
from compasslib.archive.files import atomic_write
from compasslib.archive.verification import read_manifest
from compasslib.config.cruise import LARGEST_BYTES, Cruise, parse, read
from compasslib.errors import InputError
from compasslib.readers.files import DAMAGE_ERRORS

METADATA, README, DATACITE = "ro-crate-metadata.json", "README.md", "datacite.json"
WORKFLOW_FILE, RUN = "workflow/Snakefile", "#run"
PROFILES = {
    "https://w3id.org/ro/wfrun/process/0.5": ("Process Run Crate", "0.5"),
    "https://w3id.org/ro/wfrun/workflow/0.5": ("Workflow Run Crate", "0.5"),
    "https://w3id.org/workflowhub/workflow-ro-crate/1.0": ("Workflow RO-Crate", "1.0"),
}
BIOSCHEMAS = "https://bioschemas.org/profiles/ComputationalWorkflow/1.0-RELEASE"
# Attributes of config.yaml that only the owner of the data can give, with their meaning.
OWNERS = {
    "license": "under which the data may be used, best a URL",
    "institution": "that publishes the data",
    "publisher_url": "its address",
    "principal_investigator": "who answers for the data",
}
OPTIONAL = {
    "principal_investigator_orcid": "https://orcid.org/...",
    "software_url": "where the version of this software that was used is kept (recommended)",
    "doi": "of the deposit, once reserved",
}
SNAKEMAKE: Entity = {
    "@id": "https://w3id.org/workflowhub/workflow-ro-crate#snakemake",
    "@type": "ComputerLanguage",
    "name": "Snakemake",
    "identifier": {"@id": "https://doi.org/10.1093/bioinformatics/bty350"},
    "url": {"@id": "https://snakemake.github.io/"},
}
ABOUT = """# {title}

Moored current records whose compass was corrected, as one Workflow Run Crate. `results/` holds the products, `config/`
and `raw/` what they were made from, `workflow/` the rules, `ro-crate-metadata.json` the description of all files,
`datacite.json` what a DOI is registered with.

The unpacked folder is compared with its manifest by `compass verify FOLDER`.
"""
VON_APPEN = "10.1175/JTECH-D-14-00043.1"  # DOI of the method
BLOCK_BYTES = 1 << 20  # bytes copied at a time
LARGEST_JSON = 1 << 24  # bytes; the manifest of the demonstration cruise, of 11 moorings, has 0.25 MB


def deposit(cruise: Cruise, to: str | Path) -> int:
    """Pack a processed cruise and return the number of files packed.

    Raises:
        InputError: there is no manifest, a file differs from it, or an attribute of ``OWNERS`` is missing.
    """
    root, attributes = cruise.root, cruise.options.attributes
    if missing := [key for key in OWNERS if not str(attributes.get(key, "")).strip()]:
        keys = "; ".join(f"{key}, {OWNERS[key]}" for key in missing)
        advice = f"add {keys}; then run the cruise again, as its products state them"
        expected = f"the attributes {', '.join(OWNERS)}"
        raise InputError("config/config.yaml: attributes", expected=expected, found=f"no {missing[0]}", advice=advice)
    page = read_manifest(root)
    listed = crate.listed(page)
    rules = {
        f"workflow/{path.relative_to(provenance.WORKFLOW).as_posix()}": path
        for part in ("Snakefile", "rules/*.smk", "scripts/*.py")
        for path in provenance.WORKFLOW.glob(part)
    }
    if (lock := provenance.RELEASE_FILES / crate.LOCK).is_file():
        rules[crate.LOCK] = lock
    rules |= {path.relative_to(root).as_posix(): path for path in crate.record_files(root).values()}
    described = compose(page, attributes, {name: provenance.sha256(path) for name, path in rules.items()}, root)
    texts = {METADATA: json.dumps(described, indent=1, ensure_ascii=False) + "\n"}
    whole = next(x for x in described["@graph"] if x["@id"] == "./")
    texts[README] = ABOUT.format(title=whole["name"])
    cited = describe_datacite(cruise, title=whole["name"], published=whole["datePublished"])
    texts[DATACITE] = json.dumps(cited, indent=1, ensure_ascii=False) + "\n"
    with atomic_write(to) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in texts.items():
            archive.writestr(_entry(name), text)
        for name, path in sorted({**{name: root / name for name in (*listed, crate.FILE)}, **rules}.items()):
            digest = hashlib.sha256()
            with path.open("rb") as source, archive.open(_entry(name), "w", force_zip64=True) as target:
                while block := source.read(BLOCK_BYTES):
                    digest.update(block)
                    target.write(block)
            if listed.get(name, digest.hexdigest()) != digest.hexdigest():
                expected, advice = "the file that the manifest lists", "run the cruise again, then export"
                raise InputError(name, expected=expected, found="another", advice=advice)
    return len(listed) + len(rules) + len(texts) + 1


def describe_superseded(file: Path, configuration: Sequence[str], root: Path) -> dict[str, Any]:
    """Describe the earlier deposit of a mooring: keys of its YAML files that differ, and hashes of its input files.

    Args:
        file: the ZIP file of the deposit.
        configuration: YAML files of the mooring, relative to the cruise folder ``root``.

    Raises:
        InputError: the file is not a deposit.
    """
    new = {name: read(root, name) for name in configuration}
    with open_deposit(file, "correct supersedes in config/config.yaml") as packed:
        manifest, there = _read_entry(packed, crate.FILE, LARGEST_JSON), {*packed.namelist()}
        old = {
            name: parse(_read_entry(packed, name, LARGEST_BYTES), f"{file}: {name}")
            for name in configuration
            if name in there
        }
        for options in (old, new):
            options.get("config/config.yaml", {}).pop("supersedes", None)
        page = json.loads(manifest)
        made_by = {x["name"]: x["softwareVersion"] for x in page["@graph"] if x["@type"] == "SoftwareApplication"}
        return {
            "name": file.name,
            "manifest": hashlib.sha256(manifest).hexdigest(),
            "software": f"compasslib {made_by['compasslib']}",
            "keys": [text for name in old for text in provenance.changed_settings({"": old[name]}, {"": new[name]})]
            + [f"{name} is new" for name in configuration if name not in old],
            "files": {path: x for path, x in crate.listed(page).items() if not path.startswith(f"{crate.FOLDER}/")},
        }


@contextmanager
def open_deposit(file: str | Path, advice: str) -> Iterator[zipfile.ZipFile]:
    """Open the ZIP of a deposit; errors of the block are those of its content.

    Raises:
        InputError: it is not a deposit.
    """
    try:
        if not Path(file).is_file():
            raise ValueError("no file, or a pipe or device")
        with zipfile.ZipFile(file) as packed:
            # zipfile unpacks other methods without a limit of memory; no deposit has them.
            if {entry.compress_type for entry in packed.infolist()} - {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}:
                raise ValueError("files packed by another method than deflate")
            yield packed
    except (*DAMAGE_ERRORS, zipfile.BadZipFile) as error:
        expected, found = "the ZIP of compass export --to rocrate", f"{type(error).__name__}: {error}"
        raise InputError(str(file), expected=expected, found=found, advice=advice) from error


def _read_entry(packed: zipfile.ZipFile, name: str, largest: int) -> bytes:
    with packed.open(name) as stream:
        content = stream.read(largest + 1)
    if len(content) > largest:
        raise ValueError(f"{name} of more than {largest} bytes")
    return content


def compose(page: Mapping[str, Any], attributes: Mapping[str, Any], rules: Mapping[str, str], root: Path) -> Entity:
    """Compose the metadata of the deposit from the manifest.

    Args:
        page: the manifest, whose paths are relative to results/.
        rules: SHA-256 of the workflow's files and of the job records, by path in the deposit.
        root: the cruise folder, whose job records date the end of each job.
    """
    author = str(attributes.get("principal_investigator_orcid", "#principal_investigator"))
    terms, publisher = str(attributes["license"]), str(attributes["publisher_url"])
    owned: Entity = {"license": {"@id": terms if "://" in terms else "#license"}, "author": {"@id": author}}
    software = {"url": str(attributes["software_url"])} if "software_url" in attributes else {}
    entities = _entities_at_root(page, rules, software.get("url"))
    files = [identifier for identifier, entity in entities.items() if entity["@type"] == "File"]
    actions = [entity for entity in entities.values() if entity["@type"] == "CreateAction"]
    run = _describe_run(actions, author, root)
    whole = next(entity for entity in page["@graph"] if entity["@id"] == "./") | owned | {
        "conformsTo": _references(PROFILES), "publisher": {"@id": publisher}, "mainEntity": {"@id": WORKFLOW_FILE},
        "hasPart": _references([*files, README, DATACITE]),
        "mentions": _references([RUN, *(action["@id"] for action in actions)]),
    }  # fmt: skip
    about: Entity = {
        "@id": METADATA, "@type": "CreativeWork", "about": {"@id": "./"},
        "conformsTo": _references(["https://w3id.org/ro/crate/1.1", list(PROFILES)[2]]),
    }  # fmt: skip
    added = [about, whole, SNAKEMAKE, run]
    for name, form in ((README, "text/markdown"), (DATACITE, "application/json")):
        added.append({"@id": name, "@type": "File", "name": name, "encodingFormat": form, "about": {"@id": "./"}})
    person = {"name": str(attributes["principal_investigator"]), "affiliation": {"@id": publisher}}
    added += [
        owned["license"] | {"@type": "CreativeWork", "name": terms},
        {"@id": publisher, "@type": "Organization", "name": str(attributes["institution"]), "url": publisher},
        {"@id": author, "@type": "Person", **person},
        {"@id": BIOSCHEMAS, "@type": "CreativeWork", "name": "Bioschemas ComputationalWorkflow profile"},
    ]
    for profile, (name, version) in PROFILES.items():
        added.append({"@id": profile, "@type": "CreativeWork", "name": name, "version": version})
    entities[WORKFLOW_FILE] |= owned | software | {
        "@type": ["File", "SoftwareSourceCode", "ComputationalWorkflow"], "name": "Correction of compass deviations",
        "programmingLanguage": {"@id": SNAKEMAKE["@id"]}, "version": provenance.software().split(" ", 1)[1],
        "conformsTo": {"@id": BIOSCHEMAS},
    }  # fmt: skip
    return {"@context": crate.CONTEXT, "@graph": [*added, *entities.values()]}


def _entities_at_root(page: Mapping[str, Any], rules: Mapping[str, str], software_url: str | None) -> dict[str, Entity]:
    """Collect the manifest's entities except root and people, and the rules, with paths from the cruise folder."""
    moved = {entity["@id"]: quote(entity["name"]) for entity in page["@graph"] if entity["@type"] == "File"}
    moved |= {f"#{crate.LOCK}": quote(crate.LOCK)}
    given = {"compasslib": software_url}
    for entity in page["@graph"]:  # programs are identified by their URL, where it is known
        if entity["@type"] == "SoftwareApplication" and (url := entity.get("url") or given.get(entity["name"])):
            moved[entity["@id"]] = f"{url}#{quote(str(entity['softwareVersion']))}"
    apart = {"./", METADATA, crate.PROFILE, *(f"#{key}" for _, (key, _) in crate.PEOPLE.items())}
    entities = [_moved(entity, moved) for entity in page["@graph"] if entity["@id"] not in apart]
    for name, digest in rules.items():
        form = "application/json" if name.endswith(".json") else "text/plain"
        entities.append({"@id": quote(name), "@type": "File", "name": name, "sha256": digest, "encodingFormat": form})
    return {entity["@id"]: entity for entity in entities}


def _describe_run(actions: Sequence[Entity], author: str, root: Path) -> Entity:
    """Describe the run of the workflow; add agent and end, by the time of its record, to the action of each job."""
    ends = {
        quote(name): datetime.fromtimestamp(path.stat().st_mtime, UTC).isoformat(timespec="seconds")
        for name, path in crate.record_files(root).items()
    }
    last = max(ends.values(), default=provenance.date_created())
    for action in actions:
        action |= {"agent": {"@id": author}, "endTime": ends.get(action["@id"].removeprefix("#"), last)}
        action.setdefault("description", f"{action['name']}: stopped")
    made = {item for action in actions for item in crate.identifiers(action, "result")}
    read = {item for action in actions for item in crate.identifiers(action, "object")} - made
    return {
        "@id": RUN, "@type": "CreateAction", "name": "Run of the workflow", "instrument": {"@id": WORKFLOW_FILE},
        "description": "All jobs of the workflow; each has an action of its own", "agent": {"@id": author},
        "endTime": last, "object": _references(read), "result": _references(made),
    }  # fmt: skip


def _moved(entity: Any, identifiers: Mapping[str, str]) -> Any:
    """Copy an entity with its identifiers replaced."""
    if isinstance(entity, dict):
        copied = {key: identifiers.get(x, x) if key == "@id" else _moved(x, identifiers) for key, x in entity.items()}
        software = entity.get("@type") == "SoftwareApplication" and copied["@id"].startswith("http")
        return {"url": copied["@id"].partition("#")[0], **copied} if software else copied
    return [_moved(item, identifiers) for item in entity] if isinstance(entity, list) else entity


def _references(identifiers: Iterable[str]) -> list[Entity]:
    return [{"@id": identifier} for identifier in sorted(identifiers)]


def _entry(name: str) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
    entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
    return entry


def describe_datacite(cruise: Cruise, *, title: str, published: str) -> dict[str, Any]:
    """Compose the DataCite metadata of a cruise.

    Args:
        cruise: its attributes must include those that a deposit requires.
        published: date of the results, ISO 8601.
    """
    given = {key: str(value) for key, value in cruise.options.attributes.items()}
    affiliation = [{"name": given["institution"]}]
    creator = {"name": given["principal_investigator"], "nameType": "Personal", "affiliation": affiliation}
    if orcid := given.get("principal_investigator_orcid"):
        scheme = {"nameIdentifierScheme": "ORCID", "schemeUri": "https://orcid.org/"}
        creator["nameIdentifiers"] = [{"nameIdentifier": orcid, **scheme}]
    moorings = {name.partition("/")[0]: mooring for name, mooring in cruise.moorings.items()}
    places = []
    for name, mooring in moorings.items():
        longitude = Site(name, mooring.latitude, mooring.longitude).signed_longitude()
        point = {"pointLatitude": mooring.latitude, "pointLongitude": longitude}
        places.append({"geoLocationPlace": name, "geoLocationPoint": point})
    spans = dict.fromkeys(f"{mooring.start:%Y-%m-%d}/{mooring.end:%Y-%m-%d}" for mooring in moorings.values())
    dates = [{"date": span, "dateType": "Collected"} for span in spans]
    terms, abstract = given["license"], given.get("summary", f"{title}. Processed by {provenance.software()}.")
    method = {"relatedIdentifier": VON_APPEN, "relatedIdentifierType": "DOI", "relationType": "References"}
    described = {
        "schemaVersion": "http://datacite.org/schema/kernel-4",
        "types": {"resourceTypeGeneral": "Dataset", "resourceType": "Moored current records with corrected headings"},
        "titles": [{"title": title}],
        "creators": [creator],
        "publisher": {"name": given["institution"]},
        "publicationYear": published[:4],
        "dates": [*dates, {"date": published, "dateType": "Created"}],
        "rightsList": [{"rights": terms, **({"rightsUri": terms} if "://" in terms else {})}],
        "subjects": [{"subject": "ocean currents"}, {"subject": "compass deviation"}],
        "descriptions": [{"description": abstract, "descriptionType": "Abstract"}],
        "relatedIdentifiers": [method],
        "geoLocations": places,
        "formats": ["application/x-netcdf", "application/json", "text/csv"],
        **({"doi": given["doi"]} if "doi" in given else {}),
    }
    return {key: value for key, value in described.items() if value}
