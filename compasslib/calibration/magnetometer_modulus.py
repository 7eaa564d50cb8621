"""The modulus of a magnetometer's corrected axes, held against the earth's field of place and date.

A file need not say its unit, and the units of a magnetic field differ by powers of ten: without iron the modulus must
be IGRF's in one of them. Headers such as ``mag_x_nT`` say which.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from math import log10

OFF = 0.12  # sensor's scale, crust and day are within; of arbitrary scales one in nine agrees by chance
NANOTESLA = {"nT": 1.0, "uT": 1e3, "µT": 1e3, "mT": 1e6, "mG": 100.0, "G": 1e5, "Gauss": 1e5}
_SUFFIX = re.compile(rf"[_ .\[(]({'|'.join(NANOTESLA)})[\])]?$")


def sentences(modulus: float, strength_nT: float, what: str, columns: Mapping[str, str]) -> list[str]:
    """Return what to say where no unit makes the modulus that of the earth's field, or the one that is named does not.

    Args:
        modulus: of the corrected axes, in the file's unit.
        strength_nT: IGRF's at place and date.
        what: which strength, total or horizontal.
        columns: role -> header.
    """
    unit = _unit(columns)
    if unit is None and _near(10.0 ** round(log10(modulus / strength_nT)), modulus / strength_nT):
        return []
    if unit is not None and _near(1.0, modulus * NANOTESLA[unit] / strength_nT):
        return []
    found = f"The {what} field is {modulus:.4g} {unit or 'in the unit of the file'} without the iron that was found"
    expected = f"IGRF has {strength_nT:.0f} nT at place and date"
    none = "No unit of a magnetic field (nT, µT, mG, G) makes"
    by = "The unit in the header does not make" if unit else none
    return [
        f"{found}; {expected}. {by} the two agree: a wrong scale, unit, place or date, counts of the sensor's "
        "own, or not the earth's field. Headings depend on ratios only and stand; hard_iron is in the file's unit."
    ]


def _unit(columns: Mapping[str, str]) -> str | None:
    """Return the unit that the headers of x and y end in, where they agree."""
    ends = {match[1] if (match := _SUFFIX.search(columns.get(role) or "")) else None for role in ("x", "y")}
    return ends.pop() if len(ends) == 1 else None


def _near(a: float, b: float) -> bool:
    return abs(a / b - 1.0) < OFF
