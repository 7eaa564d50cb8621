"""Would catch a deposit that the lines of its README do not install, verify and run again in a clean environment."""

import os
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

from compasslib.archive import deposit
from compasslib.config.cruise import load_cruise
from tests.world.launch import snakemake
from tests.world.sea import cruise

OWNER = "{institution: Sea, principal_investigator: A. Fram, license: MIT, publisher_url: https://example.org/}"


def test_deposit_runs_again_by_its_readme(tmp_path):
    """The packages of its lock are those of this environment, of the same versions; the library is from its wheel."""
    processed, there, file = cruise(tmp_path / "cruise", n=60), tmp_path / "there", "results/M1/gridded.nc"
    (processed / "config/config.yaml").write_text(f"diagnose: {{enabled: false}}\nattributes: {OWNER}\n")
    assert snakemake(processed, drawn=False).returncode == 0
    deposit.deposit(load_cruise(processed), tmp_path / "c.zip")
    zipfile.ZipFile(tmp_path / "c.zip").extractall(there)
    assert (there / "workflow/LICENSE").is_file() and (there / "workflow/profiles/default/config.yaml").is_file()
    lines = [line.strip() for line in (there / "README.md").read_text().splitlines() if line.startswith("    ")]
    install, verify, again, compare = lines
    (packages := tmp_path / "packages").mkdir()
    for path in Path(sysconfig.get_path("purelib")).iterdir():
        if "compasslib" not in path.name:
            (packages / path.name).symlink_to(path)
    into = os.environ | {"PYTHONPATH": f"{packages}", "PIP_RETRIES": "1"}

    def run(line: str) -> tuple[bool, str]:
        ran = subprocess.run(line, shell=True, capture_output=True, text=True, check=False, cwd=there, env=into)
        return ran.returncode == 0, ran.stdout + ran.stderr

    installed, said = run(install.replace("python3", sys.executable))
    if "No matching distribution found" in said:
        pytest.skip("no package index")
    assert installed and "files as listed" in run(verify)[1], said
    assert again == "mv results deposited && .venv/bin/compass run ."
    made, said = run(f"{again} -- {file}")
    assert made and "rule correct:" in said, said
    assert run(compare) == (True, "nothing changed: 1\xa0mooring compared\n")
