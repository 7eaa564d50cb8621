"""Calibrate a compass independently of any mooring."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from compasslib import calibrations, earthfield
from compasslib.archive import calibrations as archive
from compasslib.archive import provenance
from compasslib.archive.files import read_json, write_json
from compasslib.calibrations import result

FILES = {"calibration": "calibration.json", "table": "table.csv", "points": "points.csv"}


def calibrate(
    name: str,
    /,
    *,
    raw: Sequence[str],
    calibration: str,
    table: str,
    points: str,
    kind: str,
    settings: Mapping[str, Any],
    say: Callable[[str], None],
) -> None:
    """Write coefficients, deviation table, points and uncertainty budget of a calibration.

    Raises:
        InputError: a raw file cannot be read.
    """
    settled = earthfield.resolve_settings(settings)
    made = calibrations.calibrate(kind, raw, settled)
    page = result.to_json(name, made, settled) | provenance.stamp(raw)
    archive.write(page=page, made=made, calibration=calibration, table=table, points=points)
    say(result.log_line(page))


def compare_calibrations(
    name: str,
    /,
    *,
    calibration: str,
    table: str,
    points: str,
    others: Sequence[str],
    compared: str,
    made: Sequence[str],
    say: Callable[[str], None],
) -> None:
    """Write the files of a calibration, with its comparison with others in calibration.json.

    Args:
        others: calibration.json of the calibrations to compare with, possibly none.
        compared: calibration.json to write.
        made: table.csv and points.csv to write.
    """
    page = read_json(calibration)
    write_json(
        compared, page | result.compare_all(name, page, {Path(path).parent.name: read_json(path) for path in others})
    )
    for source, copy in zip((table, points), made, strict=True):
        shutil.copyfile(source, copy)
    say(f"{name}: compared with {', '.join(Path(other).parent.name for other in others) or 'no other calibration'}")
