"""Statistics that several rooms share: minimisation, robust widths, correlated noise and its whitening.

Hourly currents are correlated, so that a thousand of them say as much as a few dozen independent ones:

>>> import numpy as np
>>> from compasslib.statistics import robust
>>> from compasslib.statistics.autocorrelation import effective_number
>>> white = np.random.default_rng(1).normal(size=1001)
>>> red = np.array([sum(0.9**k * white[n - k] for k in range(50)) for n in range(50, 1001)])
>>> round(effective_number(white, 3600.0 * np.arange(1001.0))), round(effective_number(red, 3600.0 * np.arange(951.0)))
(1001, 42)
>>> round(robust.width(np.append(white, 1e6)), 2)  # an outlier hardly moves it
0.99
"""
