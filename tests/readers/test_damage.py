"""Would catch a reader that crashes on a fault, loses more than it destroyed, or takes damage for data.

A matrix: every reader under every fault, on synthetic files and, where available, on genuine ones.

R: the result is correct except for what the fault destroyed. X: refused in one line. PD0 and Nortek give only recorded
values; the others too, unless a byte inside a row was changed.
"""

import gzip
import os
import re
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from compasslib import readers
from compasslib.errors import InputError
from compasslib.readers import FORMATS, files
from compasslib.records import Record
from tests.world import fuzz, pd0_encoder, pd12_files
from tests.world.pd0_encoder import START
from tests.world.pd12_files import escaped
from tests.world.sea import real

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
    """Split a file into ensembles, lines or bytes."""
    if data[:2] == b"\x7f\x7f":
        length = int.from_bytes(data[2:4], "little") + 2
        return [data[k : k + length] for k in range(0, len(data), length)]
    return data.splitlines(keepends=True) if data.isascii() else [bytes([octet]) for octet in data]


def wrong_length(data: bytes) -> bytes:
    """Set the length of the second PD0 ensemble too large; overwrite the first two bytes of other formats."""
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
# Outcome for synthetic files: R read in spite of the fault, X refused.
KINDS = (
    *("pd0", "table", "acm_table", "mmp text", "mmp binary", "nmea0183", "iaga2002"),
    *("netcdf", "rdi_text", "pd12", "nortek", "ad2cp"),
)
MATRIX = {
    "cut":             "R R R R R R R X R R R R",
    "a flipped byte":  "R X X R R R R R R R R R",
    "a wrong length":  "R X X R R R R X X R R R",
    "missing bytes":   "R R R R R R R X R R R R",
    "junk in front":   "R X X R R R X X X R R R",
    "junk inside":     "R X X R R R R X X R R R",
    "junk at the end": "R X X R R R R R X R R R",
    "a tail of FF":    "R X X R R R R R X R R R",
    "a tail of 00":    "R R R R R R R R R R R R",
    "twice":           "R X X R R R R R X R R R",
    "reversed":        "R X X R X R X X X X X X",
    "empty":           "X X X X X X X X X X X X",
    "text":            "X X X X X X X X X X X X",
    "packed":          "X X X X X X X X X X X X",
}  # fmt: skip
SUMMED = ("pd0", "nortek", "ad2cp")  # their checksums exclude rows that were not recorded
TOUCHED = ("a flipped byte", "a wrong length", "missing bytes", "junk inside")  # may change a row without a checksum

BY_ORDER = ("mmp text", "nmea0183")  # order determines the scan dropped from a profile and the pairing of headings


@pytest.fixture(scope="module")
def kinds(tmp_path_factory) -> dict[str, fuzz.Kind]:
    """An intact file of each kind, with the function that extracts its rows."""
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


SCAN = _rows("heading_deg", "pitch_deg", "roll_deg")  # velocities: the swing correction changes near gaps
COURSE = _rows("time_s", "heading_deg", "course_deg", "speed_kn")
FIELD = _rows("time_s", "declination_deg", "horizontal_nT")


def tried(kind: fuzz.Kind, data: bytes, folder: Path) -> set[tuple[float, ...]] | None:
    """Extract the rows of damaged data, run through the later stages; None if refused in one line."""
    path = folder / "damaged"
    path.write_bytes(data)
    try:
        return kind.rows(kind.read(path))
    except InputError as error:
        assert "\n" not in str(error) and str(path) in str(error)
        return None


def held(name: str, fault: str, whole: set[tuple[float, ...]], found: set[tuple[float, ...]]) -> None:
    """Assert that the rows were recorded and are at least 40 % of all."""
    assert len(found) >= 0.4 * len(whole), len(found)
    if fault == "reversed" and name in BY_ORDER:
        return
    if name in SUMMED or fault not in TOUCHED:
        assert found <= whole
    else:
        assert len(found - whole) <= 2  # the damaged row; in NMEA also a course paired with the next heading


def test_matrix_covers_every_format():
    known = {"mmp text": "mmp_acm", "mmp binary": "mmp_acm", "ad2cp": "nortek"}
    containers = {"mat", "odv", "ocean_contour"}  # read by scipy, by the reader of tables and by that of netCDF
    assert {*FORMATS} - containers <= {known.get(name, name) for name in KINDS}


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


CHECKED = ("pd0", "pd12", "nortek", "ad2cp", "mmp binary", "mmp text", "nmea0183", "iaga2002")


@pytest.mark.parametrize("name", CHECKED)
def test_cut_or_flipped_byte_costs_one_record(kinds, tmp_path, name):
    """Anywhere behind the header; without a checksum, a changed digit may be another valid number."""
    data, whole = kinds[name].whole, tried(kinds[name], kinds[name].whole, tmp_path)
    rng, before = np.random.default_rng(9), 0
    for at in np.sort(rng.integers(len(data) // 3, len(data), 12)).tolist():
        octet = bytes([data[at] ^ 1 << int(rng.integers(8))])
        found = tried(kinds[name], data[:at] + octet + data[at + 1 :], tmp_path)
        assert len(found) >= len(whole) - 1 and len(found - whole) <= (name not in (*SUMMED, "pd12")), at
        cut = tried(kinds[name], data[:at], tmp_path)
        assert cut <= whole and len(cut) >= before, at
        before = len(cut)


@pytest.mark.parametrize("name", ["pd0", "mmp text", "mmp binary", "nmea0183", "iaga2002", "nortek", "ad2cp"])
@pytest.mark.parametrize("fault", ["junk in front", "junk inside", "junk at the end", "a tail of FF", "a tail of 00"])
def test_skipped_bytes_are_counted_and_reported(kinds, tmp_path, name, fault):
    if MATRIX[fault].split()[KINDS.index(name)] == "X":
        return
    (tmp_path / "damaged").write_bytes(FAULTS[fault](kinds[name].whole))
    found = kinds[name].read(tmp_path / "damaged")
    counted = [key for key in ("bytes_skipped", "damaged", "damaged_rows", "strange_bytes") if found.counts.get(key)]
    assert any(f"{found.counts[key]} " in said for key in counted for said in found.warnings), found.counts


@pytest.mark.parametrize("name", KINDS)
def test_random_damage_causes_no_crash_hang_or_false_data(kinds, tmp_path, name):
    """More runs by COMPASSLIB_FUZZ_RUNS, others by COMPASSLIB_FUZZ_SEED."""
    kind, path, outcomes = kinds[name], tmp_path / "damaged", set()
    whole, seed = tried(kind, kind.whole, tmp_path), int(os.environ.get("COMPASSLIB_FUZZ_SEED", "7"))
    for number in range(int(os.environ.get("COMPASSLIB_FUZZ_RUNS", "20"))):
        path.write_bytes(fuzz.damaged(kind.whole, np.random.default_rng((seed, number))))
        begun = time.process_time()
        try:
            found = kind.rows(kind.read(path))
            assert found <= whole or name not in (*SUMMED, "pd12"), number
            outcomes.add("read")
        except InputError as error:
            assert "\n" not in str(error), number
            outcomes.add("refused")
        assert time.process_time() - begun < 5.0, number  # an intact file takes 10 ms
    assert outcomes == {"read", "refused"} or name == "netcdf"  # else the damage is too weak or too strong


@pytest.mark.parametrize("name", KINDS)
def test_files_of_other_formats_are_refused(kinds, tmp_path, name):
    pairs = [("mmp text", "mmp binary"), ("nortek", "ad2cp")]
    alike = {one: other for pair in pairs for one, other in (pair, pair[::-1])}  # one reader distinguishes the two
    for other in KINDS:
        if other not in (name, alike.get(name)):
            assert tried(kinds[name], kinds[other].whole, tmp_path) is None, other


def framed(data: bytes, instrument: bytes = b"WA1236822") -> bytes:
    return b"\x01%s_%04XH51F7BD60_CA_C5F6\x02%s\x03" % (instrument, len(data), escaped(data))


def of_record(name: str, data: bytes, folder: Path) -> Record:
    path = folder / "sent.dat"
    path.write_bytes(data)
    settings = {"orientation": "up", "bin_size": 20.0, "first_bin": 24.7} if name == "pd12" else {"pressure_files": ()}
    return readers.read(name, [path], settings)


def test_modem_escapes_are_undone_in_its_frames(kinds, tmp_path):
    """Including a file between frames of other instruments, and one truncated inside an escape pair."""
    whole = kinds["mmp binary"].whole
    assert whole.count(b"\x18") + whole.count(b"\x2b") > 4
    expected = _array(of_record("mmp_acm", whole, tmp_path))
    other = b"".join(framed(b"21.1493,06.51\r\n", b"CT1236822") for _ in range(20))
    for sent in (other + framed(whole) + other, framed(whole) + other + b"\x18"):
        record = of_record("mmp_acm", sent, tmp_path)
        np.testing.assert_array_equal(_array(record), expected)
        assert any("escapes" in line and "were undone" in line for line in record.warnings)


def _array(record: Record) -> np.ndarray:
    return np.column_stack([record.time_s, record.heading_deg, record.pitch_deg, record.east, record.north])


def test_profiles_split_over_modem_frames_are_joined(kinds, tmp_path):
    """A damaged frame loses its scans; a profile in two frames, or sent twice, is read once."""
    whole = kinds["mmp binary"].whole
    first, second = whole[: len(whole) // 2], whole[len(whole) // 2 :]
    expected = _array(of_record("mmp_acm", whole, tmp_path))
    parted = framed(first[:700]) + framed(b"21.1493", b"CT1236822") + framed(first[700:]) + framed(second)
    np.testing.assert_array_equal(_array(of_record("mmp_acm", parted + framed(second), tmp_path)), expected)
    record = of_record("mmp_acm", framed(first) + framed(second, b"WA1236820"), tmp_path)
    np.testing.assert_array_equal(_array(record), expected)
    assert any("holds frames of 2 instruments, WA1236822 and WA1236820" in line for line in record.warnings)
    torn = framed(first)[:-300] + framed(second)
    found = _array(of_record("mmp_acm", torn, tmp_path))
    assert 29 <= len(found) < len(expected) and {*map(tuple, found[-29:])} <= {*map(tuple, expected)}


def spoilt(name: str, data: bytes, share: float) -> bytes:
    """Damage two bytes in a share of the records, evenly spread over the file."""
    starts, inside = {
        "pd0": (rb"\x7f\x7f", 40), "pd12": (rb"n\x7f", 40), "nortek": (rb"\xa5\x20", 40),
        "ad2cp": (rb"\xa5\x0a\x16", 40),
        "mmp text": (rb"(?m)^ +\d\d-", 30), "nmea0183": (rb"\$", 8), "iaga2002": (rb"(?m)^\d{4}-", 30),
        "mmp binary": (rb"(?s)(?<=\xd7\x07.{40}).{3}[\x01-\x0c][\x01-\x1f](?=\xd7\x07)", 4),
    }[name]  # fmt: skip
    at = [match.start() + inside for match in re.finditer(starts, data)]
    copy = bytearray(data)
    for k in np.unique(np.linspace(0, len(at) - 1, round(share * len(at))).astype(int)):
        copy[at[k] : at[k] + 2] = b"~~"
    return bytes(copy)


@pytest.mark.parametrize("name", CHECKED)
def test_file_with_mostly_damaged_records_is_refused(kinds, tmp_path, name):
    data = kinds[name].whole
    path = tmp_path / "damaged"
    path.write_bytes(spoilt(name, data, 0.7))
    with pytest.raises(InputError, match=r"damaged: expected .* of which most are whole, found \d+ of \d+ that are d"):
        kinds[name].read(path)
    path.write_bytes(spoilt(name, data, 0.3))
    assert len(kinds[name].rows(kinds[name].read(path))) > 0


@pytest.mark.parametrize("name", [name for name in CHECKED if name not in ("mmp binary", "mmp text")])
def test_foreign_bytes_between_records_are_not_damage(kinds, tmp_path, name):
    """Random bytes with record markers, five times the data, or lines of other instruments do not hide any record."""
    rng = np.random.default_rng(8)
    data = kinds[name].whole
    if name in ("nmea0183", "iaga2002"):
        junk = b"\r\n".join([b" Station Name  21.1493, 6.5150, 36.9 |", b"$PXYZ,1,2,3", b"16 Nov 2013 21:00:00"] * 99)
        lines = data.split(b"\n")
        sent = b"\n".join([*lines[:-21], junk, *lines[-21:]])
    else:
        other = rng.integers(0, 256, 5 * len(data), dtype=np.uint8)
        marks = rng.integers(0, len(other) - 9, 400)
        mark = {"pd0": b"\x7f\x7f", "pd12": b"n\x7f", "nortek": b"\xa5\x20", "ad2cp": b"\xa5\x0a"}[name]
        for k, octet in enumerate(mark):
            other[marks + k] = octet
        sent = data + other.tobytes()
    (tmp_path / "mixed").write_bytes(sent)
    (tmp_path / "whole").write_bytes(data)
    whole, mixed = (kinds[name].rows(kinds[name].read(tmp_path / file)) for file in ("whole", "mixed"))
    assert whole <= mixed


@pytest.mark.parametrize("name", REAL)
def test_genuine_files_under_every_fault(kinds, tmp_path, name):
    """The first part of each file is used, truncated as by a full disk."""
    kind = replace(kinds[name], whole=real(REAL[name]).read_bytes()[:REAL_BYTES])
    kind = replace(kind, rows=SCAN) if name == "nortek" else kind
    whole = tried(kind, kind.whole, tmp_path)
    assert len(whole) > 50
    for fault, damage in FAULTS.items():
        found = tried(kind, damage(kind.whole), tmp_path)
        expected = MATRIX[fault].split()[KINDS.index(name)]
        assert (found is None) == (expected == "X"), fault
        if found is not None:
            held(name, fault, whole, found)


LARGE = [("table", True), ("nmea0183", False)]


@pytest.mark.parametrize(("name", "packed"), LARGE)
def test_too_large_text_is_refused_before_allocation(kinds, tmp_path, monkeypatch, name, packed):
    """The real limit is 256 MB; here it is 1 MB, exceeded by 60 MB of gzipped lines or 3 MB of plain ones."""
    data = kinds[name].whole + b"\n" * (files.MEGABYTE - len(kinds[name].whole))
    path = tmp_path / "large.csv"
    path.write_bytes(gzip.compress(data) if packed else data)
    monkeypatch.setattr(files, "LARGEST_TEXT", files.MEGABYTE)
    kinds[name].read(path)
    path.write_bytes(gzip.compress(data * 60) if packed else data * 3)
    tracemalloc.start()
    found = r"found 0\.\d MB that unpack to over 1 MB" if packed else r"found 3\.0 MB"
    with pytest.raises(InputError, match=rf"large.csv: expected a text of up to 1 MB, {found}; export means"):
        kinds[name].read(path)
    assert tracemalloc.get_traced_memory()[1] < 5 * files.MEGABYTE
    tracemalloc.stop()


@pytest.mark.parametrize("name", ["pd0", "pd12"])
def test_one_profile_of_many_bins_cannot_widen_all_others(tmp_path, monkeypatch, name):
    monkeypatch.setattr(files, "LARGEST_ARRAYS", files.MEGABYTE // 4)
    profiles = [[[1, 2, 3, 4]]] * 400 + [[[1, 2, 3, 4]] * 250]
    if name == "pd0":
        parts = [pd0_encoder.ensemble(profile, number=k) for k, profile in enumerate(profiles, 1)]
    else:
        parts = [pd12_files.ensemble(k, START, 10.0, profile) for k, profile in enumerate(profiles, 1)]
    with pytest.raises(InputError, match=r"sent.dat: expected profiles that take up to .* declares 250 cells"):
        of_record(name, b"".join(parts), tmp_path)
    assert of_record(name, b"".join(parts[:-1]), tmp_path).east.shape == (400, 1)
