"""Would catch a deposit that the lines of its README do not install, verify and run again in a clean environment."""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile

import pytest
from launch import snakemake
from sea import cruise

from compasslib.archive import deposit
from compasslib.config.cruise import load_cruise

OPTIONS = """
diagnose: {enabled: false}
attributes: {institution: Sea, principal_investigator: A. Fram, license: MIT, publisher_url: https://example.org/}
"""


def test_deposit_runs_again_by_its_readme(tmp_path):
    """Packages are installed by its lock from the package index, the library from its wheel; one file is made again."""
    processed, there = cruise(tmp_path / "cruise", n=60), tmp_path / "there"
    (processed / "config/config.yaml").write_text(OPTIONS)
    assert snakemake(processed).returncode == 0
    deposit.deposit(load_cruise(processed), tmp_path / "c.zip")
    zipfile.ZipFile(tmp_path / "c.zip").extractall(there)
    assert (there / "workflow/LICENSE").is_file() and (there / "workflow/profiles/default/config.yaml").is_file()
    lines = [line.strip() for line in (there / "README.md").read_text().splitlines() if line.startswith("    ")]
    install, verify, again, compare = lines
    into = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    into |= {"PIP_RETRIES": "1", "PIP_NO_COMPILE": "0"}  # 0 is the value of compile: only what is imported is compiled

    def run(line: str) -> subprocess.CompletedProcess:
        return subprocess.run(line, shell=True, capture_output=True, text=True, check=False, cwd=there, env=into)

    ran = run(install.replace("python3", sys.executable))
    if "No matching distribution found" in ran.stderr:
        pytest.skip("no package index")
    assert ran.returncode == 0, ran.stderr
    assert "files as listed" in run(verify).stdout
    assert again == "mv results deposited && .venv/bin/compass run ."
    file = "results/M1/corrected.nc"
    ran = run(f"cp -r results deposited && rm {file} && .venv/bin/compass run . -- {file}")
    assert ran.returncode == 0 and "rule correct:" in ran.stderr and "rule read:" not in ran.stderr, ran.stderr
    assert run(compare).stdout.startswith("nothing changed: 1\xa0mooring"), run(compare)
