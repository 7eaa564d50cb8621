"""Formats of others: PD12 against an independent reading, dolfyn's netCDF against the PD0 reader, layouts, speed.

    python benchmarks/formats.py

Needs ../shared/data for the genuine files, MHKiT for dolfyn's and xarray for the speed of its own reading.
"""

from __future__ import annotations

import contextlib
import io
import logging
import re
import struct
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

import netcdf_layouts as layouts  # noqa: E402
from test_archive import make_product, write  # noqa: E402

from compasslib import angles, readers  # noqa: E402
from compasslib.records import Record  # noqa: E402

DATA = ROOT / ".." / "shared" / "data"
NETCDF = {"columns": None, "orientation": None, "declination_applied": None, "direction_reference": "magnetic"}
PD0 = dict.fromkeys(("orientation", "declination_applied", "heading_alignment", "serial_number"))
FIELDS = ("time_s", "east", "north", "heading_deg", "pitch_deg", "roll_deg", "temperature_c", "pressure_dbar")


def differences(one: Record, other: Any, fields: tuple[str, ...] = FIELDS) -> str:
    """Return the largest difference of each field that both know, angles by their shorter arc."""
    shown = []
    for name in fields:
        a, b = np.asarray(getattr(one, name)), np.asarray(getattr(other, name))
        n = min(len(a), len(b))
        gap = angles.difference(a[:n], b[:n]) if name == "heading_deg" else a[:n] - b[:n]
        shown.append(f"{name} {np.nanmax(np.abs(gap)):.1e}" if np.isfinite(gap).any() else f"{name} none")
    return ", ".join(shown)


def rate(read: Callable[[], object], size: int) -> float:
    """Return megabytes a second, the best of five."""
    times = []
    for _ in range(5):
        begun = time.perf_counter()
        read()
        times.append(time.perf_counter() - begun)
    return size / 1e6 / min(times)


def pd12() -> None:
    """Print the genuine telemetry against the reading that knew no escapes."""
    path = DATA / "moored/papa_node59p1.dat"
    keys = {"orientation": "up", "bin_size": 20.0, "first_bin": 24.7}
    record, other = readers.read("pd12", [path], keys), np.load(path.with_suffix(".npz"))
    order = np.argsort(record.time_s)
    at = order[np.searchsorted(record.time_s[order], other["time"].astype("datetime64[s]").astype(float))]
    found = {name: np.abs(getattr(record, f"{name}_deg")[at] - other[name]).max() for name in ("heading", "roll")}
    found |= {
        name: np.nanmax(np.abs(getattr(record, name)[at] - other["vel"][..., k]))
        for k, name in ((0, "east"), (1, "north"))
    }
    found |= {"temperature": np.abs(record.temperature_c[at] - other["temperature"]).max()}
    found |= {"pressure": np.abs(record.pressure_dbar[at] - other["pressure"]).max()}
    print(f"PD12 {path.name}: {record.counts}")
    print(f"  of {len(at)} ensembles of the other reading: " + ", ".join(f"{k} {v:.1e}" for k, v in found.items()))
    size = path.stat().st_size
    ours, theirs = rate(lambda: readers.read("pd12", [path], keys), size), rate(lambda: by_struct(path), size)
    print(
        f"  {ours:.0f} MB/s; no library at hand reads PD12: a loop of struct.unpack {theirs:.0f}, "
        f"ratio {ours / theirs:.1f}"
    )


def by_struct(path: Path) -> list[tuple[int, ...]]:
    """Return the velocities of each ensemble whose checksum holds, as a script of a page reads them: no escapes."""
    data, found = path.read_bytes(), []
    for match in re.finditer(rb"n\x7f", data):
        at = match.start()
        (size,) = struct.unpack_from("<H", data, at + 2)
        block = data[at : at + size + 2]
        if len(block) == size + 2 and sum(block[:-2]) & 0xFFFF == struct.unpack("<H", block[-2:])[0]:
            n = (size - 34) // 2
            found.append(struct.unpack_from(f"<{n}h", block, 34))
    return found


def dolfyn(folder: Path) -> None:
    """Print what MHKiT writes, read back, against the PD0 reader, and the speed beside xarray's."""
    import mhkit.dolfyn as library
    import xarray

    for name in ("RDI_withBT.000", "03160000.000", "adp_12.000"):
        with contextlib.redirect_stdout(io.StringIO()):
            data = library.read(str(DATA / "pd0" / name))
            if data.attrs["coord_sys"] != "earth":
                library.rotate2(data, "earth")
            library.save(data, str(path := folder / f"{name}.nc"))
        record = readers.read("netcdf", [path], NETCDF)
        print(f"dolfyn {name}: {differences(record, readers.read('pd0', [DATA / 'pd0' / name], PD0))}")
        for note in record.warnings:
            print(f"  {note}")
        size = path.stat().st_size
        ours = rate(lambda path=path: readers.read("netcdf", [path], NETCDF), size)
        loaded = rate(lambda path=path: xarray.open_dataset(path).load().close(), size)
        theirs = rate(lambda path=path: library.load(str(path)).load().close(), size)
        print(
            f"  {ours:.0f} MB/s; its own mhkit.dolfyn.load {theirs:.0f}, ratio {ours / theirs:.1f}; "
            f"xarray alone {loaded:.0f}"
        )


def imitated(folder: Path) -> None:
    """Print the layouts that are written here, read back."""
    for name in layouts.LAYOUTS:
        truth = layouts.write(folder / "a.nc", name)
        north = "true" if name == "oceansites" else "magnetic"
        record = readers.read("netcdf", [folder / "a.nc"], NETCDF | {"direction_reference": north})
        if north == "true":
            gaps = [
                np.nanmax(np.abs(a - b)) for a, b in zip((record.east, record.north), truth.true()[:2], strict=True)
            ]
            print(f"{name}: east {gaps[0]:.1e}, north {gaps[1]:.1e}")
        else:
            print(f"{name}: {differences(record, truth)}")


def own(folder: Path) -> None:
    """Print a product of this program, read back, against the record that it was made of."""
    product = make_product(2000, 20)
    write(folder / "corrected.nc", product)
    record = readers.read("netcdf", [folder / "corrected.nc"], NETCDF)
    east, north = angles.turn(product.east_recorded, product.north_recorded, -product.declination_deg[:, None])
    bins = record.bin_depth_m() - product.record.bin_depth_m()
    recorded = replace(product.record, east=east, north=north, pressure_dbar=record.pressure_dbar)
    print(f"corrected.nc: {differences(record, recorded)}, bin depths {np.nanmax(np.abs(bins)):.1e}")


def main() -> None:
    """Print all."""
    warnings.simplefilter("ignore")
    logging.disable(logging.CRITICAL)
    pd12()
    with tempfile.TemporaryDirectory() as folder:
        dolfyn(Path(folder))
        imitated(Path(folder))
        own(Path(folder))


if __name__ == "__main__":
    main()
