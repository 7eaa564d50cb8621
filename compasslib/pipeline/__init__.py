"""Planning and execution of runs and jobs, with their records and the reasons why moorings were stopped.

The inputs and settings of each rule come from ``plan``, which selects the keys of the cruise that the rule needs:

>>> from pathlib import Path
>>> from tempfile import TemporaryDirectory
>>> from types import SimpleNamespace
>>> from compasslib.config import cruise
>>> from compasslib.pipeline import plan
>>> with TemporaryDirectory() as folder:
...     Path(folder, "config").mkdir()
...     _ = Path(folder, "config/config.yaml").write_text("moorings: [config/M1.yaml]\\n")
...     _ = Path(folder, "a.000").write_bytes(b"")
...     _ = Path(folder, "config/M1.yaml").write_text(
...         "{name: M1, latitude: 66.5, longitude: 0.4, water_depth: 517, start: 2014-07-16, end: 2014-10-09,"
...         " compromised: top, instruments: {top: {format: pd0, files: a.000}}}")
...     planned = plan.plan(cruise.load_cruise(Path(folder)), Path())
>>> planned.moorings.raw_files(SimpleNamespace(mooring="M1", role="top"))
['a.000']
>>> planned.products()[0]
'results/M1/corrected.nc'
"""
