"""Throughput of the readers compared with mhkit and with reading the bytes only, in one run.

    python benchmarks/throughput.py [file.000]

PD0 is the valid ensembles of a moored WorkHorse, repeated to about 60 MB; mhkit reads a smaller file of the same
ensembles. Nortek is a real Aquadopp file, if available, an AWAC and a Signature written by the tests' encoder; netCDF
is the small PD0 file saved by mhkit.
"""

import contextlib
import io
import logging
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import targets
from mhkit import dolfyn  # type: ignore[import-untyped]
from runs import DATA

from compasslib import readers
from compasslib.readers.pd0 import decode
from compasslib.readers.pd0.frames import find_ensembles
from tests.world import nortek_encoder as encoder

RAW, AQUADOPP = DATA / "pd0/eh2_20060530_20060717_0007m.000", DATA / "moored/aqd9330.aqd"
KEYS = {
    "pd0": {"orientation": "down", "declination_applied": None, "heading_alignment": None},
    "nortek": {},
    "netcdf": {"columns": None, "orientation": None, "declination_applied": None, "direction_reference": "magnetic"},
}
MEGABYTES, MHKIT_COPIES, REPEATS = 60, 2, 5
SAMPLES, CELLS = 2000, 40


def speed(path: Path, action: Callable[[Path], object], repeats: int = REPEATS) -> float:
    """Measure the throughput of the fastest of some repetitions, MB/s."""
    fastest = float("inf")
    for _ in range(repeats):
        begun = time.perf_counter()
        action(path)
        fastest = min(fastest, time.perf_counter() - begun)
    return path.stat().st_size / 1e6 / fastest


def by_mhkit(path: Path) -> object:
    """Read with mhkit, without its messages."""
    with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return dolfyn.load(str(path)).load().close() if path.suffix == ".nc" else dolfyn.read(str(path))


def library(path: Path) -> float | str:
    """Measure the throughput of mhkit, MB/s, or describe its failure."""
    try:
        by_mhkit(path)  # imports and indexing are not timed
        return speed(path, by_mhkit, 1)
    except Exception as error:
        return f"fails: {type(error).__name__}"


def written(folder: Path) -> list[Path]:
    """Write profiles of an AWAC and of a Signature along their beams."""
    rng = np.random.default_rng(1)
    samples = [encoder.Sample(k, rng.integers(-900, 900, (4, CELLS)) / 1000.0) for k in range(SAMPLES)]
    of_three = [encoder.older(replace(sample, velocity=sample.velocity[:3])) for sample in samples]
    files = {
        "awac.wpr": encoder.configuration(encoder.BEAM, CELLS) + b"".join(of_three),
        "signature.ad2cp": encoder.text() + b"".join(map(encoder.signature, samples)),
    }
    for name, data in files.items():
        (folder / name).write_bytes(data)
    return [folder / name for name in files]


def main(raw: Path) -> None:
    """Write the files, time each way of reading them, and print the table."""
    logging.disable(logging.CRITICAL)
    good = b"".join(run.rows.tobytes() for run in find_ensembles(raw)[0])  # valid ensembles
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        large, small = folder / "large.000", folder / "small.000"
        large.write_bytes(good * max(1, round(MEGABYTES * 1e6 / len(good))))
        small.write_bytes(good * MHKIT_COPIES)
        nortek = written(folder)
        if AQUADOPP.exists():  # copied, as mhkit writes to the folder of the file
            nortek.append(folder / AQUADOPP.name)
            nortek[-1].write_bytes(AQUADOPP.read_bytes())
        targets.head("file", "MB", "here, MB/s", "mhkit, MB/s", "times mhkit", "of plain reading")
        dolfyn.save(by_mhkit(small), str(made := folder / "small.nc"))
        cases = [("pd0", large, small), *(("nortek", one, one) for one in nortek), ("netcdf", made, made)]
        for kind, path, other in cases:
            ours = speed(path, lambda one, kind=kind: readers.read(kind, [one], KEYS[kind]))
            theirs, plain = library(other), speed(path, Path.read_bytes)
            told = (f"{theirs:.1f}", f"{ours / theirs:.1f}") if isinstance(theirs, float) else (theirs, "–")
            targets.line(path.name, f"{path.stat().st_size / 1e6:.1f}", f"{ours:.1f}", *told, f"{ours / plain:.3f}")
        print(f"\nPD0 by decode() alone, currents not turned: {speed(large, decode):.1f} MB/s")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else RAW)
