"""One row a mooring: what was corrected, how well, and what a person should know."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from compasslib.archive import netcdf
from compasslib.archive.files import read_series

COLUMNS = (
    "name",
    "method",
    "n_pairs",
    "share_corrected",
    "rms_before_deg",
    "rms_after_deg",
    "max_deviation_deg",
    "folded",
    "verdict",
    "effects",
    "warnings",
)

STOPPED = "stopped"  # the verdict of a mooring without results, as its files cannot be used


def row(name: str, folder: str | Path, roles: Iterable[str] | None = None) -> dict[str, Any]:
    """Return a mooring's row; shares from 0 to 1, angles in degrees, rms on pairs held out from the fit.

    Args:
        roles: its instruments; None where no configuration says so, then every record that is there.
    """
    folder = Path(folder)
    files = ("deviation.json", "assessment.json", "diagnosis.json")
    fit, verdict, found = (netcdf.read_json(folder / file) for file in files)
    heading, deviation = read_series(folder / "corrected.nc", "HEADING_CORRECTED", "DEVIATION")
    corrected = np.isfinite(heading)
    return {
        "name": name,
        "method": fit["method"],
        "n_pairs": fit["n_pairs"],
        "share_corrected": _rounded(corrected.mean() if corrected.size else 0.0, 4),
        "rms_before_deg": _rounded(verdict["before"]["rms_deg"], 2),
        "rms_after_deg": _rounded(verdict["after"]["rms_deg"], 2),
        "max_deviation_deg": _rounded(np.nanmax(np.abs(deviation)) if corrected.any() else None, 1),
        "folded": fit["folded"],
        "verdict": found["verdict"],
        "effects": " ".join(finding["effect"] for finding in found["findings"]),
        "warnings": " | ".join([*_warnings(folder, roles, fit, found, verdict), *_of_records(records(folder, roles))]),
    }


def row_of_stopped(name: str, why: str) -> dict[str, Any]:
    """Return the row of a mooring that was stopped: no numbers, the verdict ``stopped`` and the reason as a warning."""
    return dict.fromkeys(COLUMNS, None) | {"name": name, "verdict": STOPPED, "warnings": why}


def records(folder: Path, roles: Iterable[str] | None) -> list[Path]:
    """Return the records of a mooring's instruments, in the order of their names.

    Args:
        roles: its instruments; None where no configuration says so, then every record that is there.
    """
    if roles is None:
        return sorted((folder / "work").glob("*.nc"))
    return [folder / f"work/{role}.nc" for role in sorted(roles)]


def write(path: str | Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write summary.csv."""
    with netcdf.replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the rows as a person reads them on a terminal."""
    shown = COLUMNS[:8]
    lines = [shown, *(["" if r[c] is None else str(r[c]) for c in shown] for r in rows)]
    widths = [max(len(line[k]) for line in lines) for k in range(len(shown))]
    return "\n".join("  ".join(cell.rjust(w) for cell, w in zip(line, widths, strict=True)) for line in lines)


def _warnings(
    folder: Path,
    roles: Iterable[str] | None,
    fit: Mapping[str, Any],
    found: Mapping[str, Any],
    verdict: Mapping[str, Any],
) -> list[str]:
    field = netcdf.read_json(folder / "work/field.json")
    reasons = dict.fromkeys(why for why in (fit["why"], found["why"] * (found["verdict"] == "insufficient")) if why)
    pairs = netcdf.read_pairs(folder / "overlap.nc").warnings
    refuted = [verdict["refuted"]] if verdict["refuted"] else []
    first = [*refuted, *reasons, *found.get("warnings", ()), *_unexplained(found), *pairs]
    return [*first, *fit["warnings"], *field["warnings"]]


def _of_records(paths: Iterable[Path]) -> list[str]:
    return [f"{path.stem}: {warning}" for path in paths for warning in netcdf.read_warnings(path)]


def _unexplained(found: Mapping[str, Any]) -> list[str]:
    """Say what the search saw and nothing predicts: the verdict alone does not tell how large it is."""
    left = found["unexplained"]
    if not left:
        return []
    return [
        f"a mismatch of {left['rms_effect_deg']:.1f}° rms {left['where']['text']} is unexplained and not "
        "corrected; it is included in the uncertainty"
    ]


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None else round(float(value), digits)
