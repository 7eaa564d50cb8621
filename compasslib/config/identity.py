"""Whether names and files of a cruise contradict: one record under two names, two compasses under one."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Mapping
from itertools import combinations
from pathlib import Path

from compasslib.config.compasses import SERIAL
from compasslib.config.cruise import Cruise
from compasslib.config.schema import Instrument, Mooring

HEAD_BYTES = 65536
Identity = frozenset[tuple[object, ...]]


def problems(cruise: Cruise, serials: Mapping[str, Mapping[str, str]]) -> list[str]:
    """Find contradictions between the names in the YAML files and what the raw files are.

    Args:
        serials: the serial numbers that the files state, by mooring and instrument.
    """
    if cruise.options.demonstration:
        return []
    identities = {
        (name, role): _identity(instrument, cruise.root)
        for name, mooring in cruise.moorings.items()
        for role, instrument in mooring.instruments.items()
    }
    return [*_repeated(cruise.moorings, identities), *_mixed(cruise.moorings, serials)]


def _identity(instrument: Instrument, root: Path) -> Identity:
    """Identify the files of an instrument by their content, and the columns that are read of them."""
    columns = tuple(sorted(instrument.columns.headers().items())) if instrument.columns else ()
    found = []
    for file in instrument.files:
        with (root / file).open("rb") as raw:
            found.append((columns, (root / file).stat().st_size, hashlib.sha256(raw.read(HEAD_BYTES)).digest()))
    return frozenset(found)


def _repeated(moorings: Mapping[str, Mooring], identities: Mapping[tuple[str, str], Identity]) -> Iterator[str]:
    for name, mooring in moorings.items():
        for one, other in combinations(mooring.instruments, 2):
            if identities[name, one] & identities[name, other]:
                advice = "delete one of the two, or correct its files"
                yield f"{name}: instruments {one} and {other} are one record, as their files are equal; {advice}"
    for one, other in combinations(moorings, 2):
        first, second = moorings[one], moorings[other]
        together = min(first.end_s, second.end_s) > max(first.start_s, second.start_s)
        if together and identities[one, first.compromised] & identities[other, second.compromised]:
            found = "one mooring under two names, as the files of the affected instrument are equal"
            yield f"{one} and {other}: {found}; delete one of the two, or correct its files"


def _mixed(moorings: Mapping[str, Mooring], serials: Mapping[str, Mapping[str, str]]) -> Iterator[str]:
    numbers: dict[str, dict[str, str]] = {}
    for name, mooring in moorings.items():
        for role, instrument in mooring.instruments.items():
            stated = next((str(instrument.attributes[key]) for key in SERIAL if key in instrument.attributes), "")
            number = serials.get(name, {}).get(role, "") or stated
            if instrument.compass is not None and number:
                numbers.setdefault(instrument.compass, {})[f"{name} ({role})"] = number
    for compass, places in numbers.items():
        for (one, first), (other, second) in combinations(places.items(), 2):
            if not _digits(first) & _digits(second):
                found = f"serial number {first} at {one}, {second} at {other}"
                yield f"compass {compass}: {found}: two instruments under one name; correct compass or files"


def _digits(number: str) -> set[int]:
    return {int(digits) for digits in re.findall(r"\d+", number)}
