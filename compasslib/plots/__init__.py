"""Figures for the report and for publications, as PNG or PDF; the only package that uses matplotlib.

Currents before and after correction, Figures 6, 7 and 9 of von Appen (2015), the diagnosis, and calibrations.
Files are written atomically, and the same data give the same bytes.

>>> from pathlib import Path
>>> from tempfile import TemporaryDirectory
>>> from compasslib.plots.page import CORRECTED, create, degrees
>>> with TemporaryDirectory() as folder:
...     with create(Path(folder, "heading.png"), 1.5) as figure:
...         axes = figure.subplots()
...         _ = axes.plot([0.0, 360.0], [0.0, 5.0], color=CORRECTED)
...         degrees(axes.xaxis, (0.0, 360.0))
...     [path.name for path in Path(folder).iterdir()]
['heading.png']
"""

from importlib import import_module
from types import ModuleType


def __getattr__(name: str) -> ModuleType:
    """Import a module of figures, and with it matplotlib, when it is first used."""
    if name.startswith("_"):
        raise AttributeError(name)
    return import_module(f"{__name__}.{name}")
