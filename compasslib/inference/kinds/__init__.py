"""Diagnose recordings of calibrations against their simulations; ``KINDS`` lists the kinds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from compasslib.statistics import single_threaded

if TYPE_CHECKING:  # the Snakefile needs only the table of kinds
    from compasslib.inference.comparison import Options
    from compasslib.inference.diagnosis import Diagnosis

# Each module's diagnose(files, settings, options) returns the Diagnosis; a kind is imported only by its own job.
KINDS: dict[str, str] = {
    "platform": "compasslib.inference.kinds.platform",
    "tilt": "compasslib.inference.kinds.tilt",
    "magnetometer": "compasslib.inference.kinds.magnetometer",
    "swing": "compasslib.inference.kinds.swing",
    "two_heads": "compasslib.inference.kinds.two_heads",
    "declination": "compasslib.inference.kinds.declination",
}
DISABLED = "the search for unmodelled effects is switched off: diagnose: {enabled: false}"


@single_threaded()
def diagnose(
    kind: str, files: Sequence[str | Path], settings: Mapping[str, Any], options: Options | None = None
) -> Diagnosis:
    """Diagnose a calibration's recording against its simulation.

    Args:
        files: raw files in the order of the YAML file.
        settings: settings of the YAML file, resolved or not.
        options: options of the diagnosis; None if it is switched off.

    Raises:
        InputError: a file that cannot be read.
    """
    from compasslib import calibrations
    from compasslib.inference import diagnosis

    if options is None:
        return diagnosis.insufficient(DISABLED)
    made: Diagnosis = import_module(KINDS[kind]).diagnose(files, calibrations.resolve_settings(settings), options)
    return made


def chosen(settings: Mapping[str, Any]) -> Options | None:
    """Read the options of a diagnosis; None if it is switched off."""
    from compasslib.inference.comparison import Options

    if not settings["enabled"]:
        return None
    return Options(**{name: value for name, value in settings.items() if name != "enabled"})
