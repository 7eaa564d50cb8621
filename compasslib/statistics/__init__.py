"""Shared statistics: minimization, robust widths, correlated noise and its whitening.

Hourly currents are correlated: a thousand of them contain as much information as a few dozen independent ones:

>>> import numpy as np
>>> from compasslib.statistics.least_squares import robust_width
>>> from compasslib.statistics.noise import effective_sample_size
>>> white = np.random.default_rng(1).normal(size=1001)
>>> red = np.array([sum(0.9**k * white[n - k] for k in range(50)) for n in range(50, 1001)])
>>> [round(effective_sample_size(x, 3600.0 * np.arange(len(x)))) for x in (white, red)]
[1001, 42]
>>> round(robust_width(np.append(white, 1e6)), 2)  # an outlier hardly moves it
0.99
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import threadpool_limits

_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@contextmanager
def single_threaded() -> Iterator[None]:
    """Limit the linear algebra of the block, or of the decorated function, to one thread.

    Multiple threads split sums differently, which changes the last bits of a result, and cost more than they gain at
    the sizes used here. The limit ends with the block.
    """
    before = {name: os.environ.get(name) for name in _VARIABLES}
    os.environ.update(dict.fromkeys(_VARIABLES, "1"))  # for libraries first loaded within the block
    try:
        with threadpool_limits(limits=1, user_api="blas"):  # for those already loaded
            yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
