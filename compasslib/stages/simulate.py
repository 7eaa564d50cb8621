"""Simulate one mooring of the demonstration cruise, as its instruments would have left it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from compasslib.run import simulated
from compasslib.simulation import demonstration


def run(*, raw: Sequence[str], truth: str, name: str, seed: int, say: Callable[[str], None]) -> None:
    """Write the raw files, and the truth apart from them.

    Raises:
        InputError: the simulation does not write one of the files.
    """
    with simulated.put(name, [*raw, truth]) as folder:
        demonstration.write_mooring(name, folder / "raw", folder / truth, seed)
    say(f"{name}: simulated raw files written; the truth stands apart in {truth}")
