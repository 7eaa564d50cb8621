"""Files as users have them, drawn by seed or genuine, and the draft that ``compass init`` makes of each."""

from __future__ import annotations

import functools
import gzip
import operator
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from datetime import datetime
from io import BytesIO, TextIOWrapper
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from compasslib import readers
from compasslib.cli import main
from compasslib.config.cruise import decided, undecided
from compasslib.errors import InputError
from tests.world import iaga_files, netcdf_layouts, nortek_encoder, pd0_encoder, pd12_files, tables
from tests.world.sea import SHARED

# Headers of exported tables: time (or date and clock), east, north, depth; factor to m/s, None if not stated.
HEADERS: tuple[tuple[tuple[str, ...], float | None], ...] = (
    (("Record Time", "East[cm/s]", "North[cm/s]", "Depth[m]"), 0.01),
    (("Date Time", "Velocity East (m/s)", "Velocity North (m/s)", "Depth (m)"), 1.0),
    (("DateTime", "Vel_E_mm_s", "Vel_N_mm_s", "Depth"), 0.001),
    (("time_utc", "u_cm_s", "v_cm_s", "depth_m"), 0.01),
    (("Time (UTC)", "Eastward velocity [m s-1]", "Northward velocity [m s-1]", "Depth [m]"), 1.0),
    (("Timestamp", "VE", "VN", "Dep"), None),
    (("Sample Time", "East Vel (cm/s)", "North Vel (cm/s)", "Instrument Depth (m)"), 0.01),
    (("Date/Time", "Current East cm/s", "Current North cm/s", "depth"), 0.01),
    (("Zeitpunkt", "Komponente A", "Komponente B", "Tiefe"), None),  # their roles cannot be inferred
)
HEADERS_APART = (
    (("Date", "Time", "East [cm/s]", "North [cm/s]", "Depth [m]"), 0.01),
    (("Date", "Clock", "u", "v", "depth"), None),
)
CELLS = [[100, 200, 3, 2]] * 4
JUNK = (b"", b"\0\0\xb5\0\0\xa6", b"[BREAK Wakeup A]\r\nWorkHorse\r\n>CS\r\n", bytes(5000), b"$GPZDA,1,2,3*00\r\n" * 4)


@dataclass(frozen=True)
class Case:
    """A file and its expected draft: an instrument, a calibration, or the reason why it is left out."""

    name: str
    write: Callable[[Path], Any]  # returns the true values of a table
    format: str = ""
    calibration: str = ""
    left: str = ""  # text of the message that gives the reason
    columns: Mapping[str, str] | None = None
    scale: float | None = None


def drawn(seed: int, n: int) -> list[Case]:
    """Draw n files: half of them tables of currents, the others of every other kind in turn."""
    rng = np.random.default_rng(seed)
    others = list(OTHERS)
    rng.shuffle(others)
    return [_table(rng, k) if k % 2 else others[k // 2 % len(others)](rng) for k in range(n)]


def genuine() -> list[Case]:
    """List the genuine files that are available."""
    centimetres = {"format": "table", "scale": 0.01}
    known = (
        ("swing/2010-11-03.Taiohae.nmea", {"calibration": "swing"}),
        ("pd0/eh2_20060530_20060717_0007m.000", {"format": "pd0"}),
        ("moored/aqd9330.npz", {"left": "zip"}),
        ("moored/papa_node59p1.dat", {"format": "pd12"}),
        ("acm/mmp_global_A0000001.TXT", {"format": "mmp_acm"}),
        ("acm/mmp_global_A0000001.DAT", {"format": "mmp_acm"}),
        ("observatory/esk20031029dmin.min", {"calibration": "declination"}),
        ("magnetometer/signature500.csv", {"calibration": "magnetometer"}),
        ("cruise_eh2/raw/E0/deep.csv", centimetres | {"columns": {"time": "time_utc", "east": "u_cm_s"}}),
        ("vectors.json", {"left": "JSON"}),
    )
    there = [(name, SHARED / name, expected) for name, expected in known if (SHARED / name).is_file()]
    return [Case(name, lambda path, source=source: path.symlink_to(source), **it) for name, source, it in there]


def outcome(case: Case) -> tuple[str, str]:
    """Draft one file alone; return ``right``, ``asked`` or ``wrong``, and the message or draft."""
    with tempfile.TemporaryDirectory() as folder:
        path, new = Path(folder, "M", Path(case.name).name), Path(folder, "new")
        path.parent.mkdir()
        truth, said = case.write(path), TextIOWrapper(BytesIO(), write_through=True)
        with redirect_stdout(said), redirect_stderr(said):
            failed = main(["init", str(path), "--into", str(new)])
        if failed:
            told = said.buffer.getvalue().decode()
            line = next((text for text in told.splitlines() if "left out" in text), told)
            right = case.left and case.left in line
            asked = case.format == "table" and "names no known columns" in line
            return "right" if right else "asked" if asked else "wrong", line.strip()
        texts = [yaml.safe_load(file.read_text()) for file in new.glob("config/*/*.yaml")]
        found = texts[0]
        if case.calibration:
            return "right" if found.get("kind") == case.calibration else "wrong", str(found)
        instrument = next(iter(found.get("instruments", {}).values()), {})
        return _judged(case, instrument, truth, new), str(instrument)


def _judged(case: Case, instrument: dict[str, Any], truth: Any, root: Path) -> str:
    columns = dict(instrument.get("columns", {}))
    scale = columns.pop("scale", None)
    wrong = [role for role, header in (case.columns or {}).items() if columns.get(role) != header]
    if case.left or instrument.get("format") != case.format or wrong or scale not in (case.scale, "DECIDE"):
        return "wrong"
    open_keys = {key.rpartition(".")[2] for key in undecided(instrument)} & {"scale", *readers.TABLE_KEYS}
    if case.format != "table" or open_keys - {"scale"}:
        return "asked" if open_keys else "right"
    try:
        record = readers.read("table", [root / instrument["files"]], decided(instrument))
    except InputError:
        return "wrong"
    if isinstance(truth, tables.Truth):
        factor = 100.0 * (case.scale or 1.0)
        same = len(record.time_s) == len(truth.time_s) and np.abs(record.time_s - truth.time_s).max() < tables.SURE_S
        pairs = ((record.east, truth.east), (record.north, truth.north))
        if not (same and all(np.allclose(a[:, 0], factor * b, atol=1e-9, equal_nan=True) for a, b in pairs)):
            return "wrong"
    return "asked" if open_keys else "right"


def _table(rng: np.random.Generator, k: int) -> Case:
    form = tables._drawn(rng)
    apart = form.time.startswith("apart")
    listed = HEADERS_APART if apart else HEADERS
    headers, scale = listed[int(rng.integers(len(listed)))]
    scale = 0.01 if form.units and scale is None else scale  # the unit row says so
    roles = ("date", "clock") if apart else ("time",)
    columns = dict(zip((*roles, "east", "north"), headers, strict=False))

    def write(path: Path) -> tables.Truth:
        return tables.write(path, form, headers)[0]

    return Case(f"table{k}.{rng.choice(['csv', 'txt', 'dat'])}", write, format="table", columns=columns, scale=scale)


def _binary(name: str, form: str, content: Callable[[], bytes]) -> Callable[[np.random.Generator], Case]:
    def make(rng: np.random.Generator) -> Case:
        data = JUNK[int(rng.integers(len(JUNK)))] + content()
        return Case(name, lambda path: path.write_bytes(data), format=form)

    return make


def _plain(name: str, content: Callable[[], bytes], **expected: str) -> Callable[[np.random.Generator], Case]:
    return lambda rng: Case(name, lambda path: path.write_bytes(content()), **expected)  # type: ignore[arg-type]


def _samples(beams: int) -> list[nortek_encoder.Sample]:
    return [nortek_encoder.Sample(k, np.full((beams, 4), 0.1 + 0.01 * k), heading=30.0 * k) for k in range(12)]


def _older() -> bytes:
    return nortek_encoder.configuration(0, 4) + b"".join(map(nortek_encoder.older, _samples(3)))


def _signature() -> bytes:
    return nortek_encoder.text() + b"".join(map(nortek_encoder.signature, _samples(4)))


def _pd0() -> bytes:
    hours = enumerate((datetime(2007, 9, 4 + k // 24, k % 24) for k in range(48)), 1)
    return b"".join(pd0_encoder.ensemble(CELLS, number=k, when=when, heading=700 * k % 36000) for k, when in hours)


def _pd12() -> bytes:
    sent = [pd12_files.ensemble(k, datetime(2013, 7, 23, k), 15.0 * k, CELLS) for k in range(1, 20)]
    return pd12_files.framed(sent, escape=False)


def sentences(*bodies: str) -> str:
    """Compose NMEA 0183 sentences with their checksums."""
    return "".join(f"${body}*{functools.reduce(operator.xor, body.encode()):02X}\r\n" for body in bodies)


def log(heading: str | None, course: str = "RMC", n: int = 72) -> str:
    """Compose an NMEA log of a turn in n steps of 5 degrees."""
    bodies = []
    for k in range(n):
        bodies += [heading.format(5 * k)] if heading else []
        bodies += [f"GPRMC,18{k // 60:02d}{k % 60:02d},A,0854.0,S,14006.0,W,5.0,{5 * k}.0,031110,10.7,E"]
        bodies += [f"GPVTG,{5 * k}.0,T,,M,5.0,N,9.3,K"] if course == "VTG" else []
    return sentences(*bodies)


def _archive(path: Path) -> None:
    with zipfile.ZipFile(path, "w") as packed:
        packed.writestr("top.000", "x")


def _rows(header: str, row: str) -> Callable[[], bytes]:
    return lambda: "\n".join([header, *map(row.format, range(36)), ""]).encode()


OTHERS: tuple[Callable[[np.random.Generator], Case], ...] = (
    _binary("top.000", "pd0", _pd0),
    _binary("top.log", "pd0", _pd0),
    _binary("modem.dat", "pd12", _pd12),
    _binary("meter.prf", "nortek", _older),
    _binary("meter.ad2cp", "nortek", _signature),
    lambda rng: Case("adcp.nc", lambda path: netcdf_layouts.write(path, "imos_magnetic"), format="netcdf"),
    lambda rng: Case("site.nc", lambda path: netcdf_layouts.write(path, "oceansites"), format="netcdf"),
    _plain("turn.nmea", lambda: log("HCHDG,{}.0,,,10.7,E").encode(), calibration="swing"),
    _plain("turn.log", lambda: log("HCHDM,{}.0,M", "VTG").encode(), calibration="swing"),
    _plain("gnss.nmea", lambda: log(None).encode(), left="no magnetic heading"),
    _plain("gyro.nmea", lambda: log("HEHDT,{}.0,T").encode(), left="no magnetic heading"),
    _plain("transit.nmea", lambda: log("HCHDG,{}.0,,,10.7,E", n=20).encode(), left="no swing"),
    _plain("dvl.txt", lambda: sentences(*["PNORC1,083013,132455,3,11.0,0.332"] * 9).encode(), left="telemetry"),
    _plain("bench.csv", _rows("reference_deg,recorded_deg", "{0}0,{0}2"), calibration="platform"),
    _plain("swing.csv", _rows("Compass,COG,SOG", "{0}0,{0}2,5"), calibration="swing"),
    _plain("mag.csv", _rows("time_utc,x,y,z", "2007-09-04T00:00:{0:02d}Z,{0},-{0},9"), calibration="magnetometer"),
    _plain("ctd.csv", _rows("time,pressure_dbar", "2007-09-04T00:00:{0:02d}Z,{0}"), left="table of pressure"),
    _plain("letter.txt", lambda: b"We moored it on Tuesday, in 800 m of water.\n" * 20, left="a text without columns"),
    _plain("photo.png", lambda: b"\x89PNG\r\n\x1a\n" + bytes(99), left="an image"),
    _plain("log.pdf", lambda: b"%PDF-1.7\n" + bytes(99), left="a PDF"),
    _plain("old.mat", lambda: b"MATLAB 5.0 MAT-file, Platform: GLNXA64" + bytes(99), left="MATLAB"),
    _plain("noise.bin", lambda: np.random.default_rng(1).bytes(5000), left="not known"),
    _plain("none.000", lambda: b"", left="an empty file"),
    _plain("erased.000", lambda: bytes(90_000), left="nothing but zeros"),
    _plain("top.000.gz", lambda: gzip.compress(_pd0()), left="gzip file that holds an RDI PD0"),
    lambda rng: Case("raw.zip", _archive, left="a zip archive"),
    lambda rng: Case("mde.min", lambda path: iaga_files.write(path, iaga_files.series(2)), calibration="declination"),
)
