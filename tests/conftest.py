"""Configure the tests with one thread per worker: they run in parallel, and small matrices gain nothing from more."""

import os
import sys
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")
os.environ.setdefault("SOURCE_DATE_EPOCH", "1700000000")  # the results of two runs are compared byte by byte

# Warnings raised while drawing are errors in workflow jobs and commands too, which pytest's own filter does not
# reach.
PLOTS = Path(__file__).resolve().parents[1] / "compasslib/plots"
drawing = [f"error:::compasslib.plots.{module.stem}" for module in sorted(PLOTS.glob("[a-z]*.py"))]
os.environ["PYTHONWARNINGS"] = ",".join(filter(None, [os.environ.get("PYTHONWARNINGS"), *drawing]))

# Modules imported by benchmarks; appended last, as some have the same names as test modules.
sys.path.append(str(Path(__file__).resolve().parents[1] / "benchmarks"))

# Longest first: if started last, one of them would occupy one core while others idle.
LONGEST = [
    "cluster", "inference_mooring", "workflow", "pipeline_cruise", "archive_provenance", "docs", "example",
    "reliability", "fuzz", "report", "inference", "stages", "proof", "plugins",
]  # fmt: skip


def pytest_collection_modifyitems(items):
    """Run the files that take longest first, keeping the order within each file."""
    names = {item: item.path.stem.removeprefix("test_") for item in items}
    items.sort(key=lambda item: next((k for k, name in enumerate(LONGEST) if names[item].startswith(name)), 99))
