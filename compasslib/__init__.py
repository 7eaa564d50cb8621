"""Correction of compass deviations in moored current records.

Iron with B = 0.3 turns the reading at 90 degrees by 17; the inverse in closed form gives the correct heading again:

>>> import numpy as np
>>> import compasslib
>>> iron = np.array([0.0, 0.3, 0.0, 0.0, 0.0])  # A, B, C, D, E of the exact compass
>>> float(compasslib.compass.recorded_heading(iron, 90.0).round(1))
73.3
>>> float(compasslib.compass.inverse(iron, np.array([73.3]))[0, 0].round(1))
90.0
>>> compasslib.angles.mean([350.0, 20.0]).round(6).tolist()
5.0
>>> declination, horizontal, vertical = compasslib.igrf(66.5, 0.4, [1188864000.0])  # September 2007
>>> round(float(declination[0]), 1), round(float(horizontal[0]))
(-4.5, 12314)

``dir(compasslib)`` lists the public names. Each is imported when it is first used.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from compasslib import angles, compass, earthfield
    from compasslib.archive.attributes import Site
    from compasslib.archive.files import read_json, write_json
    from compasslib.archive.netcdf import read_corrected, read_pairs, read_record, write_corrected
    from compasslib.calibrations import calibrate
    from compasslib.calibrations.result import Calibration
    from compasslib.config.cruise import load_cruise
    from compasslib.deviation import fit_deviation
    from compasslib.deviation.assessment import assess_correction
    from compasslib.deviation.correction import correct
    from compasslib.deviation.model import DeviationFit
    from compasslib.earthfield import field_along, igrf
    from compasslib.errors import InputError
    from compasslib.inference.covariates import logged_series
    from compasslib.inference.diagnosis import Diagnosis
    from compasslib.inference.finding import Finding
    from compasslib.inference.kinds.mooring import diagnose
    from compasslib.pipeline.process import process_mooring
    from compasslib.preparation.deployment import apply_deployment
    from compasslib.preparation.pairs import PairRules, estimate_clock_offset, find_pairs
    from compasslib.readers import read
    from compasslib.readers.detect import detect_kind
    from compasslib.records import CorrectedRecord, EarthField, Pairs, Record

__version__ = "1.0.0"

_PLACES = {  # module: its public names here; imported late, so that no job pays for what it does not use
    "": "angles compass earthfield",
    "archive.attributes": "Site",
    "archive.files": "read_json write_json",
    "archive.netcdf": "read_corrected read_pairs read_record write_corrected",
    "calibrations": "calibrate",
    "calibrations.result": "Calibration",
    "config.cruise": "load_cruise",
    "deviation": "fit_deviation",
    "deviation.assessment": "assess_correction",
    "deviation.correction": "correct",
    "deviation.model": "DeviationFit",
    "earthfield": "field_along igrf",
    "errors": "InputError",
    "inference.covariates": "logged_series",
    "inference.diagnosis": "Diagnosis",
    "inference.finding": "Finding",
    "inference.kinds.mooring": "diagnose",
    "pipeline.process": "process_mooring",
    "preparation.deployment": "apply_deployment",
    "preparation.pairs": "PairRules estimate_clock_offset find_pairs",
    "readers": "read",
    "readers.detect": "detect_kind",
    "records": "CorrectedRecord EarthField Pairs Record",
}
_PLACE = {name: place for place, names in _PLACES.items() for name in names.split()}
__all__ = sorted(_PLACE)


def __getattr__(name: str) -> Any:
    if name not in _PLACE:
        raise AttributeError(f"module 'compasslib' has no attribute {name!r}")
    if not (place := _PLACE[name]):
        return importlib.import_module(f"compasslib.{name}")
    return getattr(importlib.import_module(f"compasslib.{place}"), name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
