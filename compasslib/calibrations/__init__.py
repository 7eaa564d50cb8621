"""Calibrations that need no mooring; ``KINDS`` lists them, and a kind is imported only when it is used.

A compass turned on a bench, with a deviation of one cycle:

>>> from pathlib import Path
>>> from tempfile import TemporaryDirectory
>>> from compasslib import calibrations
>>> from compasslib.angles import sin_cos
>>> turned = range(0, 360, 15)
>>> rows = [f"{heading},{heading - 4.0 * sin_cos(heading)[0]:.1f}" for heading in turned]
>>> with TemporaryDirectory() as folder:
...     path = Path(folder, "bench.csv")
...     _ = path.write_text("\\n".join(["reference_deg,recorded_deg", *rows, ""]))
...     bench = calibrations.calibrate("platform", [path], {})
>>> round(float(bench.coefficients[1]), 1)  # B, degrees
4.0
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from compasslib.readers import detect
from compasslib.statistics import single_threaded

if TYPE_CHECKING:  # the Snakefile needs ``KINDS`` only
    from compasslib.calibrations.result import Calibration


@dataclass(frozen=True)
class Kind:
    """Module, figures and file formats of a kind of calibration."""

    module: str  # in this package; its calibrate(files, settings) returns the Calibration
    figures: tuple[str, ...] = ()  # drawn by draw_NAME(path, calibration) of plots.calibrations
    by_heading: bool = True  # whether it has a deviation curve, and thus the common ``FIGURES``
    formats: tuple[str, ...] = ("table",)  # of its files, the default first


KINDS: dict[str, Kind] = {
    "platform": Kind("platform"),
    "tilt": Kind("tilt", ("tilt",), by_heading=False),
    "magnetometer": Kind("magnetometer", ("magnetometer",), formats=("table", "mmp_acm")),
    "swing": Kind("swing", formats=("table", "nmea0183")),
    "declination": Kind("declination", ("series",), by_heading=False, formats=("iaga2002",)),
    "two_heads": Kind("two_heads", formats=("pd0",)),
}
FIGURES = ("deviation", "certificate")  # common to all kinds with a deviation curve

MODELS = {  # descriptions of the deviation curves
    "smith": "Smith's five terms",
    "exact": "exact compass",
    "polynomial": "polynomial of degree 6",
    "one_cycle": "one cycle",
    "empirical": "empirical, six harmonics",
}


def figure_names(kind: str) -> list[str]:
    """List the names of the figures of a kind of calibration."""
    return [*(FIGURES if KINDS[kind].by_heading else ()), *KINDS[kind].figures]


@single_threaded()
def calibrate(kind: str, files: Sequence[str | Path], settings: Mapping[str, Any]) -> Calibration:
    """Calibrate a compass from raw files in the order of the YAML file, with its keys as settings.

    Raises:
        InputError: a file cannot be read.
    """
    from compasslib import earthfield  # imported late: the Snakefile needs ``KINDS`` only

    offered, module = KINDS[kind].formats, import_module(f"compasslib.calibrations.{KINDS[kind].module}")
    form = settings.get("format") or offered[0]
    series = set(settings.get("observatory") or ())  # these have another format
    tables = [file for file in files if str(file) not in series]
    with detect.format_hints(form, tables, offered=offered, advice="correct file or kind in the calibration's file"):
        made: Calibration = module.calibrate(files, earthfield.resolve_settings(settings))
    return made
