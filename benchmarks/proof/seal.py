"""Hashes that are published before the truth is unsealed, and compared with the files afterwards."""

from __future__ import annotations

import ast
import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

TRUTH_CHANGED = "the truth is not the one that was sealed before the run"
RESULTS_CHANGED = "a result is not the one that the pipeline left"


class Broken(Exception):
    """A file that does not have its published hash."""


def hashes(folder: Path, files: Iterable[Path]) -> dict[str, str]:
    """Compute the SHA-256 of files by their path relative to a folder, in the order of the paths."""
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(files)}


def whole(parts: dict[str, str]) -> str:
    """Compute one hash of many."""
    return hashlib.sha256("".join(f"{name} {code}\n" for name, code in sorted(parts.items())).encode()).hexdigest()


def statements(text: str) -> str:
    """Represent the statements of a Python file as text, without comments and docstrings."""
    tree = ast.parse(text)
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            node.body = [one for one in body if not (isinstance(one, ast.Expr) and isinstance(one.value, ast.Constant))]
    return repr(_content(tree))


def _content(node: Any) -> Any:
    """Convert a syntax tree to lists without empty fields, as newer versions of Python add some."""
    if isinstance(node, ast.AST):
        fields = [(name, _content(value)) for name, value in ast.iter_fields(node)]
        return [type(node).__name__, *((name, value) for name, value in fields if value not in (None, []))]
    return [_content(part) for part in node] if isinstance(node, list) else node


def publish(path: Path, folder: Path, files: Iterable[Path], **said: object) -> None:
    """Write the hashes of files for publication, with metadata."""
    parts = hashes(folder, files)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({**said, "sha256": whole(parts), "files": parts}, indent=1) + "\n")


def check(path: Path, folder: Path, why: str) -> None:
    """Compare files with their published hashes.

    Raises:
        Broken: if a file is absent or differs, or the list itself was changed.
    """
    published = json.loads(path.read_text())
    expected = published["files"]
    absent = [name for name in expected if not (folder / name).is_file()]
    found = {} if absent else hashes(folder, (folder / name for name in expected))
    changed = absent or [name for name in expected if found[name] != expected[name]]
    if changed:
        raise Broken(f"{why}: {', '.join(changed)} ({path.name})")
    if whole(expected) != published["sha256"]:
        raise Broken(f"{why}: the list in {path.name} does not give its own hash")
