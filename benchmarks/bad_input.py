"""What a user is told of ten mistakes in a mooring file and five bad raw files: each is one line and a non-zero exit.

    python benchmarks/bad_input.py

Every case is a run of the pipeline on a small cruise, spoilt in one place.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

PROJECT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(PROJECT / "tests"))
from sea import cruise  # noqa: E402

YAML = Path("config/moorings/M1.yaml")
TOP, DEEP = Path("raw/M1/top.000"), Path("raw/M1/deep.csv")


def swap(path: Path, old: str, new: str) -> Callable[[Path], object]:
    return lambda folder: (folder / path).write_text((folder / path).read_text().replace(old, new, 1))


def write(path: Path, content: bytes) -> Callable[[Path], object]:
    return lambda folder: (folder / path).write_bytes(content)


CASES: dict[str, Callable[[Path], object]] = {
    "latitude beyond the pole": swap(YAML, "latitude: 65.3333", "latitude: 95.3"),
    "a decimal comma": swap(YAML, "latitude: 65.3333", "latitude: 65,3333"),
    "a misspelt key": swap(YAML, "water_depth", "water_dept"),
    "recovered before deployed": swap(YAML, "end: '2007", "end: '2006"),
    "a date that is none": swap(YAML, "start: '2007-09-04T00:00:00Z'", "start: 4 Sept 2007"),
    "a reference that is no instrument": swap(YAML, "reference: deep", "reference: botom"),
    "an unknown format": swap(YAML, "format: pd0", "format: pd1"),
    "a file that is not there": swap(YAML, "raw/M1/top.000", "raw/M1/top.001"),
    "a path out of the cruise": swap(YAML, "raw/M1/top.000", "../../etc/passwd"),
    "a key twice": swap(YAML, "name: M1", "name: M1\nname: M2"),
    "raw file is empty": write(TOP, b""),
    "raw file is text": write(TOP, b"not a recording\n" * 200),
    "raw file is cut after 100 bytes": lambda folder: (folder / TOP).write_bytes((folder / TOP).read_bytes()[:100]),
    "a column is missing": swap(DEEP, "u_cm_s", "u"),
    "a number is none": swap(DEEP, ",105.0,", ",x105,"),
}


def main() -> None:
    for what, spoil in CASES.items():
        with tempfile.TemporaryDirectory() as scratch:
            folder = cruise(Path(scratch) / "c", n=60)
            spoil(folder)
            command = [sys.executable, "-m", "snakemake", "--snakefile", PROJECT / "Snakefile", "--directory", folder]
            ran = subprocess.run([*map(str, command), "--cores", "1"], capture_output=True, text=True, check=False)
            lines = [line for line in ran.stderr.splitlines() if "error: " in line]
            trace = "Traceback" in ran.stderr + ran.stdout
            print(f"{what} (exit {ran.returncode}, {len(lines)} line, traceback {trace}):")
            print("\n".join(f"  {line}" for line in lines))


if __name__ == "__main__":
    main()
