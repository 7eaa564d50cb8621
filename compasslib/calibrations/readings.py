"""Columns of a calibration's text tables, by role; what is to be withheld is not even looked at."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from compasslib.errors import InputError
from compasslib.readers import delimited
from compasslib.types import Floats

LARGEST_DEG = 720.0  # an angle beyond two turns is in another unit
FARTHEST_S = 180 * 86400.0  # of a calibration's date from its file: the field changes by less than a fifth of a degree
ADVICE = "correct columns in the calibration's file"


def read(
    files: Sequence[str | Path], settings: Mapping[str, Any], *, required: Sequence[str], optional: Sequence[str] = ()
) -> tuple[dict[str, Floats], tuple[str, ...]]:
    """Return columns by role, files one after the other, an optional one only where every file has it; and notes.

    Args:
        files: tables with a header line.
        settings: ``columns`` gives headers that differ from the roles, ``withhold`` roles or headers to leave out, and
            the keys of ``delimited.Layout`` how they are written.
        required: roles that must be there.
        optional: roles that may be.

    Raises:
        InputError: a file or column is absent, a required one is withheld, or a value cannot be read.
    """
    paths, withheld = [Path(file) for file in files], set(settings.get("withhold") or ())
    header = {role: (settings.get("columns") or {}).get(role, role) for role in (*required, *optional)}
    layout = delimited.Layout.from_settings(settings)
    names = [set(delimited.read_header(path, [header[role] for role in required], layout)) for path in paths]
    _refuse_unknown(withheld, set(header), set.union(*names), paths)
    _refuse_withheld(required, header, withheld)
    wanted = {
        role: name
        for role, name in header.items()
        if role in required or (not {role, name} & withheld and all(name in there for there in names))
    }
    tables = [delimited.read_table(path, wanted, ADVICE, layout) for path in paths]
    return {role: np.concatenate([one.columns[role] for one in tables]) for role in wanted}, delimited.table_notes(
        tables
    )


def check_degrees(columns: Mapping[str, Floats], files: Sequence[str | Path]) -> None:
    """Refuse angles that cannot be degrees.

    Args:
        columns: by role; those whose role ends in ``_deg`` are looked at.

    Raises:
        InputError: an angle lies beyond two turns.
    """
    for role, values in columns.items():
        worst = np.nanmax(np.abs(values), initial=0.0) if role.endswith("_deg") else 0.0
        if worst > LARGEST_DEG:
            where = f"{', '.join(str(file) for file in files)}: {role}"
            found = f"{worst:g}"
            raise InputError(where, expected="degrees", found=found, advice="turn the column to degrees")


def dated(time_s: Floats | None, date_s: float | None) -> list[str]:
    """Return a warning where the date of a calibration is not that of its file, or nothing.

    Args:
        time_s: of the file, None where it has no clock.
        date_s: of the YAML file, None where it has none.
    """
    if date_s is None or time_s is None or not np.isfinite(time_s).any():
        return []
    first, last = float(np.nanmin(time_s)), float(np.nanmax(time_s))
    if first - FARTHEST_S <= date_s <= last + FARTHEST_S:
        return []
    day, given = (str(np.datetime64(int(t), "s"))[:10] for t in (first, date_s))
    return [f"the file begins on {day} and IGRF is taken at the date in the YAML file, {given}: correct one of the two"]


def _refuse_unknown(withheld: set[str], roles: set[str], names: set[str], paths: Sequence[Path]) -> None:
    unknown = sorted(withheld - roles - names)
    if unknown:
        where = f"{', '.join(str(path) for path in paths)}: withhold"
        there = ", ".join(sorted(names)) or "an empty file"
        raise InputError(where, expected=f"columns of it ({there})", found=unknown[0], advice="correct withhold")


def _refuse_withheld(required: Sequence[str], header: Mapping[str, str], withheld: set[str]) -> None:
    for role in required:
        if {role, header[role]} & withheld:
            expected, found = "columns that the calibration can do without", f"{role}, which it needs"
            raise InputError("withhold", expected=expected, found=found, advice="take it out of withhold")
