"""Input and output of a calibration's three files: calibration.json, the deviation table and the underlying points."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from compasslib.archive.files import SIGNIFICANT_DIGITS, read_csv, write_csv, write_json
from compasslib.calibrations.result import Calibration, DeviationTable
from compasslib.types import Floats

TABLE_COLUMNS = ("recorded_deg", "deviation_deg", "standard_uncertainty_deg")


@dataclass(frozen=True)
class StoredCalibration:
    """A calibration read from its files, for figures and comparisons."""

    content: Mapping[str, Any]  # calibration.json
    table: DeviationTable
    points: Mapping[str, Floats]


def write(
    *, page: Mapping[str, Any], made: Calibration, calibration: str | Path, table: str | Path, points: str | Path
) -> None:
    """Write a calibration's files, each complete or not at all."""
    deviations = made.table or DeviationTable(*np.zeros((3, 0)))
    rows = (deviations.heading_deg, deviations.deviation_deg, deviations.sigma_deg)
    write_csv(table, TABLE_COLUMNS, rows, ("{:.4g}", "{:.3f}", "{:.3f}"))
    write_csv(
        points, tuple(made.points), tuple(made.points.values()), (f"{{:.{SIGNIFICANT_DIGITS}g}}",) * len(made.points)
    )
    write_json(calibration, page)


def read_table(path: str | Path) -> DeviationTable:
    """Read the deviation table of a calibration."""
    columns = read_csv(path)
    return DeviationTable(*(columns[name] for name in TABLE_COLUMNS))
