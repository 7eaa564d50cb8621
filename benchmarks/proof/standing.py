"""Hashes of the code of a scorecard, and derivation of its seed, both reproducible by anyone."""

from __future__ import annotations

import hashlib
import json
import subprocess
from pathlib import Path

from benchmarks.proof import seal

PROJECT = Path(__file__).resolve().parents[2]
ENGINE = ("statistics", "preparation", "effects", "deviation", "inference")  # packages that determine a scorecard
SEALED = Path("benchmarks/proof/world/families.py")
CARDS = PROJECT / "docs/proof"
DIGITS = 12  # printed digits of a hash


def engine(project: Path = PROJECT) -> str:
    """Compute one hash of all statements of the engine, without comments and docstrings."""
    folder = project / "compasslib"
    files = [*folder.glob("*.py"), *(path for room in ENGINE for path in (folder / room).rglob("*.py"))]
    code = {str(path.relative_to(folder)): seal.statements(path.read_text()) for path in files}
    return seal.whole({name: hashlib.sha256(each.encode()).hexdigest() for name, each in code.items()})


def families(project: Path = PROJECT) -> str:
    """Compute the hash of the families of effects and compare it with the sealed one.

    Raises:
        seal.Broken: if they differ.
    """
    expected = (project / "benchmarks/proof/families.sha256").read_text().split()[0]
    found = hashlib.sha256((project / SEALED).read_bytes()).hexdigest()
    if found != expected:
        raise seal.Broken(f"{SEALED} is not what families.sha256 sealed")
    return expected


def commit(revision: str = "HEAD") -> str:
    """Look up the hash of a commit.

    Raises:
        seal.Broken: if this is not a checkout, or has no such commit.
    """
    ran = _git("rev-parse", "--verify", "--quiet", f"{revision}^{{commit}}")
    if ran.returncode:
        raise seal.Broken(f"{revision} is no commit of this checkout; give --seed instead")
    return ran.stdout.strip()


def check_out(revision: str) -> None:
    """Check that the engine of this checkout is that of a commit.

    Raises:
        seal.Broken: if they differ.
    """
    rooms = [":(glob)compasslib/*.py", *(f"compasslib/{room}" for room in ENGINE)]
    if _git("diff", "--quiet", commit(revision), "--", *rooms).returncode:
        raise seal.Broken(f"the engine is not that of {revision}: check it out, or give --seed instead")


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
        if own == engine():
            told.append(f"{name}: of this engine ({own[:DIGITS]}).")
        elif own:
            told.append(f"{name}: of an older engine ({own[:DIGITS]}); it has not been made anew since.")
        else:
            told.append(f"{name}: of an older engine, and of the world that the search was built on.")
    return told


def _git(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["git", "-C", str(PROJECT), *arguments], capture_output=True, text=True, check=False)
