"""How far does the overlap of a mooring walk through its diagnosis? Counted while one is diagnosed.

    python benchmarks/walk.py M1 --cruise my_cruise --into /tmp/walk      as ``compass correct``
    PYTHONPATH=OTHER python benchmarks/walk.py ...                          the library of another checkout

A stay is a function that is entered for the first time with the pairs, or with something that holds them; a room is the
module that it stands in; who reads on from stay to stay climbs where the next one is in a room that was left before.
"""

from __future__ import annotations

import os
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from itertools import pairwise
from pathlib import Path
from types import FrameType
from typing import Any

sys.path.append(str(Path(__file__).resolve().parents[1]))  # after another checkout's

from compasslib import command

DEPTH = 4  # records within records that are looked through for the pairs
LIBRARY = str(Path(command.__file__).resolve().parents[1]) + os.sep


def holds(value: Any, depth: int = DEPTH) -> bool:
    """Tell whether a value is the pairs, or a record or sequence that has them somewhere inside."""
    if type(value).__name__ in ("Pairs", "Case"):  # what is diagnosed: from the pairs on, their case
        return True
    if depth and is_dataclass(value) and type(value).__module__.startswith("compasslib"):
        return any(holds(getattr(value, one.name, None), depth - 1) for one in fields(value))
    return bool(depth) and isinstance(value, tuple | list) and any(holds(one, depth - 1) for one in value[:3])


class Walk:
    """What is counted between the beginning and the end of a call of ``diagnose``."""

    def __init__(self) -> None:
        """Begin with nothing counted."""
        self.stays: dict[tuple[str, str], None] = {}  # file and function, in the order of the first entry
        self.within: FrameType | None = None

    def event(self, frame: FrameType, what: str, _: Any) -> None:
        """Take one call or return, as ``sys.setprofile`` gives them."""
        code = frame.f_code
        if what == "return" and frame is self.within:
            self.within = None
        if what != "call" or not code.co_filename.startswith(LIBRARY) or code.co_name.startswith("<"):
            return
        if self.within is None:
            if code.co_name != "diagnose":
                return
            self.within = frame
        names = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
        if any(holds(frame.f_locals.get(name)) for name in names):
            self.stays.setdefault((code.co_filename, code.co_qualname))


def climbs(rooms: Sequence[str]) -> int:
    """Return how often a room is entered again that was left before."""
    return sum(one != before and one in rooms[:k] for k, (before, one) in enumerate(pairwise(rooms)))


def main() -> None:
    """Correct the mooring and print what its diagnosis entered."""
    walk = Walk()
    sys.setprofile(walk.event)
    try:
        command.main(["correct", *sys.argv[1:]])
    except SystemExit as ended:
        if ended.code:
            raise
    finally:
        sys.setprofile(None)
    rooms = [file.removeprefix(LIBRARY) for file, _ in walk.stays]
    counts = Counter(rooms)
    print("\n".join(f"{count:4d}  {room}" for room, count in counts.most_common()))
    print(f"{len(rooms)} stays in {len(counts)} rooms, {climbs(rooms)} climbs")


if __name__ == "__main__":
    main()
