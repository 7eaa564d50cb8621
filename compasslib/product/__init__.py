"""Gridded product: corrected and reference velocities at fixed depths and times, with the error model of their sums.

A heading error is common to simultaneous velocities, and partly to the record: the uncertainty of a section or a mean
follows from the modes of that error (``errors``), not from the standard deviations of cells:

>>> import numpy as np
>>> from compasslib.product.errors import HeadingErrors, sum_sigma
>>> flow, none = np.full((100, 3), 0.2 + 0.0j), np.zeros((100, 3))  # eastward, 100 times, 3 depths
>>> errors = HeadingErrors(("constant",), np.full((1, 100), 0.05), np.zeros((1, 100)), 0.0, np.ones((1, 1)))
>>> north = np.full(flow.shape, 1.0 / flow.size)  # weights of the mean northward velocity
>>> round(sum_sigma(none, north, flow, none, none.astype(int), errors, 3600.0), 4)  # as a single cell's: 0.2 times 0.05
0.01
"""
