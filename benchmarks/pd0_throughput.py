"""Throughput of the PD0 reader against mhkit's and against reading the bytes alone, all in one run.

    python benchmarks/pd0_throughput.py [file.000]

The file is the good ensembles of a moored WorkHorse, repeated to some 60 MB in a temporary folder; mhkit, which is slow
and keeps everything it reads, gets a smaller piece of the same.
"""

from __future__ import annotations

import contextlib
import io
import logging
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path

from compasslib.readers.pd0.frames import frames
from compasslib.readers.pd0.reader import decode, read

RAW = Path(__file__).resolve().parents[1] / ".." / "shared" / "data" / "pd0" / "eh2_20060530_20060717_0007m.000"
MEGABYTES, MHKIT_COPIES, REPEATS = 60, 2, 5


def good_bytes(path: Path) -> bytes:
    """Return the good ensembles of a file, back to back."""
    return b"".join(run.rows.tobytes() for chunk in frames(path) for run in chunk.runs)


def speed(path: Path, action: Callable[[Path], object], repeats: int) -> float:
    """Return MB/s of the fastest of some repetitions."""
    fastest = float("inf")
    for _ in range(repeats):
        begun = time.perf_counter()
        action(path)
        fastest = min(fastest, time.perf_counter() - begun)
    return path.stat().st_size / 1e6 / fastest


def by_record(path: Path) -> object:
    """Read as the pipeline does."""
    return read([path], orientation="down", declination_applied=None, heading_alignment=None)


def by_mhkit(path: Path) -> object:
    """Read with mhkit, its messages kept off the screen."""
    from mhkit.dolfyn import read as mhkit_read  # type: ignore[import-untyped]

    with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return mhkit_read(str(path))


def main(raw: Path) -> None:
    """Make the files, time each way of reading them, print the table."""
    logging.disable(logging.CRITICAL)
    good = good_bytes(raw)
    with tempfile.TemporaryDirectory() as folder:
        large, small = Path(folder) / "large.000", Path(folder) / "small.000"
        large.write_bytes(good * max(1, round(MEGABYTES * 1e6 / len(good))))
        small.write_bytes(good * MHKIT_COPIES)
        by_mhkit(small)  # its imports are not its speed
        ways = [
            ("plain reading", large, speed(large, Path.read_bytes, REPEATS)),
            ("decode()", large, speed(large, decode, REPEATS)),
            ("read(), currents turned", large, speed(large, by_record, REPEATS)),
            ("mhkit", small, speed(small, by_mhkit, 1)),
        ]
        mhkit, plain = ways[-1][2], ways[0][2]
        print(f"{'':26}{'file MB':>9}{'MB/s':>9}{'x mhkit':>9}{'of plain':>10}")
        for name, path, rate in ways:
            size = path.stat().st_size / 1e6
            print(f"{name:26}{size:9.1f}{rate:9.1f}{rate / mhkit:9.1f}{rate / plain:10.3f}")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else RAW)
