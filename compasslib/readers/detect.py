"""The kind of a file by its first bytes: formats that are read, and those that people have at hand.

A line of ``KINDS`` is one kind of file: its name, the format that reads it, the bytes that it begins with. The
first that fits counts. So a wrong format is named instead of refused:

    raw/x.ad2cp: expected an RDI PD0 file, found a Nortek ad2cp file; write format: nortek

Sources: RDI Workhorse Commands and Output Data Format (PD0 7F7F, PD12 7F6E); Nortek System Integrator Guide (A5 05) and
Signature Principles (A5 0A); Unidata's NetCDF and HDF5 file formats; MAT-File Format; Sea Solutions of Sea-Bird.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from compasslib.errors import InputError, TransientError
from compasslib.readers.files import TooLarge, detect_utf16, read_bytes, unreadable

HEAD_BYTES = 65536
SEARCHED_BYTES = 2**20  # in which records are looked for where the first bytes tell nothing
TEXT_SHARE = 0.98  # of a text's bytes are printable
READABLE = {
    "pd0": "an RDI PD0 file",
    "pd12": "an RDI PD12 file",
    "rdi_text": "a text export of RDI's programs",
    "nortek": "a Nortek file",
    "netcdf": "a netCDF file",
    "mmp_acm": "scans of a Falmouth 3D-ACM",
    "table": "a text table",
    "acm_table": "a text table",
    "csv": "a text table",
    "iaga2002": "an IAGA-2002 file",
    "nmea0183": "an NMEA 0183 log",
}
BINARY, LINE_FEEDS = ("pd0", "pd12", "nortek", "netcdf"), 20  # so many by chance never all follow a carriage return
TEXTS = ("table", "acm_table", "csv", "rdi_text", "iaga2002", "nmea0183")
ELSEWHERE = {
    "iaga2002": "name it under covariates as {format: iaga2002, files: ...}",
    "nmea0183": "a calibration of kind swing reads it with format: nmea0183",
}
CONVERT = "export it as a text table and write format: table"
EXPORT = "give the file that the instrument or its program wrote"
RECORDED = "give the file that the instrument recorded"
UNPACK = "unpack it"


@dataclass(frozen=True)
class Kind:
    """A kind of file."""

    name: str  # with its article, as a message says it
    form: str | None  # the format that reads it
    holds: re.Pattern[bytes]  # matched at the file's first byte
    advice: str = CONVERT  # where no format reads it


def _kind(name: str, form: str | None, holds: bytes, advice: str = CONVERT) -> Kind:
    return Kind(name, form, re.compile(holds, re.DOTALL), advice)


ZEROS = _kind("a file of nothing but zeros", None, rb"\0+\Z", "copy or export it again")
KINDS = (
    _kind("an empty file", None, rb"\Z", "copy or export it again"),
    ZEROS,
    _kind("an RDI PD0 file", "pd0", rb"\x7f\x7f..\0"),
    _kind("an RDI PD12 file", "pd12", rb"n\x7f.[\0-\x0f]|.*<SampleData [^>]*>n\x7f"),
    _kind("a Nortek ad2cp file", "nortek", rb"\xa5[\x0a\x0c][\x15-\x2f\xa0]."),
    _kind("a Nortek file (aqd, prf, wpr or vec)", "nortek", rb"\xa5(\x05\x18\0|\x04\x70\0|\0\0\x01)"),
    _kind("a MATLAB 7.3 file", None, rb"MATLAB 7\.3 MAT-file"),
    _kind("a MATLAB file", None, rb"MATLAB 5\.0 MAT-file"),
    _kind("a netCDF file", "netcdf", rb"CDF[\x01\x02\x05]"),
    _kind("a netCDF-4 or HDF5 file", "netcdf", rb"\x89HDF\r\n\x1a\n"),
    _kind("an Excel workbook", None, rb"PK\x03\x04.*xl/(?:workbook|worksheets|styles|_rels)"),
    _kind("a file of an old Office program (Excel, Word)", None, rb"\xd0\xcf\x11\xe0"),
    _kind("a zip archive", None, rb"PK[\x03\x05][\x04\x06]", UNPACK),
    _kind("a gzip file", None, rb"\x1f\x8b\x08", UNPACK),
    _kind("a packed file (bzip2, xz, 7z or rar)", None, rb"BZh[1-9]|\xfd7zXZ\0|7z\xbc\xaf|Rar!", UNPACK),
    _kind("a PDF", None, rb"\s*%PDF-", EXPORT),
    _kind("an image", None, rb"\x89PNG|\xff\xd8\xff|GIF8[79]a|II\*\0|MM\0\*|BM....\0\0\0\0", EXPORT),
    _kind("an SQLite database (RBR's .rsk is one)", None, rb"SQLite format 3\0"),
    _kind("a Parquet file", None, rb"PAR1"),
    _kind("a Falmouth 3D-ACM's binary file", "mmp_acm", rb"(?:\x01[A-Z]{2}\d{7}_[^\x02]{21}\x02.{279,320}|.{279})DATA"),
    _kind("an IAGA-2002 file", "iaga2002", rb"[^\n]{0,999}Format\s+IAGA-2002"),
    _kind("a web page", None, rb"(?i)\s*(?:<!doctype html|<html)", EXPORT),
    _kind("an XML file", None, rb"\s*<\?xml", EXPORT),
    _kind("a text of a word processor (RTF)", None, rb"\{\\rtf", EXPORT),
    _kind("a JSON file", None, rb"\s*[{\[]\s*[\"{\[]"),
    _kind("a Sea-Bird file (cnv or hex)", None, rb"\s*\* ?Sea-?Bird"),
    _kind(
        "scans of a Falmouth 3D-ACM behind a logger's time stamps",
        None,
        rb"(?:[^\n]*\n){0,40}?[^\n]{0,40}\d[^\n]{0,9}[\s,;>\]]\d\d([-/])\d\d\1\d{4} \d\d:\d\d:\d\d"
        rb"(?:[ \t,]+-?\d+\.\d+){10}\s",
        "take the logger's time stamps off: a row begins with the meter's own (MM-DD-YYYY HH:MM:SS)",
    ),
    _kind("unpacked scans of a Falmouth 3D-ACM", "mmp_acm", rb"(?:[^\n]*\n){0,12}[^\n]*\bHDNG[\s,]+TX[\s,]+TY\b"),
    _kind(
        "telemetry of a Nortek instrument (NMEA sentences $PNOR...)",
        None,
        rb"(?:[^\n]*\n){0,20}[^\n]{0,40}\$PNOR",
        RECORDED,
    ),
    _kind("an NMEA 0183 log", "nmea0183", rb"(?:[^\n]*\n){0,20}[^\n]{0,40}[$!][A-Z]{2}[A-Z0-9]{3},[^\n]*\*[0-9A-F]{2}"),
    _kind(
        "a text export of RDI's programs",
        "rdi_text",
        rb"(?:[^\n]*\n){0,20}\s*(?:Pings/Ens|Time/Ping|First Ensemble (?:Date|Time)|1st Bin Range|Ensemble Interval)\b",
    ),
    _kind("a header file of Nortek's conversion", None, rb"\[[^\]\n]*\.(?:aqd|prf|wpr|vec|hdr)\]\s", EXPORT),
)
TABLE = _kind("a text table", "table", rb"")
PROSE = _kind("a text without columns", None, rb"", EXPORT)
_DIGITS = re.compile(rb"(?<![0-9A-Za-z.:])(?:[0-9A-Fa-f]{40,}|(?:[0-9A-Fa-f]{2} ){19,}[0-9A-Fa-f]{2})")
_PLAIN = bytes([*range(9, 14), *range(32, 127), *range(0xA0, 0xFF)])
# What begins a record: of RDI, of older Nortek instruments, of an ad2cp file, and behind a header of a Falmouth 3D-ACM.
_BINARY_RECORD = re.compile(
    rb"(?=(?P<rdi>[n\x7f]\x7f)|(?P<older>\xa5(?:\x05\x18\0|\x04\x70\0|\0\0\x01))|(?P<ad2cp>\xa5[\x0a\x0c][\x15-\x2f\xa0])"
    rb"|(?P<acm>DATA[\0-\x17][\0-;][\0-;][\x01-\x0c][\x01-\x1f](?:[\xbc-\xff]\x07|[\0-\x33]\x08)))",
    re.DOTALL,
)
NORTEK_START = 0xB58C  # of a checksum's sum of words


def detect_kind(path: str | Path) -> Kind | None:
    """Detect the kind of a file, None where nobody knows; of a gzip file with a known kind inside both are named.

    Raises:
        InputError: it cannot be read.
    """
    try:
        with Path(path).open("rb") as file:
            head = file.read(HEAD_BYTES)
            kind = _kind_of_head(head)
            if kind is None or kind is ZEROS or (kind.form in TEXTS and not _is_text(head)):
                kind = _kind_of_record(head + file.read(SEARCHED_BYTES - len(head))) or kind
    except OSError as error:
        raise unreadable(path, error) from None
    if kind is None or kind.name != "a gzip file":
        return kind
    try:
        inner = _kind_of_head(zlib.decompressobj(wbits=31).decompress(head, HEAD_BYTES))
    except zlib.error:
        return kind
    packed = f"a gzip file that holds {inner.name}" if inner else kind.name
    return Kind(packed, inner.form if inner is TABLE else None, kind.holds, UNPACK)


@contextmanager
def format_hints(
    form: str, paths: Sequence[str | Path], *, offered: Collection[str] = (), advice: str = ""
) -> Iterator[None]:
    """Say, where a reader refuses its files, which of them is of another kind and what reads that.

    Args:
        advice: what to do where the kind found is not among these; by the kind where empty.

    Raises:
        InputError: the reader's own where every file is of its format or unknown, else one that names the kind.
    """
    try:
        yield
    except (TransientError, TooLarge):
        raise
    except InputError as error:
        for path in paths:
            kind = detect_kind(path) if Path(path).is_file() else None
            if kind is None or kind.name == "an empty file" or (kind in (TABLE, PROSE) and form in TEXTS):
                continue  # the reader's own words say more
            if kind.form is None or READABLE.get(kind.form) != READABLE.get(form):
                expected = READABLE.get(form, f"a file of format {form}")
                to_do = advice or ELSEWHERE.get(kind.form or "", kind.advice)
                to_do = f"write format: {kind.form}" if kind.form in offered else to_do
                raise InputError(str(path), expected=expected, found=kind.name, advice=to_do) from None
        if as_text := next((path for path in paths if form in BINARY and _copied_as_text(path)), None):
            shown = "one copied as text: a carriage return stands before every line feed"
            to_do = "copy it again from the instrument in binary mode"
            raise InputError(str(as_text), expected=READABLE[form], found=shown, advice=to_do) from None
        raise error from None


def _copied_as_text(path: str | Path) -> bool:
    """Tell a file in which a carriage return stands before every line feed, of which bytes hold many by chance."""
    try:
        data = read_bytes(path)
    except InputError:
        return False
    feeds = data.count(b"\n")
    return feeds >= LINE_FEEDS and feeds == data.count(b"\r\n")


def _kind_of_head(head: bytes) -> Kind | None:
    if kind := next((each for each in KINDS if each.holds.match(head)), None):
        return kind
    if hexadecimal := _hexadecimal(head):
        return hexadecimal
    if wide := detect_utf16(head):
        head = head[: len(head) // 2 * 2].decode(wide, errors="replace").encode("latin-1", errors="replace")
    if not _is_text(head):
        return None
    lines = [line for line in head.splitlines() if line.strip()]
    below = lines[len(lines) // 2 :]  # whatever stands above a table
    digits, letters = ([len(re.findall(pattern, line)) for line in below] for pattern in (rb"\d", rb"[A-Za-z]"))
    parted = (bool(re.search(rb"\S[,;|\t ]+\S", line)) for line in below)
    rows = sum(d > a and columns for d, a, columns in zip(digits, letters, parted, strict=True))
    return TABLE if 2 * rows >= len(below) else PROSE


def _hexadecimal(head: bytes) -> Kind | None:
    """Identify the binary file in a text of hexadecimal digits, None where few lines hold a long row of them."""
    lines = [line for line in head.splitlines() if line.strip()]
    rows = [(line, row[0]) for line in lines if (row := _DIGITS.search(line))]
    digits = b"".join(row.replace(b" ", b"") for _, row in rows)
    if 2 * len(rows) <= len(lines) or digits.isdigit():
        return None
    octets = bytes.fromhex(digits[: len(digits) // 2 * 2].decode())
    binary = next((kind for kind in KINDS if kind.form in (*BINARY, "mmp_acm") and kind.holds.match(octets)), None)
    name = binary.name if binary else "a binary file"
    stamped = any(b":" in line[: line.find(row)] for line, row in rows)
    advice = f"turn the digits{' behind the stamps' * stamped} into bytes (xxd -r -p)"
    advice += f" and write format: {binary.form}" if binary else ""
    return Kind(f"{name} written as hexadecimal text{' behind time stamps' * stamped}", None, _DIGITS, advice)


def _is_text(head: bytes) -> bool:
    return len(head.translate(None, _PLAIN)) <= (1.0 - TEXT_SHARE) * len(head)


def _kind_of_record(data: bytes) -> Kind | None:
    """Identify a file by the first binary record in it whose checksum holds, whatever stands before."""
    view = memoryview(data)
    for mark in _BINARY_RECORD.finditer(data):
        record, ad2cp = view[mark.start() :], bool(mark["ad2cp"])
        if mark["acm"]:
            return next(kind for kind in KINDS if kind.form == "mmp_acm")
        if mark["rdi"] and _rdi_checksum_holds(record):
            return next(kind for kind in KINDS if kind.form == ("pd12" if mark["rdi"][:1] == b"n" else "pd0"))
        if not mark["rdi"] and _nortek_checksum_holds(record, header=ad2cp):
            return next(kind for kind in KINDS if kind.form == "nortek" and ("ad2cp" in kind.name) == ad2cp)
    return None


def _rdi_checksum_holds(record: memoryview) -> bool:
    size = int.from_bytes(record[2:4], "little")
    stated = int.from_bytes(record[size : size + 2], "little")
    return 4 < size <= len(record) - 2 and sum(record[:size]) & 0xFFFF == stated


def _nortek_checksum_holds(record: memoryview, *, header: bool) -> bool:
    """Tell whether the sum of a record's words, or of those of an ad2cp file's header, is its last word."""
    size = record[1] if header else 2 * int.from_bytes(record[2:4], "little")
    if size > len(record):
        return False
    *words, stated = struct.unpack(f"<{size // 2}H", record[:size])
    return (sum(words) + NORTEK_START) & 0xFFFF == stated
