"""Simulate the raw files of one mooring of the demonstration cruise."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from compasslib.archive import provenance
from compasslib.archive.files import HALF_WRITTEN, PLANNED, write_json
from compasslib.demo import concealed, demonstration
from compasslib.errors import InputError


def simulate(*, raw: Sequence[str], truth: str, name: str, seed: int, say: Callable[[str], None]) -> None:
    """Write the raw files of a mooring, and the truth to a separate file.

    Raises:
        InputError: the simulation does not write one of the files.
    """
    world = concealed if name in concealed.CASES else demonstration
    with put(name, [*raw, truth]) as folder:
        world.write_mooring(name, folder / "raw", folder / truth, seed)
    say(f"{name}: simulated raw files written; the truth stands apart in {truth}")


@contextmanager
def put(name: str, files: Sequence[str]) -> Iterator[Path]:
    """Yield a folder to simulate into; ``files`` are moved from there to the cruise once the block has succeeded.

    Their hashes are recorded before, so that they are known to be simulated even if the job is killed meanwhile.
    """
    folder = Path("raw", f".{name}{HALF_WRITTEN}")
    shutil.rmtree(folder, ignore_errors=True)  # left by a killed job; links are not followed
    try:
        yield folder
        for file in files:
            if not (folder / file).is_file():
                advice = "name the files as the simulation does"
                found = "one that it does not write"
                raise InputError(file, expected=f"a raw file of the simulation of {name}", found=found, advice=advice)
        made = {file: provenance.sha256(folder / file) for file in files}
        write_json(PLANNED / f"{name}.json", {"wrote": made})
        for file in files:
            Path(file).parent.mkdir(parents=True, exist_ok=True)
            os.replace(folder / file, file)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
