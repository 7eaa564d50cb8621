"""Simulated currents and moorings, written as the raw files of the instruments.

The simulation is an independent check of the analysis: it shares no code with the rest of compasslib but the arithmetic
of angles, and computes every reading by forward physics alone.

Raw files of a short deployment; the truth is returned separately:

>>> from pathlib import Path
>>> from tempfile import TemporaryDirectory
>>> from compasslib.demo import sealed
>>> mooring = sealed.make(3, "M1", sealed.Wish(hours=200, wide=True))
>>> with TemporaryDirectory() as folder:
...     truth = sealed.write(mooring, [], Path(folder))
...     sorted(path.name for path in Path(folder).iterdir())
['deep.000', 'top.000']
"""
