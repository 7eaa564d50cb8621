"""Figures for the report and for a paper, each one PNG; this room alone knows matplotlib.

Currents before and after, Figures 6, 7 and 9 of von Appen 2015 anew, the diagnosis, and those of calibrations.
A figure appears whole or not at all, and the same data give the same bytes.

>>> from pathlib import Path
>>> from tempfile import TemporaryDirectory
>>> from compasslib.plots.page import CORRECTED, degrees, page
>>> with TemporaryDirectory() as folder:
...     with page(Path(folder, "heading.png"), 1.5) as figure:
...         axes = figure.subplots()
...         _ = axes.plot([0.0, 360.0], [0.0, 5.0], color=CORRECTED)
...         degrees(axes.xaxis, (0.0, 360.0))
...     [path.name for path in Path(folder).iterdir()]
['heading.png']
"""
