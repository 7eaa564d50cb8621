"""What a result was made from: the modules behind a script, versions, the date that is not the wall clock."""

from __future__ import annotations

import ast
import json
import os
import subprocess
from collections.abc import Sequence
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from compasslib import __version__

if TYPE_CHECKING:  # the Snakefile imports this room and needs no numbers
    from compasslib.discrepancy.product import Product
    from compasslib.records import EarthField

PROJECT = Path(__file__).resolve().parent.parent


def sources(script: str | Path, *others: str | Path) -> list[str]:
    """Return the files of compasslib that a script uses, followed through all imports.

    Snakemake re-runs a job whose script changed, not one whose library changed; these files are therefore among the
    inputs of each rule, so that an edit re-runs what it touches and nothing else.

    Args:
        script: a Python file.
        others: modules that it imports by name only when it runs, relative to the project.
    """
    waiting = [Path(script), *(PROJECT / other for other in others)]
    seen: set[Path] = {PROJECT / other for other in others}
    while waiting:
        new = _imported(waiting.pop()) - seen
        seen |= new
        waiting.extend(new)
    return sorted(str(path) for path in seen)


@cache
def _imported(path: Path) -> frozenset[Path]:
    """Return the house's files that one file imports, packages' own files included."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return frozenset(file for name in names if name.startswith("compasslib") for file in _files(name))


def _files(name: str) -> list[Path]:
    """Return the file of a module and those of the packages above it."""
    parts = name.split(".")
    stems = [PROJECT.joinpath(*parts[:k]) for k in range(1, len(parts) + 1)]
    candidates = [stem / "__init__.py" for stem in stems] + [stems[-1].with_suffix(".py")]
    return [path for path in candidates if path.is_file()]


def software() -> str:
    """Return name and version of this software, with the commit where it runs from a checkout."""
    commit = _git("rev-parse", "--short=12", "HEAD")
    return f"compasslib {__version__}" + (f" ({commit})" if commit else "")


def date_created() -> str:
    """Return the date that products carry: SOURCE_DATE_EPOCH, else the commit's, else the first day of 1970.

    The wall clock is never asked, so that the same input gives the same bytes.
    """
    epoch = os.environ.get("SOURCE_DATE_EPOCH") or _git("log", "-1", "--format=%ct") or "0"
    return datetime.fromtimestamp(int(epoch), UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def processing(product: Product, field: EarthField, raw_files: Sequence[str]) -> dict[str, Any]:
    """Return how and when a record was corrected, for the archive's attributes.

    Args:
        product: the compass that corrected it.
        field: the declination that was used.
        raw_files: what was read, relative to the cruise folder.
    """
    made, by, method = date_created(), software(), product.fit.method
    beside = f" with {', '.join(product.effects)}" if product.effects else ""
    return {
        "method": method,
        "effects": ", ".join(product.effects),
        "coefficients": json.dumps(product.fit.to_json()["coefficients"]),
        "declination_source": field.source,
        "software_version": by,
        "source_files": ", ".join(raw_files),
        "history": f"{made}: headings corrected by {by}, method {method}{beside}, from {', '.join(raw_files)}",
        "date_created": made,
    }


def stamp(raw_files: Sequence[str]) -> dict[str, Any]:
    """Return what a calibration was made from, and by what.

    Args:
        raw_files: what was read, relative to the cruise folder.
    """
    return {"source_files": list(raw_files), "software": software(), "date_created": date_created()}


def _git(*arguments: str) -> str:
    try:
        found = subprocess.run(["git", "-C", str(PROJECT), *arguments], capture_output=True, text=True, check=False)
    except OSError:
        return ""
    return found.stdout.strip()
