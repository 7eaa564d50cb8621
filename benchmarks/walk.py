"""How far does the overlap of a mooring walk through its diagnosis? Counted while one is diagnosed.

    python benchmarks/walk.py CRUISE MOORING           this checkout; the cruise has its raw files
    PYTHONPATH=OTHER python benchmarks/walk.py ...     the library of another checkout, as an earlier commit

A stay is a function that is entered with the pairs or with something that holds them; a room is the module that it
stands in; a climb is a call into a module that is left again further up the same way, not the caller's own.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
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


def ours(frame: FrameType | None) -> Iterator[FrameType]:
    """Give the library's frames from one up to that in which the diagnosis began."""
    while frame is not None:
        if frame.f_code.co_filename.startswith(LIBRARY):
            yield frame
            if frame.f_code.co_name == "diagnose":
                return
        frame = frame.f_back


class Walk:
    """What is counted between the beginning and the end of a call of ``diagnose``."""

    def __init__(self) -> None:
        """Begin with nothing counted."""
        self.stays: set[tuple[str, str]] = set()
        self.climbs: set[tuple[str, str, str, str]] = set()
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
        stay = (code.co_filename, code.co_qualname)
        if not any(
            holds(frame.f_locals.get(name)) for name in code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
        ):
            return
        self.stays.add(stay)
        above = [one.f_code for one in ours(frame.f_back)]
        if (
            above
            and above[0].co_filename != code.co_filename
            and code.co_filename in {one.co_filename for one in above}
        ):
            self.climbs.add((above[0].co_filename, above[0].co_qualname, *stay))


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
    rooms: dict[str, int] = {}
    for file, _ in sorted(walk.stays):
        room = file.removeprefix(LIBRARY)
        rooms[room] = rooms.get(room, 0) + 1
    print("\n".join(f"{count:4d}  {room}" for room, count in sorted(rooms.items(), key=lambda one: -one[1])))
    print(f"{len(walk.stays)} stays in {len(rooms)} rooms, {len(walk.climbs)} climbs")


if __name__ == "__main__":
    main()
