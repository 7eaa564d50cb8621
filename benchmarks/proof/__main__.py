"""Run a proof. It is apart from ``run``, whose functions are imported by the processes that it starts."""

import sys

from benchmarks.proof import run

sys.exit(run.main())
