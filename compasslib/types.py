"""Types of arrays that every room speaks of."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating]
Bools = NDArray[np.bool_]
Complexes = NDArray[np.complexfloating]
