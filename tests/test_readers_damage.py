"""The matrix of damage: every reader under every fault, on written files and, where they are there, on genuine ones.

R: what comes out is right, less what the damage took. X: refused in one line. PD0 and Nortek give only what was
recorded; the others too, unless a byte was changed inside a row.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import fuzz
import numpy as np
import pytest
from sea import SHARED

from compasslib.core.errors import InputError
from compasslib.readers import FORMATS, iaga2002, nmea

JUNK = np.random.default_rng(5).integers(0, 256, 300, dtype=np.uint8).tobytes()
TEXT = b"This is a letter about a mooring, and no recording of anything at all.\n" * 60
REAL = {
    "pd0": "pd0/eh2_20060530_20060717_0007m.000",
    "pd12": "moored/papa_node59p1.dat",
    "mmp text": "acm/mmp_global_A0000001.TXT",
    "mmp binary": "acm/mmp_global_A0000001.DAT",
    "nmea0183": "swing/2010-11-03.Taiohae.nmea",
    "iaga2002": "observatory/esk20031029dmin.min",
    "nortek": "moored/aqd9330.aqd",
}
REAL_BYTES = 60_000


def middle(data: bytes) -> int:
    return len(data) // 2 + 7


def inside(junk: bytes) -> Callable[[bytes], bytes]:
    return lambda data: data[: middle(data)] + junk + data[middle(data) :]


def flipped(data: bytes) -> bytes:
    at = middle(data)
    return data[:at] + bytes([data[at] ^ 0x10]) + data[at + 1 :]


def pieces(data: bytes) -> list[bytes]:
    """Return what a file is made of: ensembles, lines, or mere bytes."""
    if data[:2] == b"\x7f\x7f":
        length = int.from_bytes(data[2:4], "little") + 2
        return [data[k : k + length] for k in range(0, len(data), length)]
    return data.splitlines(keepends=True) if data.isascii() else [bytes([octet]) for octet in data]


def wrong_length(data: bytes) -> bytes:
    """A count of bytes or of records that says too much, in the second unit of the file."""
    second = len(pieces(data)[0]) + 2 if data[:2] == b"\x7f\x7f" else 0
    return data[:second] + b"\xff\x7f" + data[second + 2 :]


FAULTS: dict[str, Callable[[bytes], bytes]] = {
    "cut": lambda data: data[: middle(data)],
    "a flipped byte": flipped,
    "a wrong length": wrong_length,
    "missing bytes": lambda data: data[: middle(data)] + data[middle(data) + 17 :],
    "junk in front": lambda data: JUNK + data,
    "junk inside": inside(JUNK),
    "junk at the end": lambda data: data + JUNK,
    "a tail of FF": lambda data: data + b"\xff" * 4096,
    "a tail of 00": lambda data: data + b"\x00" * 4096,
    "twice": lambda data: data + data,
    "reversed": lambda data: b"".join(pieces(data)[::-1]),
    "empty": lambda data: b"",
    "text": lambda data: TEXT,
    "packed": lambda data: b"\x1f\x8b\x08\x00" + JUNK,
}
# Written files: which fault each reader sees through (R) and which it refuses (X).
KINDS = (
    *("pd0", "table", "acm_table", "mmp text", "mmp binary", "nmea0183", "iaga2002"),
    *("netcdf", "rdi_text", "pd12", "nortek", "ad2cp"),
)
MATRIX = {
    "cut":             "R R R R R R R X R R R R",
    "a flipped byte":  "R X X R R R R R X R R R",
    "a wrong length":  "R X X R R R R X X R R R",
    "missing bytes":   "R X X R R R R X X R R R",
    "junk in front":   "R X X R R R X X X R R R",
    "junk inside":     "R X X R R R R X X R R R",
    "junk at the end": "R X X R R R R R X R R R",
    "a tail of FF":    "R X X R R R R R X R R R",
    "a tail of 00":    "R R R R R R R R X R R R",
    "twice":           "R R R R R R R R X R R R",
    "reversed":        "R X X R X R X X X X X X",
    "empty":           "X X X X X X X X X X X X",
    "text":            "X X X X X X X X X X X X",
    "packed":          "X X X X X X X X X X X X",
}  # fmt: skip
SUMMED = ("pd0", "nortek", "ad2cp")  # formats with checksums
TOUCHED = ("a flipped byte", "a wrong length", "missing bytes", "junk inside")  # may change a row without a checksum

BY_ORDER = ("mmp text", "nmea0183")  # other scans come first in their profile, other headings next to their courses


@pytest.fixture(scope="module")
def kinds(tmp_path_factory) -> dict[str, fuzz.Kind]:
    """A whole file of each kind, and what its reader takes for rows."""
    made = fuzz.kinds(tmp_path_factory.mktemp("kinds"))
    made["nmea0183"] = replace(made["nmea0183"], rows=COURSE)
    made["iaga2002"] = replace(made["iaga2002"], rows=FIELD)
    made |= {name: replace(made[name], rows=SCAN) for name in ("mmp text", "mmp binary")}
    return {name: replace(kind, rows=kind.rows or fuzz._good) for name, kind in made.items()}


def _rows(*names: str) -> Callable[[object], set[tuple[float, ...]]]:
    def rows(found: object) -> set[tuple[float, ...]]:
        columns = [np.round(np.nan_to_num(getattr(found, name), nan=-9.0), 4) for name in names]
        return set(zip(*(column.tolist() for column in columns), strict=True))

    return rows


SCAN = _rows("heading_deg", "pitch_deg", "roll_deg")  # velocities within two seconds of a gap lose their swing less
COURSE = _rows("time_s", "heading_deg", "course_deg", "speed_kn")
FIELD = _rows("time_s", "declination_deg", "horizontal_nT")


def tried(kind: fuzz.Kind, data: bytes, folder: Path) -> set[tuple[float, ...]] | None:
    """Return the rows that came out, None where the file was refused in one line; the later stages are run too."""
    path = folder / "damaged"
    path.write_bytes(data)
    try:
        return kind.rows(kind.read(path))
    except InputError as error:
        assert "\n" not in str(error) and str(path) in str(error)
        return None


def held(name: str, fault: str, whole: set[tuple[float, ...]], found: set[tuple[float, ...]]) -> None:
    """What came out was recorded, and is most of it."""
    assert len(found) >= 0.4 * len(whole), len(found)
    if fault == "reversed" and name in BY_ORDER:
        return
    if name in SUMMED or fault not in TOUCHED:
        assert found <= whole
    else:
        assert len(found - whole) <= 2  # the row that was hit; in NMEA, a course that takes its neighbour's heading


def test_no_format_is_left_out():
    known = {"mmp text": "mmp_acm", "mmp binary": "mmp_acm", "ad2cp": "nortek"}
    assert {*FORMATS} <= {known.get(name, name) for name in KINDS}


@pytest.mark.parametrize("name", KINDS)
def test_every_reader_under_every_fault(kinds, tmp_path, name):
    whole = tried(kinds[name], kinds[name].whole, tmp_path)
    outcome = {}
    for fault, damage in FAULTS.items():
        found = tried(kinds[name], damage(kinds[name].whole), tmp_path)
        outcome[fault] = "X" if found is None else "R"
        if found is not None:
            held(name, fault, whole, found)
    column = KINDS.index(name)
    assert outcome == {fault: letters.split()[column] for fault, letters in MATRIX.items()}


@pytest.mark.parametrize("name", ["pd0", "mmp text", "mmp binary", "nmea0183", "iaga2002", "nortek", "ad2cp"])
@pytest.mark.parametrize("fault", ["junk in front", "junk inside", "junk at the end", "a tail of FF", "a tail of 00"])
def test_what_was_passed_over_is_counted_and_said(kinds, tmp_path, name, fault):
    if MATRIX[fault].split()[KINDS.index(name)] == "X":
        return
    (tmp_path / "damaged").write_bytes(FAULTS[fault](kinds[name].whole))
    found = kinds[name].read(tmp_path / "damaged")
    counted = [key for key in ("bytes_skipped", "damaged", "damaged_rows", "strange_bytes") if found.counts.get(key)]
    assert any(f"{found.counts[key]} " in said for key in counted for said in found.warnings), found.counts


@pytest.mark.parametrize("name", KINDS)
def test_a_file_of_each_other_kind_is_refused(kinds, tmp_path, name):
    pairs = [("mmp text", "mmp binary"), ("nortek", "ad2cp")]
    alike = {one: other for pair in pairs for one, other in (pair, pair[::-1])}  # one reader, which tells them apart
    for other in KINDS:
        if other not in (name, alike.get(name)):
            assert tried(kinds[name], kinds[other].whole, tmp_path) is None, other


@pytest.mark.parametrize("name", ["nmea0183", "iaga2002"])
def test_cut_at_every_byte_of_its_last_rows(kinds, tmp_path, name):
    """The other readers' own tests cut them at every byte."""
    data = kinds[name].whole
    whole = tried(kinds[name], data, tmp_path)
    for cut in range(1, 130):
        found = tried(kinds[name], data[:-cut], tmp_path)
        assert found <= whole and len(found) >= len(whole) - cut // 60 - 2


@pytest.mark.parametrize("name", REAL)
def test_genuine_files_under_every_fault(tmp_path, name):
    path = SHARED / REAL[name]
    if not path.exists():
        pytest.skip(f"{path} is not there")
    kind = genuine(name, path)
    whole = tried(kind, kind.whole, tmp_path)
    assert len(whole) > 50
    for fault, damage in FAULTS.items():
        found = tried(kind, damage(kind.whole), tmp_path)
        expected = MATRIX[fault].split()[KINDS.index(name)]
        assert (found is None) == (expected == "X"), fault
        if found is not None:
            held(name, fault, whole, found)


def genuine(name: str, path: Path) -> fuzz.Kind:
    """Return the first part of a genuine file, cut as a full disk would cut it."""
    readers = {
        "pd0": (fuzz._pd0, fuzz._good),
        "pd12": (fuzz._pd12, fuzz._good),
        "mmp text": (fuzz._mmp, SCAN),
        "mmp binary": (fuzz._mmp, SCAN),
        "nmea0183": (lambda file: nmea.read([file]), COURSE),
        "iaga2002": (lambda file: iaga2002.read([file]), FIELD),
        "nortek": (fuzz._nortek, SCAN),
    }
    read, rows = readers[name]
    return fuzz.Kind(path.read_bytes()[:REAL_BYTES], read, rows)
