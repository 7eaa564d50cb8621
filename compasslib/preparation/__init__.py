"""Preparation of decoded exports, up to pairs of measurements of nearly the same water.

Each record is cut to its deployment, checked and flagged; overlapping samples of two instruments are paired:

>>> import numpy as np
>>> from compasslib import earthfield, records
>>> from compasslib.preparation import deployment, pairs
>>> where = {"start_s": 0.0, "end_s": 3 * 3600.0, "latitude": 66.5}
>>> flow = np.full((4, 1), 0.2)
>>> raw = records.new_record(3600.0 * np.arange(4), flow, flow, heading_deg=10.0 * np.arange(4))
>>> apply = deployment.apply_deployment
>>> upper, lower = (apply(raw, **where, water_depth=500.0, nominal_depth=z) for z in (100.0, 110.0))
>>> field = earthfield.field_along(**where, longitude=0.4, declination=-3.0)
>>> print(pairs.describe_pairs("M1", pairs.find_pairs(upper, [lower], field, pairs.PairRules())))
M1: 4 overlapping pairs, 10.0 m apart in the median
"""
