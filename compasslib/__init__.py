"""Correction of compass deviations in moored current records.

Iron with B = 0.3 changes the reading at 90 degrees by 17; the inverse in closed form recovers the correct heading:

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

``dir(compasslib)`` lists the public names, which ``__init__.pyi`` declares. Each is imported on first use.
"""

import importlib
import re
from pathlib import Path
from typing import Any

__version__ = "2.0.0"

_IMPORTS = re.findall(r"^from (\S+) import \w+ as (\w+)$", Path(__file__).with_suffix(".pyi").read_text(), re.MULTILINE)
_MODULES = {name: module for module, name in _IMPORTS}
__all__ = sorted(_MODULES)


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module 'compasslib' has no attribute {name!r}")
    if _MODULES[name] == __name__:
        return importlib.import_module(f"compasslib.{name}")
    return getattr(importlib.import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
