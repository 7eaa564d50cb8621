"""Pack a cruise as a ZIP file for deposit: a Workflow Run Crate (RO-Crate 1.1) whose root is the cruise folder.

Profile: https://w3id.org/ro/wfrun/workflow/0.5. The ZIP contains the files listed in the manifest, each compared with
its hash while packing; the manifest, by which the unpacked folder can be verified; the rules of the workflow; and the
job records, from which ``compass diff`` finds settings and raw files that changed since.
"""

import base64
import hashlib
import io
import json
import shutil
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from urllib.parse import quote

from compasslib import __version__
from compasslib.archive import crate, provenance
from compasslib.archive.crate import Entity, read_manifest, references
from compasslib.archive.files import atomic_write
from compasslib.config.cruise import Cruise, parse, read
from compasslib.errors import InputError
from compasslib.readers.files import DAMAGE_ERRORS

METADATA, README = "ro-crate-metadata.json", "README.md"
WORKFLOW_FILE, RUN = "workflow/Snakefile", "#run"
PROFILES = {
    "https://w3id.org/ro/wfrun/process/0.5": "Process Run Crate",
    "https://w3id.org/ro/wfrun/workflow/0.5": "Workflow Run Crate",
    "https://w3id.org/workflowhub/workflow-ro-crate/1.0": "Workflow RO-Crate",
}
CRATES = ("https://w3id.org/ro/crate/1.1", list(PROFILES)[2])  # to which the description of the deposit conforms
BIOSCHEMAS = "https://bioschemas.org/profiles/ComputationalWorkflow/1.0-RELEASE"
# Attributes of config.yaml that only the owner of the data can give, with their meaning.
OWNERS = {
    "license": "under which the data may be used, best a URL",
    "institution": "that publishes the data",
    "publisher_url": "its address",
    "principal_investigator": "who answers for the data",
}
SNAKEMAKE = "https://w3id.org/workflowhub/workflow-ro-crate#snakemake"
CONTEXTUAL: tuple[Entity, ...] = (
    {
        "@id": SNAKEMAKE,
        "@type": "ComputerLanguage",
        "name": "Snakemake",
        "identifier": {"@id": "https://doi.org/10.1093/bioinformatics/bty350"},
        "url": {"@id": "https://snakemake.github.io/"},
    },
    {"@id": BIOSCHEMAS, "@type": "CreativeWork", "name": "Bioschemas ComputationalWorkflow profile"},
    *(
        {"@id": profile, "@type": "CreativeWork", "name": name, "version": profile.rsplit("/", 1)[1]}
        for profile, name in PROFILES.items()
    ),
)
ABOUT = """# {title}

Moored current records whose compass was corrected, as one Workflow Run Crate. `results/` holds the products, `config/`
and `raw/` the files they were made from, `ro-crate-metadata.json` the description of all files. The license of the data
is {license}. The software (rules and profiles in `workflow/`, the library `{wheel}`) has its own, `workflow/LICENSE`.

In this folder, with Python 3.11 or later: install the software, compare all files with the manifest, run again, and
compare the results with those of this deposit:

    python3 -m venv .venv && .venv/bin/pip install -r requirements/run.txt && .venv/bin/pip install --no-deps {wheel}
    .venv/bin/compass verify .
    mv results deposited && .venv/bin/compass run .
    .venv/bin/compass diff deposited results
"""
WHEEL = f"compasslib-{__version__}-py3-none-any.whl"


def deposit(cruise: Cruise, to: str | Path) -> int:
    """Pack a processed cruise, if it is as its manifest lists it, and return the number of files packed.

    Raises:
        InputError: there is no manifest, a file differs from it, or an attribute of ``OWNERS`` is missing.
    """
    root, attributes = cruise.root, cruise.options.attributes
    if missing := missing_attributes(attributes):
        keys = "; ".join(f"{key}, {OWNERS[key]}" for key in missing)
        advice = f"add {keys}; then run the cruise again, as its products state them"
        expected = f"the attributes {', '.join(OWNERS)}"
        raise InputError("config/config.yaml: attributes", expected=expected, found=f"no {missing[0]}", advice=advice)
    page = read_manifest(root)
    listed = crate.listed(page)
    wheel, rules = pack_wheel(), workflow_files()
    rules |= {crate.LOCK: provenance.RELEASE_FILES / crate.LOCK}
    rules |= {path.relative_to(root).as_posix(): path for path in (root / crate.FOLDER).glob("**/logs/*.json")}
    earlier = {name: excerpt(root / name) for name in cruise.options.supersedes}
    hashed = {name: provenance.sha256(path) for name, path in rules.items()}
    hashed |= {name: hashlib.sha256(content).hexdigest() for name, content in ({WHEEL: wheel} | earlier).items()}
    described = compose(page, attributes, hashed, root)
    whole = next(x for x in described["@graph"] if x["@id"] == "./")
    texts: dict[str, str | bytes] = {
        **earlier,
        METADATA: json.dumps(described, indent=1, ensure_ascii=False) + "\n",
        README: ABOUT.format(title=whole["name"], license=attributes["license"], wheel=WHEEL),
        WHEEL: wheel,
    }
    with atomic_write(to) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in texts.items():
            archive.writestr(_entry(name), text)
        for name, path in sorted({**{name: root / name for name in (*listed, crate.FILE)}, **rules}.items()):
            if listed.get(name, digest := provenance.sha256(path)) != digest:
                expected, advice = "the file that the manifest lists", "run the cruise again, then export"
                raise InputError(name, expected=expected, found="another", advice=advice)
            with path.open("rb") as source, archive.open(_entry(name), "w", force_zip64=True) as target:
                shutil.copyfileobj(source, target)
    return len(listed) + len(rules) + len(texts) + 1


def missing_attributes(attributes: Mapping[str, Any]) -> list[str]:
    """List the attributes of a cruise that a deposit requires and that are not given."""
    return [key for key in OWNERS if not str(attributes.get(key, "")).strip()]


def workflow_files() -> dict[str, Path]:
    """List the files of the workflow and its license by their paths in a deposit."""
    parts = ("Snakefile", "rules/*.smk", "scripts/*.py", "report/*.rst", "profiles/*/*.yaml")
    paths = [path for part in parts for path in provenance.WORKFLOW.glob(part)]
    named = {f"workflow/{path.relative_to(provenance.WORKFLOW).as_posix()}": path for path in paths}
    return named | {"workflow/LICENSE": provenance.RELEASE_FILES / "LICENSE"}


def pack_wheel() -> bytes:
    """Pack the running library, with its workflow, as a wheel; the dependencies are those of the lock file."""
    packed = [path for path in provenance.PACKAGE.rglob("*") if path.is_file() and "__pycache__" not in path.parts]
    named = {path.relative_to(provenance.PACKAGE.parent).as_posix(): path for path in packed}
    named |= {f"compasslib/{name}": path for name, path in workflow_files().items()}
    release = ("docs/glossary.md", crate.LOCK)
    named |= {f"compasslib/workflow/{name}": provenance.RELEASE_FILES / name for name in release}
    contents = {name: path.read_bytes() for name, path in sorted(named.items())}
    info = f"compasslib-{__version__}.dist-info"
    contents |= {
        f"{info}/METADATA": f"Metadata-Version: 2.1\nName: compasslib\nVersion: {__version__}\n".encode(),
        f"{info}/WHEEL": b"Wheel-Version: 1.0\nGenerator: compasslib\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
        f"{info}/entry_points.txt": b"[console_scripts]\ncompass = compasslib.cli:main\n",
    }
    lines = [f"{info}/RECORD,,"]
    for name, content in contents.items():
        digest = base64.urlsafe_b64encode(hashlib.sha256(content).digest()).decode().rstrip("=")
        lines.append(f"{name},sha256={digest},{len(content)}")
    contents[f"{info}/RECORD"] = "\n".join([*lines, ""]).encode()
    with zipfile.ZipFile(stream := io.BytesIO(), "w") as wheel:
        for name, content in contents.items():
            wheel.writestr(_entry(name), content)
    return stream.getvalue()


def describe_superseded(file: Path, configuration: Sequence[str], root: Path) -> dict[str, Any]:
    """Describe the earlier deposit of a mooring: keys of its YAML files that differ, and hashes of its input files."""
    new = {name: read(root, name) for name in configuration}
    with open_deposit(file, "correct supersedes in config/config.yaml") as packed:
        manifest, there = packed.read(crate.FILE), {*packed.namelist()}
        old = {name: parse(packed.read(name), f"{file}: {name}") for name in configuration if name in there}
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


def excerpt(file: Path) -> bytes:
    """Pack manifest and YAML files of an earlier deposit, by which a run that supersedes it can be repeated."""
    stream, advice = io.BytesIO(), "correct supersedes in config/config.yaml"
    with open_deposit(file, advice) as packed, zipfile.ZipFile(stream, "w") as small:
        for name in packed.namelist():
            if name == crate.FILE or name.startswith("config/"):
                small.writestr(_entry(name), packed.read(name))
    return stream.getvalue()


@contextmanager
def open_deposit(file: str | Path, advice: str) -> Iterator[zipfile.ZipFile]:
    """Open the ZIP of a deposit; errors of the block are those of its content."""
    try:
        with zipfile.ZipFile(file) as packed:
            yield packed
    except (*DAMAGE_ERRORS, zipfile.BadZipFile) as error:
        expected, found = "the ZIP of compass export --to rocrate", f"{type(error).__name__}: {error}"
        raise InputError(str(file), expected=expected, found=found, advice=advice) from error


def compose(page: Mapping[str, Any], attributes: Mapping[str, Any], packed: Mapping[str, str], root: Path) -> Entity:
    """Compose the metadata of a deposit from the manifest, and from SHA-256 by path of what is ``packed`` beside it.

    Args:
        page: the manifest, whose paths are relative to results/.
        packed: SHA-256 of the files of workflow and library and of the job records, by path in the deposit.
        root: the cruise folder, whose job records date the end of each job.
    """
    names = {entity["@id"]: quote(entity["name"]) for entity in page["@graph"] if entity["@type"] == "File"}
    names[f"#{crate.LOCK}"] = quote(crate.LOCK)
    graph = json.loads(
        json.dumps(page["@graph"]),
        object_hook=lambda x: x | {"@id": names.get(x["@id"], x["@id"])} if "@id" in x else x,
    )
    entities: dict[str, Entity] = {entity["@id"]: entity for entity in graph}
    actions = [entity for entity in graph if entity["@type"] == "CreateAction"]
    last = _date_actions(actions, crate.owners(attributes)["author"]["@id"], root)
    for name, digest in packed.items():
        own = crate.OWN if name.startswith("workflow/") or name == WHEEL else {}
        suffix = Path(name).suffix
        form = {".json": "application/json", ".whl": "application/zip", ".zip": "application/zip"}.get(
            suffix, "text/plain"
        )
        about: Entity = {"@id": quote(name), "@type": "File", "name": name, "sha256": digest, "encodingFormat": form}
        entities[quote(name)] = about | own
    url = {"url": str(attributes["software_url"])} if "software_url" in attributes else {}
    entities[WORKFLOW_FILE] |= url | {
        "@type": ["File", "SoftwareSourceCode", "ComputationalWorkflow"], "name": "Correction of compass deviations",
        "programmingLanguage": {"@id": SNAKEMAKE}, "version": provenance.software().split(" ", 1)[1],
        "conformsTo": {"@id": BIOSCHEMAS},
    }  # fmt: skip
    about = {"name": README, "encodingFormat": "text/markdown", "about": {"@id": "./"}}
    entities[README] = {"@id": README, "@type": "File"} | about
    files = [identifier for identifier, entity in entities.items() if "File" in entity["@type"]]
    made = {item for action in actions for item in crate.identifiers(action, "result")}
    read = {item for action in actions for item in crate.identifiers(action, "object")} - made
    run = {
        "@id": RUN, "@type": "CreateAction", "name": "Run of the workflow", "instrument": {"@id": WORKFLOW_FILE},
        "description": "All jobs of the workflow; each has an action of its own", **last,
        "object": references(sorted(read)), "result": references(sorted(made)),
    }  # fmt: skip
    entities["./"] |= {
        "conformsTo": references(PROFILES), "mainEntity": {"@id": WORKFLOW_FILE},
        "hasPart": references(sorted(files)),
        "mentions": [{"@id": RUN}, *entities["./"]["mentions"]],
    }  # fmt: skip
    entities[METADATA]["conformsTo"] = references(CRATES)
    entities |= {entity["@id"]: entity for entity in (run, *CONTEXTUAL)}
    return {"@context": crate.CONTEXT, "@graph": list(entities.values())}


def _date_actions(actions: Sequence[Entity], author: str, root: Path) -> Entity:
    """Add agent and end, by the time of its record, to the action of each job, and return those of the last one."""
    records = list((root / crate.FOLDER).glob("**/logs/*.json"))
    dates = [datetime.fromtimestamp(path.stat().st_mtime, UTC).isoformat(timespec="seconds") for path in records]
    ends = {f"#{quote(crate.job_name(path.relative_to(root)))}": d for path, d in zip(records, dates, strict=True)}
    last = {"agent": {"@id": author}, "endTime": max(dates, default=provenance.date_created())}
    for action in actions:
        action |= last | {"endTime": ends.get(action["@id"], last["endTime"])}
        action.setdefault("description", f"{action['name']}: stopped")
    return last


def _entry(name: str) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
    entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
    return entry
