"""One thread a worker: the tests run in parallel already, and small matrix products do not gain from more."""

import os

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")
