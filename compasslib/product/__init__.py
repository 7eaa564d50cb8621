"""Gridded product: corrected and reference velocities at fixed depths and times, with the error model of their sums.

A heading error rotates all simultaneous velocities of an instrument alike, and partly those of the whole record. The
uncertainty of a section or a mean therefore follows from the modes of that error (``errors``), not from the marginal
standard deviations of its cells:

>>> import numpy as np
>>> from compasslib.product.errors import HeadingErrors, sum_sigma
>>> flow = np.full((100, 3), 0.2 + 0.0j)  # eastward, 100 times, 3 depths
>>> errors = HeadingErrors(("constant",), np.full((1, 100), 0.05), np.zeros((1, 100)), 0.0, np.ones((1, 1)))
>>> north = np.full(flow.shape, 1.0 / flow.size)  # weights of the mean northward velocity
>>> sigma = sum_sigma(0.0 * north, north, flow, np.zeros(flow.shape), np.zeros(flow.shape, dtype=int), errors, 3600.0)
>>> round(float(sigma), 4)  # as that of a single cell: 0.2 m/s times 0.05
0.01
"""
