"""Array types and units of time used throughout the library."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating]
Bools = NDArray[np.bool_]
Complexes = NDArray[np.complexfloating]
HOUR_S, DAY_S = 3600.0, 86400.0
YEAR_S = 365.25 * DAY_S  # a Julian year
