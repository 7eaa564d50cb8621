"""Calibrate a compass apart from any mooring, and search its recording for unmodelled effects."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from compasslib import calibrations as calibrations
from compasslib.archive import calibrations as archive
from compasslib.archive import provenance
from compasslib.archive.files import write_json
from compasslib.calibrations import result
from compasslib.inference import kinds


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
    """Write coefficients, table of deviations, points and budget of uncertainty.

    Args:
        raw: files in the order of the YAML file.
        earlier: calibration.json that it is compared with, perhaps none.
        settings: keys of the YAML file that the kind takes.

    Raises:
        InputError: a raw file cannot be read.
    """
    settled = calibrations.resolve_settings(settings)
    made = calibrations.calibrate(kind, raw, settled)
    page = result.to_json(name, made, settled, archive.named(earlier)) | provenance.stamp(raw)
    archive.write(page=page, made=made, calibration=calibration, table=table, points=points)
    say(result.log_line(page))


def diagnose_calibration(
    name: str,
    /,
    *,
    raw: Sequence[str],
    diagnosis: str,
    kind: str,
    settings: Mapping[str, Any],
    options: Mapping[str, Any],
    say: Callable[[str], None],
) -> None:
    """Write what its recording shows that the simulation does not hold.

    Args:
        raw: files in the order of the YAML file.
        settings: keys of the YAML file that the kind takes.
        options: of the cruise's diagnoses.

    Raises:
        InputError: a raw file cannot be read.
    """
    found = kinds.diagnose(kind, raw, settings, kinds.chosen(options))
    write_json(diagnosis, found.to_json())
    say(found.log_line(name))
