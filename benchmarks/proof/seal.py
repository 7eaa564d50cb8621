"""Hashes of files, published before the truth is unsealed and compared afterwards; a seed that nobody chose."""

import hashlib
import json
import subprocess
from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[2]
FAMILIES = "benchmarks/proof/world/families.py"
TRUTH_CHANGED = "the truth is not the one that was sealed before the run"
RESULTS_CHANGED = "a result is not the one that the pipeline left"


class Broken(Exception):
    """A file that does not have its published hash."""


def sha256(content: bytes) -> str:
    """Compute the hash of bytes, as hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()


def publish(path: Path, folder: Path, files: Iterable[Path], **said: object) -> None:
    """Write the hashes of files and one hash of these, for publication, with metadata."""
    parts = {str(file.relative_to(folder)): sha256(file.read_bytes()) for file in sorted(files)}
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({**said, "sha256": _whole(parts), "files": parts}, indent=1) + "\n")


def check(path: Path, folder: Path, why: str) -> None:
    """Compare files with their published hashes.

    Raises:
        Broken: if a file is absent or differs, or the list itself was changed.
    """
    published = json.loads(path.read_text())
    changed = [
        name
        for name, expected in published["files"].items()
        if not (folder / name).is_file() or sha256((folder / name).read_bytes()) != expected
    ]
    if changed or _whole(published["files"]) != published["sha256"]:
        raise Broken(f"{why}: {', '.join(changed) or 'the list itself'} ({path.name})")


def _whole(parts: dict[str, str]) -> str:
    return sha256("".join(f"{name} {code}\n" for name, code in sorted(parts.items())).encode())


def families() -> str:
    """Compute the hash of the families of effects; ``Broken`` if it is not the sealed one."""
    expected = (PROJECT / "benchmarks/proof/families.sha256").read_text().split()[0]
    if sha256((PROJECT / FAMILIES).read_bytes()) != expected:
        raise Broken(f"{FAMILIES} is not what families.sha256 sealed")
    return expected


def commit(revision: str = "HEAD") -> str:
    """Look up the hash of a commit; ``Broken`` if this is not a checkout, or has no such commit."""
    ran = _git("rev-parse", "--verify", "--quiet", f"{revision}^{{commit}}")
    if ran.returncode:
        raise Broken(f"{revision} is no commit here: run it in a clone of the repository")
    return ran.stdout.strip()


def source(command: str, files: Iterable[Path]) -> dict[str, object]:
    """Describe a stored result: its command, commit and date, and the beginning of the hash of each file of data."""
    hashes = [sha256(file.read_bytes())[:12] for file in files]
    return {"command": command, "commit": commit()[:12], "date": f"{datetime.now(UTC):%Y-%m-%d}", "sha256": hashes}


def seed(revision: str) -> int:
    """Derive the seed from a commit and the sealed families; ``Broken`` if the library is not that of the commit.

    As ``printf "%s\\n" COMMIT FAMILIES | sha256sum`` shows, whose first eight digits are the seed.
    """
    if _git("diff", "--quiet", commit(revision), "--", "compasslib").returncode:
        raise Broken(f"the library is not that of {revision}: check it out, or give --seed instead")
    return int(sha256(f"{commit(revision)}\n{families()}\n".encode())[:8], 16)


def _git(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["git", "-C", str(PROJECT), *arguments], capture_output=True, text=True, check=False)
