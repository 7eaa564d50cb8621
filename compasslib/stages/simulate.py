"""Simulate the raw files of the demonstration cruise, and never write over measured ones."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from compasslib.archive import provenance
from compasslib.archive.files import HALF_WRITTEN, write_json
from compasslib.config.cruise import Cruise
from compasslib.errors import InputError
from compasslib.stages.settings import CONCEALED

PLANNED = Path(".snakemake/compasslib.simulated")  # files that simulations are about to move into place, by mooring


def simulate(*, raw: Sequence[str], truth: str, name: str, seed: int, say: Callable[[str], None]) -> None:
    """Write the raw files of a mooring, and the truth to a separate file.

    Raises:
        InputError: the simulation does not write one of the files.
    """
    from compasslib.demo import concealed, demonstration  # deferred, as the Snakefile imports this module

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
        if missing := [file for file in files if not (folder / file).is_file()]:
            advice, actual = "name the files as the simulation does", "one that it does not write"
            expected = f"a raw file of the simulation of {name}"
            raise InputError(missing[0], expected=expected, found=actual, advice=advice)
        write_json(PLANNED / f"{name}.json", {"wrote": {file: provenance.sha256(folder / file) for file in files}})
        for file in files:
            Path(file).parent.mkdir(parents=True, exist_ok=True)
            os.replace(folder / file, file)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def truth_file(name: str) -> str:
    """Return the path of the truth of a simulated mooring, which no stage reads but ``concealed``."""
    return f"concealed/{name}.json" if name in CONCEALED else f"truth/{name}.csv"


def to_simulate(cruise: Cruise, warn: Callable[[str], object] = print, *, check: bool = True) -> dict[str, list[str]]:
    """List the raw files of each demonstration mooring that a rule may write; none for any other cruise.

    A mooring is left out if its files all exist and are not provably the simulation's: they are used as raw files.

    Args:
        check: whether the files are looked at, as once at the start of a run.

    Raises:
        InputError: some files of a mooring are missing and others are not the simulation's.
    """
    ours: dict[str, list[str]] = {}
    for name, mooring in cruise.moorings.items() if cruise.options.demonstration else ():
        files = [file for each in mooring.instruments.values() for file in (*each.files, *each.pressure_files)]
        made = simulated(name) if check else set()
        present = [file for file in (*files, truth_file(name)) if check and os.path.lexists(file)]
        foreign = [file for file in present if os.path.islink(file) or (file, provenance.sha256(file)) not in made]
        if foreign and (missing := [file for file in files if not os.path.isfile(file)]):
            actual = f"a file or link that is there already, while {missing[0]} is missing"
            advice = "measured files are never written over: add the missing one, or delete demonstration: true"
            raise InputError(foreign[0], expected="what the simulation wrote, or nothing", found=actual, advice=advice)
        if foreign:
            warn(f"{name}: raw files used as they stand: no record says that the simulation wrote them")
        else:
            ours[name] = files
    return ours


def simulated(name: str) -> set[tuple[str, str]]:
    """Collect paths and SHA-256 of the files that the simulation of one mooring has on record as its own."""
    wrote = set[tuple[str, str]]()
    for path in (Path(f"results/{name}/logs/simulate.json"), PLANNED / f"{name}.json"):
        with suppress(OSError, ValueError, TypeError, KeyError):
            wrote |= set(dict(json.loads(path.read_bytes())["wrote"]).items())
    return wrote
