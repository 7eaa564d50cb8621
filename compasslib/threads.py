"""Linear algebra on one thread, so that results do not depend on the number of cores."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import threadpool_limits

_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@contextmanager
def single_threaded() -> Iterator[None]:
    """Limit the linear algebra of the block, or of the decorated function, to one thread.

    Threads split sums differently, which changes the last bits of a result, and at the sizes met here they cost more
    than they gain. The limit ends with the block.
    """
    before = {name: os.environ.get(name) for name in _VARIABLES}
    os.environ.update(dict.fromkeys(_VARIABLES, "1"))  # for libraries that the block is the first to load
    try:
        with threadpool_limits(limits=1, user_api="blas"):  # for those that are loaded
            yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
