"""Stages of the workflow: functions that read files, write files and report their result.

The arguments of a stage are the named inputs and outputs of its rule (``workflow/rules``), and its settings
(``settings``). The rule ``read`` makes the record of one instrument:

>>> import tempfile
>>> from pathlib import Path
>>> from compasslib.stages import read
>>> folder = Path(tempfile.mkdtemp())
>>> rows = [f"2014-07-16T{hour:02d}:00:00,500,0.1,0.2" for hour in range(24)]
>>> _ = (folder / "deep.csv").write_text("\\n".join(["time,depth,u,v", *rows]))
>>> when = {"start_s": 1405468800.0, "end_s": 1405555200.0}
>>> where = {"water_depth": 517.0, "latitude": 66.5, "nominal_depth": 500.0, "direction_reference": "true"}
>>> columns = {"time": "time", "depth": "depth", "east": "u", "north": "v"}
>>> read.read("M1", "deep", raw=[str(folder / "deep.csv")], companions=[], record=str(folder / "deep.nc"),
...          form="table", reader={"columns": columns}, deployment=when | where, series={}, say=print)
M1 deep: 24 samples of 1 bins (rows 24)

``pipeline.process.process_mooring`` runs the stages of one mooring of a cruise in sequence, without Snakemake.
"""
