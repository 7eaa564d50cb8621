"""Provenance of results: input files and their hashes, this software, and the time of processing."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from compasslib import __version__, plugins
from compasslib.errors import InputError

if TYPE_CHECKING:  # the Snakefile imports this module and should not import numpy
    from compasslib.inference.product import CorrectionModel
    from compasslib.records import EarthField

PACKAGE: Path = Path(__file__).resolve().parents[1]
PROJECT: Path = PACKAGE.parent
CHECKOUT = (PROJECT / "workflow/Snakefile").is_file()
WORKFLOW: Path = PROJECT / "workflow" if CHECKOUT else PACKAGE / "workflow"  # in a wheel it also has lock and glossary
RELEASE_FILES: Path = PROJECT if CHECKOUT else WORKFLOW
TIMES = ("start_s", "end_s", "exclude")  # settings of a job that are in seconds since 1970


@cache  # once per process: later edits are ignored
def library() -> str:
    """Hash this library, its workflow, and the packages that add readers or effects, wherever they are installed."""
    inside = [path for path in PACKAGE.rglob("*") if path.is_file() and path.suffix not in (".pyc", ".pyo")]
    files = {path.relative_to(PACKAGE): path for path in inside if "workflow" not in path.relative_to(PACKAGE).parts}
    rules = [*WORKFLOW.glob("Snakefile"), *WORKFLOW.glob("rules/*.smk"), *WORKFLOW.glob("scripts/*.py")]
    files |= {Path("workflow", path.relative_to(WORKFLOW)): path for path in rules}
    lines = [f"{sha256(path)}  {name.as_posix()}" for name, path in sorted(files.items())]
    others = (
        plugins.code_identity(each)
        for group in (plugins.READERS, plugins.EFFECTS)
        for each in plugins.declared_plugins(group)
    )
    return hashlib.sha256("\n".join([*lines, *others]).encode()).hexdigest()[:16]


@cache  # outside a checkout it hashes all modules
def software() -> str:
    """Identify this software, with plug-ins, by version and commit, or by the hash of its modules without a commit."""
    status = _git("status", "--porcelain=v2", "--branch", "--", "compasslib", "workflow", "Snakefile")
    lines = (status or "").splitlines()
    commit = "".join(line.split()[2][:12] for line in lines if line.startswith("# branch.oid") and "(" not in line)
    unknown = "no checkout" if status is None else "commit unknown"
    edited = "" if all(line.startswith("#") for line in lines) else ", edited since"
    if not commit:
        commit, edited = f"{unknown}, modules sha256 {library()[:12]}", ""
    state = f"{commit}{edited}"
    others = ", ".join(plugins.plugin_packages())
    return f"compasslib {__version__} ({state})" + (f" with {others}" if others else "")


def date_created() -> str:
    """Return the time of processing in ISO 8601: SOURCE_DATE_EPOCH, for reproducible output, or else the clock.

    Raises:
        InputError: SOURCE_DATE_EPOCH is not a number of seconds.
    """
    epoch = os.environ.get("SOURCE_DATE_EPOCH")
    try:
        made = datetime.fromtimestamp(int(epoch), UTC) if epoch else datetime.now(UTC)
        return made.strftime("%Y-%m-%dT%H:%M:%SZ")
    except (ValueError, OverflowError, OSError):
        expected, advice = "whole seconds since 1970", "unset it, and the date is the time of processing"
        raise InputError("SOURCE_DATE_EPOCH", expected=expected, found=repr(epoch), advice=advice) from None


def sha256(path: str | Path) -> str:
    """Compute the SHA-256 of a file, hexadecimal."""
    with Path(path).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def hashes(paths: Iterable[str]) -> dict[str, str]:
    """Compute the SHA-256 of several files, by path."""
    return {str(path): sha256(path) for path in paths}


def origin(what: str, sources: Mapping[str, str], superseded: Mapping[str, Any] | None = None) -> dict[str, str]:
    """Compose the attributes that state the provenance of a netCDF file.

    Args:
        sources: SHA-256 of the files that it was made from, by the names to be stated.
        superseded: the earlier deposit, as returned by ``deposit.describe_superseded``.
    """
    made, by = date_created(), software()
    listed = ", ".join(f"{name} (sha256 {known})" for name, known in sources.items())
    history, changes = f"{made}: {what} by {by} from {listed}", {}
    if superseded:
        earlier = superseded["files"]
        changed = [
            f"{name} {'changed' if earlier.get(name) else 'is new'}"
            for name, known in sources.items()
            if known != earlier.get(name)
        ]
        changed += [f"software was {superseded['software']}"] if superseded["software"] != by else []
        since = f"since {superseded['name']}: {'; '.join([*superseded['keys'], *changed]) or 'nothing changed'}"
        history += f"\n{made}: {since} (manifest sha256 {superseded['manifest']})"
        changes = {"product_version": f"{by}; {since}"}
    return changes | {
        "software_version": by,
        "source_files": ", ".join(sources),
        "history": history,
        "date_created": made,
    }


def processing(
    product: CorrectionModel,
    field: EarthField,
    sources: Mapping[str, str],
    superseded: Mapping[str, Any] | None = None,
    by_hand: Sequence[str] = (),
) -> dict[str, Any]:
    """Compose the attributes that describe how and when a record was corrected.

    Args:
        field: the earth's field, for the source of its declination.
        sources: SHA-256 of the raw files, by path relative to the cruise folder.
        superseded: the earlier deposit, as for ``origin``.
        by_hand: descriptions of the flags that a person gave.
    """
    suffix = f" with {', '.join(product.effects)}" if product.effects else ""
    suffix += f" fitted jointly with {', '.join(product.accounted)}" if product.accounted else ""
    made = origin(f"headings corrected, method {product.fit.method}{suffix},", sources, superseded)
    made["history"] += "".join(f"\n{made['date_created']}: velocities of {given}" for given in by_hand)
    return made | {
        "method": product.fit.method,
        "effects": ", ".join(product.effects),
        "coefficients": json.dumps(product.fit.to_json()["coefficients"]),
        "declination_source": field.source,
    }


def changed_settings(before: Mapping[str, Any], after: Mapping[str, Any]) -> list[str]:
    """List the settings of a job, or keys of a YAML file, that differ, without the outermost key, with both values."""
    left, right = (dict(_leaves(json.loads(json.dumps(side, default=str)))) for side in (before, after))
    keys = [key for key in dict.fromkeys((*left, *right)) if left.get(key) != right.get(key)]
    was, now = ({key: _short(side[key]) if key in side else "absent" for key in keys} for side in (left, right))
    return [f"{key} was {was[key]}, is {now[key]}" for key in keys]


def _leaves(value: Any, *keys: str) -> Iterator[tuple[str, Any]]:
    """Yield each value with its dotted key, seconds since 1970 as dates."""
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from _leaves(inner, *keys, name)
    else:
        key, dated = ".".join(keys[1:] or keys), keys[-1] in TIMES
        yield (key.removesuffix("_s"), _dated(value)) if dated else (key, value)


def _dated(seconds: Any) -> Any:
    """Convert seconds since 1970, or nested lists of them, to ISO 8601; dates of a YAML file are texts already."""
    if isinstance(seconds, list):
        return [_dated(each) for each in seconds]
    if not isinstance(seconds, float):
        return seconds
    return datetime.fromtimestamp(seconds, UTC).isoformat().replace("+00:00", "Z")


def _short(value: Any, longest: int = 60) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= longest else f"{text[: longest - 3]}..."


@cache
def _git(*arguments: str) -> str | None:
    """Return the output of git for this project; None outside a checkout, empty where git cannot be run."""
    if not (PROJECT / ".git").exists():
        return None
    # git refuses a checkout of another user, whose settings may start programs; its Python code runs already anyway.
    # Optional locks are off, so that parallel jobs do not wait for each other's index.
    command = ["git", "-c", f"safe.directory={PROJECT}", "--no-optional-locks", "-C", str(PROJECT), *arguments]
    # Below another repository, git would describe that one if its own is broken.
    environment = os.environ | {"GIT_CEILING_DIRECTORIES": str(PROJECT.parent), "LC_ALL": "C"}
    try:
        return subprocess.run(command, capture_output=True, text=True, check=False, env=environment).stdout.strip()
    except OSError:
        return ""
