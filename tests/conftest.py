"""Configure the tests with one thread per worker: they run in parallel, and small matrices gain nothing from more."""

import os
import sys
from pathlib import Path

import pytest

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")
os.environ.setdefault("SOURCE_DATE_EPOCH", "1700000000")  # the results of two runs are compared byte by byte

# Warnings raised while drawing are errors in workflow jobs and commands too, which pytest's own filter does not
# reach.
PLOTS = Path(__file__).resolve().parents[1] / "compasslib/plots"
drawing = [f"error:::compasslib.plots.{module.stem}" for module in sorted(PLOTS.glob("[a-z]*.py"))]
os.environ["PYTHONWARNINGS"] = ",".join(filter(None, [os.environ.get("PYTHONWARNINGS"), *drawing]))

# Modules imported by benchmarks.
sys.path.append(str(Path(__file__).resolve().parents[1] / "benchmarks"))

# Longest first: if started last, one of them would occupy one core while others idle.
LONGEST = [
    "workflow/test_cluster", "inference/test_mooring", "docs", "archive/test_deposit", "workflow/test_rerun",
    "benchmarks", "workflow/test_workflow", "workflow/test_interruptions", "inference", "workflow/test_example",
    "workflow/test_module", "workflow/test_calibrations", "pipeline", "report", "stages",
    "archive/test_provenance", "workflow",
]  # fmt: skip


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers():
    """Use one worker more than cores: some tests wait, for Slurm, for Snakemake, for a browser."""
    return (os.cpu_count() or 1) + 1


def pytest_collection_modifyitems(items):
    """Run the files that take longest first, keeping the order within each file."""
    items.sort(key=lambda item: next((k for k, name in enumerate(LONGEST) if f"tests/{name}" in item.nodeid), 99))
