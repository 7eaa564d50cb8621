"""A simulated sea with moorings in it, which writes the raw files that the instruments would have left.

It is the independent check of the analysis: it shares no code with the rest of compasslib, its angles included, and
derives every reading from the forward physics alone.

A twelfth of a year under a sphere, as its instruments leave it, and the truth apart:

>>> from pathlib import Path
>>> from tempfile import TemporaryDirectory
>>> from compasslib.demo import sealed
>>> mooring = sealed.make(3, "M1", sealed.Wish(hours=200, wide=True))
>>> with TemporaryDirectory() as folder:
...     truth = sealed.write(mooring, [], Path(folder), sealed.Export())
...     sorted(path.name for path in Path(folder).iterdir())
['deep.000', 'top.000']
"""
