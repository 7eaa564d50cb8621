"""The example that plots a corrected record: it runs without warnings on what make run installs."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest
from launch import PROJECT
from test_archive import make_product, write

GREY, GREEN = (153, 153, 153), (44, 160, 44)  # colours of recorded and corrected sticks


def test_example_draws_recorded_and_corrected_currents(tmp_path):
    image = pytest.importorskip("PIL.Image")
    record = write(tmp_path / "corrected.nc", make_product(1500, 6))
    command = [sys.executable, "-W", "error", PROJECT / "examples/plot_corrected.py", record, tmp_path / "figure.png"]
    environment = os.environ | {"MPLBACKEND": "Agg"}
    ran = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert ran.returncode == 0, ran.stderr
    assert "Currents of mooring EG4, corrected" in ran.stdout
    with image.open(tmp_path / "figure.png") as drawn:
        pixels = np.asarray(drawn.convert("RGB"))
    for colour in (GREY, GREEN):
        assert (pixels == colour).all(axis=2).sum() > 100, colour


def test_imports_of_the_readme_commands_are_locked():
    """Packages of the example, and pygments, which Snakemake's report needs without requiring it."""
    lock = (PROJECT / "requirements/run.txt").read_text().lower()
    text = (PROJECT / "examples/plot_corrected.py").read_text()
    imported = {
        line.split()[1].split(".")[0].lower() for line in text.splitlines() if line.startswith(("import ", "from "))
    }
    assert {"netcdf4", "numpy", "matplotlib"} <= imported
    for package in (imported - set(sys.stdlib_module_names)) | {"pygments"}:
        assert f"\n{package}==" in lock, package
