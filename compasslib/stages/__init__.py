"""Stages of the workflow: functions that read files, write files and report their result.

A stage is called with the wildcards of its rule (``workflow/rules``), the named inputs and outputs of the rule, a
function that writes to the log, and its settings (``settings``); it raises InputError if it cannot read a file. The
rule ``read`` makes the record of one instrument:

>>> import tempfile
>>> from pathlib import Path
>>> from compasslib.stages import Files, read
>>> folder = Path(tempfile.mkdtemp())
>>> rows = [f"2014-07-16T{hour:02d}:00:00,500,0.1,0.2" for hour in range(24)]
>>> _ = (folder / "deep.csv").write_text("\\n".join(["time,depth,u,v", *rows]))
>>> when = {"start_s": 1405468800.0, "end_s": 1405555200.0}
>>> where = {"water_depth": 517.0, "latitude": 66.5, "nominal_depth": 500.0, "direction_reference": "true"}
>>> columns = {"time": "time", "depth": "depth", "east": "u", "north": "v"}
>>> files = Files(raw=[str(folder / "deep.csv")], companions=[], record=str(folder / "deep.nc"))
>>> read.read("M1", "deep", files, print,
...           form="table", reader={"columns": columns}, deployment=when | where, series={})
M1 deep: 24 samples of 1 bins (rows 24)

``pipeline.process.process_mooring`` runs the stages of one mooring of a cruise in sequence, without Snakemake.
"""

from collections.abc import Callable, Mapping
from types import SimpleNamespace as Files  # paths of a job, or lists of them, by the names in its rule
from typing import Any

Say = Callable[[str], None]  # writes a line to the log
Settings = Mapping[str, Any]

__all__ = ["Files", "Say", "Settings"]
