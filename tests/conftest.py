"""One thread a worker: the tests run in parallel already, and small matrix products do not gain from more."""

import os
import sys
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")
os.environ.setdefault("SOURCE_DATE_EPOCH", "1700000000")  # results of two runs are compared byte by byte

# A warning raised while something is drawn is an error in jobs of the workflow and in commands too: pytest's own filter
# ends at this process.
PLOTS = Path(__file__).resolve().parents[1] / "compasslib/plots"
drawing = [f"error:::compasslib.plots.{module.stem}" for module in sorted(PLOTS.glob("[a-z]*.py"))]
os.environ["PYTHONWARNINGS"] = ",".join(filter(None, [os.environ.get("PYTHONWARNINGS"), *drawing]))

# What a benchmark imports beside itself; last, as some of them are named like modules of the tests.
sys.path.append(str(Path(__file__).resolve().parents[1] / "benchmarks"))

# Longest first: begun last, one of them would hold one core while others idle.
LONGEST = (
    *(
        "inference_mooring",
        "workflow",
        "pipeline_cruise",
        "archive_provenance",
        "docs",
        "example",
        "reliability",
        "fuzz",
    ),
    *("report", "inference", "stages", "proof", "plugins"),
)


def pytest_collection_modifyitems(items):
    """Begin with the files that take longest; the order within a file stays."""
    names = {item: item.path.stem.removeprefix("test_") for item in items}
    items.sort(key=lambda item: next((k for k, name in enumerate(LONGEST) if names[item].startswith(name)), 99))
