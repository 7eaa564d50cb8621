"""Is an archive what its manifest says? ``python -m compasslib.archive.verification CRUISE`` exits 1 where not."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from compasslib.archive import crate, provenance
from compasslib.archive.files import read_json
from compasslib.core.errors import InputError


def differences(cruise: str | Path) -> list[str]:
    """Return what differs from the manifest, a line a file: changed, missing, or new beside files that jobs wrote.

    Args:
        cruise: folder of the cruise; nothing in it is written to.

    Raises:
        InputError: there is no manifest, or it is none.
    """
    root = Path(cruise)
    page = _manifest(root)
    known = crate.listed(page)
    found = [line for path, listed in known.items() if (line := _difference(root, path, listed))]
    folders = sorted({(root / path).parent for path in crate.written(page)})
    beside = {file for folder in folders if folder.is_dir() for file in folder.iterdir() if file.is_file()}
    new = sorted({file.relative_to(root).as_posix() for file in beside} - {*known, crate.FILE})
    return found + [f"new: {path}" for path in new]


def verify(cruise: str | Path, say: Callable[[str], None]) -> None:
    """Say what differs from the manifest, or that nothing does.

    Raises:
        InputError: something differs, or there is no manifest.
    """
    found = differences(cruise)
    for line in found:
        say(line)
    files = f"{len(crate.listed(_manifest(Path(cruise))))} files as listed"
    if found:
        advice = "restore them, or make run again if the change was meant"
        raise InputError(crate.FILE, expected=files, found=f"{len(found)} that differ", advice=advice)
    say(f"{crate.FILE}: {files}")


def _manifest(root: Path) -> dict[str, Any]:
    page: dict[str, Any] = read_json(root / crate.FILE)
    try:
        crate.listed(page), crate.written(page)
    except (KeyError, TypeError) as error:
        advice = "make run writes it"
        raise InputError(str(root / crate.FILE), expected="a manifest", found=repr(error), advice=advice) from None
    return page


def _difference(root: Path, path: str, listed: str) -> str:
    if not (root / path).is_file():
        return f"missing: {path}"
    found = provenance.sha256(root / path)
    return "" if found == listed else f"changed: {path} (sha256 {found[:12]}, listed {listed[:12]})"


def main() -> None:
    """Verify the cruise that the command line names."""
    try:
        verify(sys.argv[1] if len(sys.argv) > 1 else ".", print)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(1)


if __name__ == "__main__":
    main()
