"""Intact files of every format with their readers, and damage at random."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np

from compasslib.demo import profiler
from compasslib.preparation.deployment import apply_deployment
from compasslib.preparation.pairs import PairRules, find_pairs
from compasslib.readers import iaga2002, mmp, netcdf, nmea, nortek, pd0, pd12, rdi_text, table
from compasslib.records import PROBABLY_GOOD, EarthField, Record
from tests.world import netcdf_layouts, pd12_files, rdi_text_files
from tests.world.iaga_files import series
from tests.world.iaga_files import write as write_observatory
from tests.world.nortek_encoder import ENU, Sample, configuration, older, signature, text
from tests.world.pd0_encoder import START, ensemble

METER = profiler.Acm(1405, "ML1405-01D", 65.27, -32.88, rate_hz=2.0)
COLUMNS = {"time": "t", "depth": "z", "east": "u", "north": "v", "scale": 0.01}
BODY = {"time": "t", "x": "x", "y": "y", "heading": "h", "scale": 0.01}
FIELD = EarthField(np.array([0.0, 4e9]), *np.full((4, 2), 100.0))
SETTLED = {"start_s": START.timestamp() - 1e5, "end_s": START.timestamp() + 1e6, "water_depth": 500.0}
NASTY = (b"\xff" * 40, b"\x00" * 40, b"\x7f\x7f" * 9, b"\r\n\r\n")
NASTY += (b",,,,", b"nan", b"1e999", b"-999", b"\x1a", b"$GPRMC,")


@dataclass(frozen=True)
class Kind:
    """One kind of file: an intact example, its reader, and the rows that it may give."""

    whole: bytes
    read: Callable[[Path], Any]
    rows: Callable[[Any], set[tuple[float, ...]]] | None = None  # good rows, for formats with checksums


def damaged(whole: bytes, rng: np.random.Generator) -> bytes:
    """Apply one to five faults: bytes changed, inserted or overwritten, pieces cut, lost, repeated or reversed."""
    data = whole
    for _ in range(rng.integers(1, 6)):
        begin, at = rng.integers(0, len(data) + 1, 2)
        end = begin + int(2 ** rng.uniform(0, 11))
        junk, octet = rng.bytes(int(2 ** rng.uniform(0, 9))), bytes([rng.choice([0, 0x7F, 0xFF, 0x30])])
        flipped, lines, first = bytearray(data), data.split(b"\n"), int(rng.integers(0, data.count(b"\n") + 1))
        for place in rng.integers(0, max(len(data), 1), rng.integers(1, 9)) if data else ():
            flipped[place] ^= int(rng.integers(1, 256))
        last = first + int(rng.integers(2, 9))
        data = [
            bytes(flipped),
            data[:at],
            data[at:],
            data[:begin] + data[end:],
            data[:at] + data[begin:end] + data[at:],
            data[:at] + junk + data[at:],
            data[:at] + NASTY[rng.integers(len(NASTY))] + data[at:],
            data[:begin] + octet * (end - begin) + data[end:],
            b"\n".join([*lines[:first], *lines[first:last][::-1], *lines[last:]]),
        ][rng.integers(9)]
    return data


def _pd0(path: Path) -> Record:
    record = pd0.read([path], orientation=None, declination_applied=None, heading_alignment=None)
    assert record.counts["bytes_total"] == path.stat().st_size
    return _through(record)


def _table(columns: dict[str, Any]) -> Callable[[Path], Record]:
    def read(path: Path) -> Record:
        record = table.read([path], columns=columns)
        kept = int(np.sum(np.isfinite(record.bin_range_m) & np.isfinite(record.time_s)[:, None]))
        lost = sum(record.counts[key] for key in ("rows_cut", "rows_repeated", "rows_contradict"))
        assert record.counts["rows"] >= len(record.time_s) + lost and kept >= len(record.time_s)
        return _through(record)

    return read


def _reader(read: Callable[..., Record], **settings: Any) -> Callable[[Path], Record]:
    return lambda path: _through(read([path], **settings))


def _netcdf(path: Path) -> Record:
    told = {"orientation": None, "declination_applied": None, "direction_reference": "magnetic"}
    return _through(replace(netcdf.read([path], columns=None, **told), serial_number=""))


def _through(record: Record) -> Record:
    """Run the later stages up to the pairs: whatever parses must not stop them."""
    for values in (record.east, record.north, record.heading_deg, record.time_s):
        assert not np.isinf(values).any()
    settled = apply_deployment(record, **SETTLED, latitude=60.0, nominal_depth=100.0)
    assert (np.diff(settled.time_s) > 0).all() and len(settled.quality) == len(settled.time_s)
    find_pairs(settled, [replace(settled, north=settled.north + 0.01, serial_number="")], FIELD, PairRules())
    return record


def _good(record: Record) -> set[tuple[float, ...]]:
    measured = np.isfinite(record.heading_deg)
    flags = record.heading_quality if measured.any() else record.quality[:, 0]  # of tables without headings
    good = np.flatnonzero(flags <= PROBABLY_GOOD)
    columns = [record.time_s, record.heading_deg, *record.east.T[:2], *record.north.T[:2]]
    return set(zip(*(np.round(np.nan_to_num(column[good], nan=-9.0), 4).tolist() for column in columns), strict=True))


def kinds(folder: Path) -> dict[str, Kind]:
    """Make an intact file of each kind, with temporary files in a folder."""
    rng = np.random.default_rng(0)
    write_observatory(folder / "obs.min", series(4))
    netcdf_layouts.write(folder / "a.nc", "imos_magnetic")
    scans = _scans(rng)
    profiler.write_text(folder / "acm.txt", METER, scans)
    profiler.write_binary(folder / "acm.dat", METER, scans)
    times = [f"{START + timedelta(hours=i):%Y-%m-%dT%H:%M:%SZ}" for i in range(40)]
    speeds = rng.normal(0, 20, (40, 2))
    moments = enumerate(zip(times, speeds, strict=True))
    rows = "".join(f"{at},{100 + i / 8:.3f},{u:.2f},{v:.2f}\n" for i, (at, (u, v)) in moments)
    body = rows.replace(",10", ",2", 5)
    acm = _reader(mmp.read, pressure_files=(), start_offset_seconds=0.0)
    short = _reader(pd12.read, orientation="up", bin_size=20.0, first_bin=24.7)
    return {
        "pd0": Kind(b"".join(_ensembles(rng)), _pd0, _good),
        "table": Kind(b"t,z,u,v\n" + rows.encode(), _table(COLUMNS)),
        "acm_table": Kind(b"t,h,x,y\n" + body.encode(), _table(BODY)),
        "mmp text": Kind((folder / "acm.txt").read_bytes(), acm),
        "mmp binary": Kind((folder / "acm.dat").read_bytes(), acm),
        "nortek": Kind(_samples(rng, older), _reader(nortek.read), _good),
        "ad2cp": Kind(_samples(rng, signature, 4), _reader(nortek.read), _good),
        "nmea0183": Kind(_log(), lambda path: nmea.read([path])),
        "iaga2002": Kind((folder / "obs.min").read_bytes(), lambda path: iaga2002.read([path])),
        "netcdf": Kind((folder / "a.nc").read_bytes(), _netcdf),
        "rdi_text": Kind(rdi_text_files.export().encode(), _reader(rdi_text.read, orientation=None)),
        "pd12": Kind(_telemetry(rng), short, _good),
    }


def _ensembles(rng: np.random.Generator) -> list[bytes]:
    return [
        ensemble(
            rng.integers(-400, 400, (4, 4)).tolist(),
            fixed={"up": True},
            extra=[b"\x00\x03" + rng.integers(40, 220, 16, dtype=np.uint8).tobytes()],
            number=i + 1,
            when=START + timedelta(hours=i),
            heading=int(rng.integers(0, 36000)),
            tilt1=int(rng.integers(-500, 500)),
            pressure=int(rng.integers(100_000, 110_000)),
        )
        for i in range(40)
    ]


def _telemetry(rng: np.random.Generator) -> bytes:
    profiles = enumerate(rng.integers(-400, 400, (40, 4, 4)).tolist())
    sent = (
        pd12_files.ensemble(i + 1, START + timedelta(hours=i), float(rng.uniform(0, 359)), profile)
        for i, profile in profiles
    )
    return pd12_files.framed([*sent])


def _samples(rng: np.random.Generator, written: Callable[..., bytes], beams: int = 3) -> bytes:
    velocities = rng.integers(-400, 400, (40, beams, 4)) / 1000.0
    samples = [Sample(k, v, float(k), minutes=60.0, begin=START) for k, v in enumerate(velocities)]
    if written is older:
        return configuration(ENU, 4) + b"".join(map(older, samples))
    return text() + b"".join(signature(sample, ENU) for sample in samples)


def _scans(rng: np.random.Generator) -> Any:
    sizes = np.array([30, 30])
    on = int(START.timestamp()) + 600 * np.arange(2)
    time_s = np.concatenate([on[k] + 15 + np.arange(n) // 2 for k, n in enumerate(sizes)])
    values = np.column_stack([rng.uniform(0, 359, 60), rng.normal(0, 2, (60, 2)), rng.normal(0, 0.4, (60, 3))])
    values = np.column_stack([values, rng.normal(0, 9, (60, 4))])
    return profiler.Scans(1 + np.arange(2), sizes, on, on + 60, time_s, np.round(values, 4))


def _log() -> bytes:
    bodies = []
    for k in range(40):
        place = "0854.979,S,14006.028,W"
        bodies += [f"HCHDG,{9 * k}.0,,,10,E", f"GPRMC,1904{k:02d},A,{place},5.0,{(9 * k + 12) % 360}.5,031110,10,E,A"]
    checks = [f"{np.bitwise_xor.reduce(np.frombuffer(body.encode(), np.uint8)):02X}" for body in bodies]
    return "".join(f"${body}*{check}\r\n" for body, check in zip(bodies, checks, strict=True)).encode()
