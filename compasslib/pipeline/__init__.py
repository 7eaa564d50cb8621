"""Execution of a stage as a job of Snakemake, and processing of one mooring without Snakemake.

Inputs and outputs stand in the rules (``workflow/rules``). Each setting of a stage is a parameter of its rule:

>>> from pathlib import Path
>>> from tempfile import TemporaryDirectory
>>> from compasslib.config import cruise
>>> from compasslib.pipeline import keys
>>> from compasslib.stages import settings
>>> with TemporaryDirectory() as folder:
...     Path(folder, "config").mkdir()
...     _ = Path(folder, "config/config.yaml").write_text("moorings: [config/M1.yaml]\\n")
...     _ = Path(folder, "a.000").write_bytes(b"")
...     _ = Path(folder, "config/M1.yaml").write_text(
...         "{name: M1, latitude: 66.5, longitude: 0.4, water_depth: 517, start: 2014-07-16, end: 2014-10-09,"
...         " compromised: top, instruments: {top: {format: pd0, files: a.000}}}")
...     moorings = settings.Moorings(cruise.load_cruise(Path(folder)))
>>> moorings.raw_files("M1", "top")
['a.000']
>>> keys.flatten(moorings.fit("M1"))["method"]
'method="exact"'
"""
