"""Preparation of decoded exports, up to pairs of measurements of nearly the same water.

Each record is cut to its deployment, checked and flagged; overlapping samples of two instruments are paired:

>>> from pathlib import Path
>>> from tempfile import TemporaryDirectory
>>> from compasslib import earthfield, readers
>>> from compasslib.preparation.deployment import apply_deployment
>>> from compasslib.preparation.pairs import PairRules, describe_pairs, find_pairs
>>> where = {"start_s": 0.0, "end_s": 3 * 3600.0, "latitude": 66.5}
>>> with TemporaryDirectory() as folder:
...     path = Path(folder, "meter.csv")
...     rows = [f"1970-01-01T0{hour}:00:00Z,{10 * hour},0.1,0.2" for hour in range(4)]
...     _ = path.write_text("\\n".join(["t,h,u,v", *rows, ""]))
...     columns = {"time": "t", "heading": "h", "east": "u", "north": "v"}
...     raw = readers.read("table", [path], {"columns": columns})
>>> upper, lower = (apply_deployment(raw, **where, water_depth=500.0, nominal_depth=z) for z in (100.0, 110.0))
>>> field = earthfield.field_along(**where, longitude=0.4, declination=-3.0)
>>> print(describe_pairs("M1", find_pairs(upper, [lower], field, PairRules())))
M1: 4 overlapping pairs, 10.0 m apart in the median
"""
