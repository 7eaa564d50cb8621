"""What changed between two runs of a calibration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import angles
from compasslib.archive import calibrations as archive
from compasslib.calibrations.result import DeviationTable
from compasslib.cli import changes, folders, versions
from compasslib.cli.changes import SAME, coefficients, degrees, effects, from_to
from compasslib.report import words

HEADER = (
    "calibration",
    "deviation, rms",
    "largest",
    "uncertainty",
    "verdict",
    "effects",
    "coefficients",
    "also changed",
)
# Follow from what stands in columns of its own, or name the software.
SHOWN = ("model", "coefficients", "covariance", "uncertainty", "software", "date_created")


@dataclass(frozen=True)
class CalibrationRun:
    """What one run says of one calibration."""

    content: Mapping[str, Any]  # calibration.json
    table: DeviationTable
    diagnosis: Mapping[str, Any]  # empty where a kind is not diagnosed


def row(old: Path | None, new: Path | None) -> tuple[str, ...]:
    """Return a calibration's cells; none where nothing changed, a single one where the two cannot be compared.

    Args:
        old: folder of its results, None where there is none.

    Raises:
        InputError: a file is damaged.
    """
    return changes.row((old, new), folders.CALIBRATION, lambda a, b: _compared(_read(a), _read(b)))


def reasons(old: Mapping[str, Path], new: Mapping[str, Path], rows: Mapping[str, tuple[str, ...]]) -> list[str]:
    """Return for each pair of versions what in the changelog may have changed the calibrations.

    Args:
        old: folders of results by name.
        rows: what changed, as ``row`` gives it.
    """
    changed: dict[tuple[str, str], set[str]] = {}
    for name, row in rows.items():
        if len(row) == len(HEADER) - 1 and any(cell != SAME for cell in row[:-1]):
            earlier = old.get(name) or next(iter(old.values()))  # one folder against its copy of another name
            one, other = (folders.content(side / "calibration.json") for side in (earlier, new[name]))
            sides = str(one.get("software", "")), str(other.get("software", ""))
            changed.setdefault(sides, set()).add(f"calibration:{other['kind']}")
    return ["\n".join(lines) for sides, named in changed.items() if (lines := versions.reasons(*sides, named))]


def _read(folder: Path) -> CalibrationRun:
    file = folder / "diagnosis.json"
    found = folders.content(file) if file.is_file() else {}
    return CalibrationRun(folders.content(folder / "calibration.json"), archive.read_table(folder / "table.csv"), found)


def _compared(old: CalibrationRun, new: CalibrationRun) -> tuple[str, ...]:
    found = (from_to(_verdict(old), _verdict(new)), from_to(_effects(old), _effects(new)))
    sure = from_to(*(words.degrees(one.content["uncertainty"]["expanded_deg"], 2) for one in (old, new)))
    fitted = coefficients(_fit(old.content), _fit(new.content))
    keys = dict.fromkeys([*old.content, *new.content])
    others = [key for key in keys if key not in SHOWN and old.content.get(key) != new.content.get(key)]
    alike = all(cell == SAME for cell in found)
    others += ["diagnosis.json"] if alike and old.diagnosis != new.diagnosis else []
    return (*_turned(old.table, new.table), sure, *found, fitted, ", ".join(others) or SAME)


def _turned(old: DeviationTable, new: DeviationTable) -> tuple[str, str]:
    """Return rms and largest change of the deviation at the headings that both tables have."""
    _, here, there = np.intersect1d(old.heading_deg, new.heading_deg, return_indices=True)
    change = angles.difference(new.deviation_deg[there], old.deviation_deg[here])
    change = change[np.isfinite(change)]
    if not change.size:
        nowhere = "none in both" if old.heading_deg.size or new.heading_deg.size else SAME
        return nowhere, nowhere
    if not change.any():
        return SAME, SAME
    return degrees(float(np.sqrt(np.mean(change**2)))), degrees(float(np.max(np.abs(change))))


def _verdict(run: CalibrationRun) -> str:
    return str(run.diagnosis["verdict"]) if run.diagnosis else "none"


def _effects(run: CalibrationRun) -> str:
    return effects(run.diagnosis) if run.diagnosis else "none"


def _fit(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return the coefficients that there are as those of a mooring's fit; a kind may have the first of them alone."""
    known = {letter: value for letter, value in (content["coefficients"] or {}).items() if value is not None}
    sigma = np.array(content["covariance"] or np.zeros((len(known), len(known))), dtype=float)[
        : len(known), : len(known)
    ]
    return {"method": content["model"], "coefficients": known, "covariance": np.nan_to_num(sigma).tolist()}
