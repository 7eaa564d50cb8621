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

KINDS = ("platform", "tilt", "magnetometer", "swing", "two_heads", "declination")
NO_HEADINGS = {"tilt": "a tilt sensor's calibration has no headings, on which the effects of the catalogue act"}
DISABLED = "the search for unmodelled effects is switched off: diagnose: {enabled: false}"


@single_threaded()
def diagnose(
    kind: str, files: Sequence[str | Path], settings: Mapping[str, Any], options: Options | None = None
) -> Diagnosis:
    """Diagnose a calibration's recording, files in the order of the YAML file; without options it is switched off.

    Raises:
        InputError: a file that cannot be read.
    """
    from compasslib import earthfield
    from compasslib.inference import diagnosis

    if options is None or kind in NO_HEADINGS:
        return diagnosis.insufficient(DISABLED if options is None else NO_HEADINGS[kind])
    resolved = earthfield.resolve_settings(settings)
    made: Diagnosis = import_module(f"{__name__}.{kind}").diagnose(files, resolved, options)
    return made


def chosen(settings: Mapping[str, Any]) -> Options | None:
    """Read the options of a diagnosis; None if it is switched off."""
    from compasslib.inference.comparison import Options

    if not settings["enabled"]:
        return None
    return Options(**{name: value for name, value in settings.items() if name != "enabled"})
