"""Hashes of files, published before the truth is unsealed and compared afterwards; and of the code of a scorecard.

From the latter the seed is derived, which anyone can reproduce.
"""

from __future__ import annotations

import ast
import hashlib
import json
import subprocess
import tarfile
from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

PROJECT = Path(__file__).resolve().parents[2]
ENGINE = ("statistics", "preparation", "effects", "deviation", "inference")  # packages that determine a scorecard
SEALED = Path("benchmarks/proof/world/families.py")
CARDS = PROJECT / "docs/proof"
DIGITS = 12  # printed digits of a hash
# The engine, by the first digits of its hash, of which an earlier one differs only in what no result depends on; the
# results of the earlier one stand.
# Other since then: only the page of the catalogue.
SAME_RESULTS = {"c5494c6920c9": "ff500f77939f"}

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


def engine(project: Path = PROJECT) -> str:
    """Compute one hash of all statements of the engine, without comments and docstrings."""
    folder = project / "compasslib"
    files = [*folder.glob("*.py"), *(path for room in ENGINE for path in (folder / room).rglob("*.py"))]
    code = {str(path.relative_to(folder)): statements(path.read_text()) for path in files}
    return whole({name: hashlib.sha256(each.encode()).hexdigest() for name, each in code.items()})


def is_older(measured: str) -> bool:
    """Return whether results were measured by an engine that may give others than that of this checkout."""
    present = engine()
    return measured != present and SAME_RESULTS.get(present[:DIGITS]) != measured[:DIGITS]


def families(project: Path = PROJECT) -> str:
    """Compute the hash of the families of effects and compare it with the sealed one.

    Raises:
        Broken: if they differ.
    """
    expected = (project / "benchmarks/proof/families.sha256").read_text().split()[0]
    found = hashlib.sha256((project / SEALED).read_bytes()).hexdigest()
    if found != expected:
        raise Broken(f"{SEALED} is not what families.sha256 sealed")
    return expected


def commit(revision: str = "HEAD") -> str:
    """Look up the hash of a commit.

    Raises:
        Broken: if this is not a checkout, or has no such commit.
    """
    ran = _git("rev-parse", "--verify", "--quiet", f"{revision}^{{commit}}")
    if ran.returncode:
        raise Broken(f"{revision} is no commit of this checkout; give --seed instead")
    return ran.stdout.strip()


def check_out(revision: str) -> None:
    """Check that the engine of this checkout is that of a commit.

    Raises:
        Broken: if they differ.
    """
    with TemporaryDirectory() as folder:
        archive = Path(folder) / "compasslib.tar"
        _git("archive", f"--output={archive}", commit(revision), "compasslib")
        with tarfile.open(archive) as kept:
            kept.extractall(folder, filter="data")
        if is_older(engine(Path(folder))):
            raise Broken(f"the engine is not that of {revision}: check it out, or give --seed instead")


def seed(revision: str = "HEAD") -> int:
    """Derive the seed from a commit and the sealed families, so that it is not chosen."""
    return int(hashlib.sha256(f"{commit(revision)}\n{families()}\n".encode()).hexdigest()[:8], 16)


def explained(revision: str) -> str:
    """Describe the derivation of the seed of a commit, to reproduce it."""
    return "\n".join(
        [
            f"commit   {commit(revision)}",
            f"families {families()}  (sha256 of {SEALED}, published before the code was frozen)",
            "seed     the first 8 hexadecimal digits of the sha256 of both, each with an end of line:",
            f'         printf "%s\\n" {commit(revision)} {families()} | sha256sum',
            f"         {seed(revision)}",
        ]
    )


def cards() -> list[str]:
    """Compose one sentence on the engine of each published scorecard, newest first."""
    told = []
    for path in sorted(CARDS.glob("*/scorecard.json"), key=lambda each: each.parent.name, reverse=True):
        own = json.loads(path.read_text())["seal"].get("engine", "")
        name = path.parent.name
        if is_older(own):
            told.append(f"{name}: of an older engine ({own[:DIGITS]}); it has not been made anew since.")
        elif own == engine():
            told.append(f"{name}: of this engine ({own[:DIGITS]}).")
        else:
            told.append(f"{name}: of an engine that differs only where it ended in an error ({own[:DIGITS]}).")
    return told


def _git(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["git", "-C", str(PROJECT), *arguments], capture_output=True, text=True, check=False)
