"""Figures for a paper, each one PNG; this room alone knows matplotlib.

Figures 5 to 9 of von Appen 2015, the record along time, the diagnosis, and those of calibrations. A figure appears
whole or not at all, and the same data give the same bytes.

The curves of von Appen 2015, Fig. 2, as one file:

>>> from pathlib import Path
>>> from tempfile import TemporaryDirectory
>>> from compasslib.plots import deviation
>>> with TemporaryDirectory() as folder:
...     deviation.theory(Path(folder, "theory.png"))
...     [path.name for path in Path(folder).iterdir()]
['theory.png']
"""
