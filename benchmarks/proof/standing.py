"""Hashes of files, published before the truth is unsealed and compared afterwards.

The seed is derived from a commit, so that anyone can reproduce it.
"""

from __future__ import annotations

import hashlib
import json
import subprocess
from collections.abc import Iterable
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[2]
SEALED = Path("benchmarks/proof/world/families.py")
DIGITS = 12  # printed digits of a hash
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
    """Check that the library of this checkout is that of a commit.

    Raises:
        Broken: if they differ.
    """
    if _git("diff", "--quiet", commit(revision), "--", "compasslib").returncode:
        raise Broken(f"the library is not that of {revision}: check it out, or give --seed instead")


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


def _git(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["git", "-C", str(PROJECT), *arguments], capture_output=True, text=True, check=False)
