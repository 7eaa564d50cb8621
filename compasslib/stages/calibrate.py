"""Calibrate a compass independently of any mooring."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from compasslib import calibrations as calibrations
from compasslib.archive import calibrations as archive
from compasslib.archive import provenance
from compasslib.calibrations import result


def calibrate(
    name: str,
    /,
    *,
    raw: Sequence[str],
    earlier: Sequence[str],
    calibration: str,
    table: str,
    points: str,
    kind: str,
    settings: Mapping[str, Any],
    say: Callable[[str], None],
) -> None:
    """Write coefficients, deviation table, points and uncertainty budget of a calibration.

    Args:
        earlier: calibration.json of the calibrations to compare with, possibly none.

    Raises:
        InputError: a raw file cannot be read.
    """
    settled = calibrations.resolve_settings(settings)
    made = calibrations.calibrate(kind, raw, settled)
    page = result.to_json(name, made, settled, archive.named(earlier)) | provenance.stamp(raw)
    archive.write(page=page, made=made, calibration=calibration, table=table, points=points)
    say(result.log_line(page))
