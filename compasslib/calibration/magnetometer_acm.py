"""The compass of a Falmouth 3D-ACM as a magnetometer's log: direction cosines, tilts and the heading that it logged."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compasslib.calibration.magnetometer_log import Log
from compasslib.errors import InputError
from compasslib.readers import mmp_acm, mmp_clock, mmp_files

Floats = NDArray[np.floating]

HEADERS = {"x": "HX", "y": "HY", "z": "HZ", "pitch_deg": "TX", "roll_deg": "TY", "heading_deg": "HDNG"}
PLACES = {role: mmp_files.COLUMNS.index(header) for role, header in HEADERS.items()}
TIME = "time_utc"


def read(paths: Sequence[Path], withhold: Collection[str]) -> Log:
    """Return the log; the first scan of every profile is aliased and left out.

    The axes are forward, port, up; TX lifts the first and TY the second, each axis by itself in the logger's own rule.

    Args:
        paths: A files, unpacked ASCII or binary.
        withhold: roles or headers that must not be seen.

    Raises:
        InputError: a file cannot be read, or something unknown or needed is withheld.
    """
    seen = _seen(withhold)
    scans = mmp_files.load(paths)
    values, aliased = scans.values, mmp_acm.first(scans)
    keep = ~aliased & np.isfinite(values[:, 3:6]).all(axis=1)
    columns = {role: values[keep, place] for role, place in PLACES.items() if role in seen}
    tilts = [columns.get(role) for role in ("pitch_deg", "roll_deg")]
    said = [f"{int(aliased.sum())} first scans of a profile are aliased and left out."]
    if any(tilt is None for tilt in tilts):
        tilts = [None, None]
    elif scans.damaged:
        said.append(f"{scans.damaged} damaged rows are left out.")
    heading, z = columns.get("heading_deg"), columns.get("z")
    if heading is not None and np.isnan(heading).any():
        heading = None
        said.append("The scans carry no heading.")
    raw = np.column_stack([columns["x"], columns["y"], np.zeros(keep.sum()) if z is None else z])
    return Log(
        raw,
        z is not None,
        tilts[0] if z is not None else None,
        tilts[1] if z is not None else None,
        heading,
        _times(scans)[keep] if TIME in seen else None,
        int((~keep).sum()),
        tuple(said),
        axis_by_axis=True,
    )


def _seen(withhold: Collection[str]) -> set[str]:
    """Return the roles that may be looked at."""
    known = {*HEADERS, *HEADERS.values(), TIME}
    if unknown := sorted(set(withhold) - known):
        raise InputError(
            "withhold", expected=f"columns of it ({', '.join(sorted(known))})", found=unknown[0], advice="correct it"
        )
    for role in ("x", "y"):
        if {role, HEADERS[role]} & set(withhold):
            raise InputError(
                "withhold", expected="columns other than x and y", found=role, advice="take it off the list"
            )
    return {role for role, header in HEADERS.items() if not {role, header} & set(withhold)} | ({TIME} - set(withhold))


def _times(scans: mmp_files.Scans) -> Floats:
    nominal = np.array([block.rate_hz for block in scans.blocks])
    return mmp_clock.spread(scans.clock_s, scans.profile, nominal[scans.profile])
