"""Detect the kind of a file from its first bytes, both supported formats and common unsupported ones.

The first match in ``KINDS`` (name, format, first bytes) applies. Errors can thus name the kind of a misdeclared file:

    raw/x.ad2cp: expected an RDI PD0 file, found a Nortek ad2cp file; write format: nortek

Sources: RDI Workhorse Commands and Output Data Format (PD0 7F7F, PD12 7F6E); Nortek System Integrator Guide (A5 05) and
Signature Principles (A5 0A); Unidata's NetCDF and HDF5 file formats; MAT-File Format; Sea Solutions of Sea-Bird.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from compasslib.errors import InputError, TransientError
from compasslib.readers import delimited, units
from compasslib.readers.files import MEGABYTE, NORTEK_START, TooLarge, detect_utf16, read_bytes, unreadable

HEAD_BYTES = 65536
READABLE = {
    "pd0": "an RDI PD0 file",
    "pd12": "an RDI PD12 file",
    "rdi_text": "a text export of RDI's programs",
    "nortek": "a Nortek file",
    **dict.fromkeys(("netcdf", "ocean_contour"), "a netCDF file"),
    "mmp_acm": "scans of a Falmouth 3D-ACM",
    "iaga2002": "an IAGA-2002 file",
    "nmea0183": "an NMEA 0183 log",
    "odv": "an ODV spreadsheet",
    "mat": "a MATLAB file",
} | dict.fromkeys(("table", "acm_table", "csv"), "a text table")
BINARY = ("pd0", "pd12", "nortek", "netcdf", "ocean_contour", "mat")
TEXTS = ("table", "acm_table", "csv", "rdi_text", "iaga2002", "nmea0183", "odv")
ELSEWHERE = {
    "iaga2002": "name it under covariates as {format: iaga2002, files: ...}",
    "nmea0183": "a calibration of kind swing reads it with format: nmea0183",
}
CONVERT = "export it as a text table and write format: table"
EXPORT = "give the file that the instrument or its program wrote"
RECORDED = "give the file that the instrument recorded"
UNPACK = "unpack it"
BELOW = "write format: table, skip_rows: (the number of lines up to {}) and columns by their numbers, or make it netCDF"


@dataclass(frozen=True)
class Kind:
    """A kind of file."""

    name: str  #: name with article, as used in messages
    form: str | None  #: format that reads it; None if unsupported
    holds: re.Pattern[bytes]  #: pattern matched at the first byte of the file
    advice: str = CONVERT  #: advice if no format reads it


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
    _kind("a MATLAB 7.3 file", "mat", rb"MATLAB 7\.3 MAT-file"),
    _kind("a MATLAB file", "mat", rb"MATLAB 5\.0 MAT-file"),
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
    _kind(
        "a text of Nortek's conversion, which has no header",
        None,
        rb"(?:\s*\d{1,2} +\d{1,2} +\d{4} +\d{1,2} +\d{1,2} +[\d.]+ +[01]{8} +[01]{8} [^\n]*\n)+",
        "give its .hdr too, in the same folder, with format: nortek; or format: table with columns by their numbers",
    ),
    _kind(
        "raw counts of an Aanderaa logger",
        None,
        rb"(?:[01]\d{3}(?:[ \t]+[01]\d{3}){3,}\s*\n){3}",
        "convert them by the coefficients of the sensors, and give a text table with format: table",
    ),
    _kind("an IOS shell file", None, rb"(?:\*[^\n]*\n){1,3}?\*IOS HEADER", BELOW.format("*END OF HEADER")),
    _kind("an ODF file", None, rb"\s*ODF_HEADER\s*,", BELOW.format("-- DATA --")),
    _kind("an ODV spreadsheet", "odv", rb"(?://[^\n]*\n)*Cruise[\t;]Station[\t;]"),
    _kind("a header file of Nortek's conversion", "nortek", rb"\[[^\]\n]*\.(?:aqd|prf|wpr|vec|hdr)\]\s"),
)
TABLE = _kind("a text table", "table", rb"")
PROSE = _kind("a text without columns", None, rb"", EXPORT)
_DIGITS = re.compile(rb"(?<![0-9A-Za-z.:])(?:[0-9A-Fa-f]{40,}|(?:[0-9A-Fa-f]{2} ){19,}[0-9A-Fa-f]{2})")
_PLAIN = bytes([*range(9, 14), *range(32, 127), *range(0xA0, 0xFF)])
# Start of a record: of RDI, of older Nortek instruments, of an ad2cp file, and after the header of a Falmouth 3D-ACM.
_BINARY_RECORD = re.compile(
    rb"(?=(?P<rdi>[n\x7f]\x7f)|(?P<older>\xa5(?:\x05\x18\0|\x04\x70\0|\0\0\x01))|(?P<ad2cp>\xa5[\x0a\x0c][\x15-\x2f\xa0])"
    rb"|(?P<acm>DATA[\0-\x17][\0-;][\0-;][\x01-\x0c][\x01-\x1f](?:[\xbc-\xff]\x07|[\0-\x33]\x08)))",
    re.DOTALL,
)


def detect_kind(path: str | Path) -> Kind | None:
    """Detect the kind of a file, None if unknown; the name of a gzip file includes the kind of its content.

    Raises:
        InputError: the file cannot be read.
    """
    try:
        with Path(path).open("rb") as file:
            head = file.read(HEAD_BYTES)
            kind = _kind_of_head(head)
            if kind is None or kind is ZEROS or (kind.form in TEXTS and not _is_text(head)):
                kind = _kind_of_record(head + file.read(MEGABYTE)) or kind
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
    """Replace a reader's error by one that names the actual kind of a file given with the wrong format.

    Args:
        offered: formats that the error may recommend.
        advice: advice if the detected format is not offered; by default that of the detected kind.

    Raises:
        InputError: the reader's own if every file is of its format or unknown, else one that names the kind.
    """
    try:
        yield
    except (TransientError, TooLarge):
        raise
    except InputError as error:
        for path in paths:
            kind = detect_kind(path) if Path(path).is_file() else None
            if kind is None or kind.name == "an empty file" or (kind in (TABLE, PROSE) and form in TEXTS):
                continue  # the reader's own message says more
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


def _copied_as_text(path: str | Path, fewest: int = 20) -> bool:
    """Return whether every line feed of a binary file follows a carriage return, as after a copy in text mode.

    Fewer line feeds may do so by chance.
    """
    try:
        data = read_bytes(path)
    except InputError:
        return False
    feeds = data.count(b"\n")
    return feeds >= fewest and feeds == data.count(b"\r\n")


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
    below = lines[len(lines) // 2 :]  # the second half, below any preamble of a table
    digits, letters = ([len(re.findall(pattern, line)) for line in below] for pattern in (rb"\d", rb"[A-Za-z]"))
    parted = (bool(re.search(rb"\S[,;|\t ]+\S", line)) for line in below)
    rows = sum(d > a and columns for d, a, columns in zip(digits, letters, parted, strict=True))
    return TABLE if 2 * rows >= len(below) else PROSE


def _hexadecimal(head: bytes) -> Kind | None:
    """Identify a binary file written as hexadecimal text; None unless most lines hold a long run of digits."""
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
    return len(head.translate(None, _PLAIN)) <= 0.02 * len(head)


def _kind_of_record(data: bytes) -> Kind | None:
    """Identify a file by the first binary record in it with a valid checksum, regardless of preceding bytes."""
    view = memoryview(data)
    for mark in _BINARY_RECORD.finditer(data):
        record, ad2cp = view[mark.start() :], bool(mark["ad2cp"])
        if mark["acm"]:
            return next(kind for kind in KINDS if kind.form == "mmp_acm")
        if mark["rdi"]:
            size = int.from_bytes(record[2:4], "little")
            stated = int.from_bytes(record[size : size + 2], "little")
            if 4 < size <= len(record) - 2 and sum(record[:size]) & 0xFFFF == stated:
                return next(kind for kind in KINDS if kind.form == ("pd12" if mark["rdi"][:1] == b"n" else "pd0"))
            continue
        # The last word is the checksum of the record, or of the header in an ad2cp file.
        size = record[1] if ad2cp else 2 * int.from_bytes(record[2:4], "little")
        if size <= len(record):
            *words, stated = struct.unpack(f"<{size // 2}H", record[:size])
            if (sum(words) + NORTEK_START) & 0xFFFF == stated:
                return next(kind for kind in KINDS if kind.form == "nortek" and ("ad2cp" in kind.name) == ad2cp)
    return None


_UNIT = re.compile(
    r"[\[(][^\])]*[\])]|_(?:m|metres?|deg|degrees?|dbar|c|degc|utc|gmt|kn|knots|nt|ut|counts)$|°|\s+utc$"
)
_FLOW = r"(?:velocity|vel|current|cur|comp|component|water)?"
_WORDS = {
    "time": r"(?:(?:record|sampl(?:e|ing)|measurement|observation|ensemble|utc|gmt)_?)?(?:date)?_?times?"
    r"(?:_?(?:utc|gmt))?"
    r"|(?:record|sample|measurement)_?date|(?:record_)?time_?stamp|date_?and_?time|utc|t|datenum|matlab_?(?:time|datenum)"
    r"|epoch|unix_?time|juld",
    "date": r"date|day|datum",
    "clock": r"time|clock|hour|hhmmss|time_of_day",
    "depth": r"depth|dep|instrument_?depth",
    "pressure": r"pressure|press|pres|p",
    "east": rf"u|ue|ve|ew|vel(?:ocity)?_?e|{_FLOW}_?east(?:ward|ern)?_?{_FLOW}|ucur|ewct|evel",
    "north": rf"v|vn|ns|vel(?:ocity)?_?n|{_FLOW}_?north(?:ward|ern)?_?{_FLOW}|vcur|nsct|nvel",
    "speed": r"(?:current|horizontal|water)?_?(?:speed|spd|magnitude|velocity|vel)|hcsp|abs_?speed",
    "direction": r"(?:current|horizontal|water|flow)?_?(?:direction|dir|dirn)|hcdt",
    "x": r"x|vx|vel(?:ocity)?_?x|x_?vel(?:ocity)?",
    "y": r"y|vy|vel(?:ocity)?_?y|y_?vel(?:ocity)?",
    "heading": r"heading|head|hdg|compass|yaw",
    "tilt_x": r"pitch|tilt_?x|tx",
    "tilt_y": r"roll|tilt_?y|ty",
    "temperature": r"(?:water_?)?temp(?:erature)?",
}
_PARTS = {  # of a time in several columns
    "year": r"y{2,4}|years?",
    "month": r"mm?|mo|mon|months?",
    "day": r"dd?|days?",
    "day_of_year": r"day_?of_?year|year_?day|doy|jday|julian_?day",
    "hour": r"hh?|hours?|hr",
    "minute": r"min|minutes?|mi|mn",
    "second": r"ss?|sec|seconds?",
}
_BENCH = {
    "reference_deg": r"reference|ref|bench|platform|table|set|true|known",
    "recorded_deg": r"recorded|rec|compass|heading|hdg|instrument|measured|read(?:ing)?",
}
_SWING = {
    "compass_deg": r"compass|heading|hdg|hdm|magnetic_?heading",
    "cog_deg": r"cog|course(?:_?over_?ground)?|track",
    "speed_kn": r"sog|speed(?:_?over_?ground)?",
    "time_utc": _WORDS["time"],
}
_MAGNETOMETER = {axis: rf"(?:mag(?:netometer)?|field|b|h|m)?_?{axis}" for axis in "xyz"} | {
    "pitch_deg": _WORDS["tilt_x"],
    "roll_deg": _WORDS["tilt_y"],
    "heading_deg": _WORDS["heading"],
    "time_utc": _WORDS["time"],
    "temperature_c": _WORDS["temperature"],
}
_ABOUT = ("depth", "pressure", "heading", "tilt_x", "tilt_y", "temperature")
_FLOWS = (("east", "north"), ("speed", "direction"), ("x", "y", "heading"))
# Kind of table, patterns of its column names, and required columns, in the order in which they are tried.
_TABLES: tuple[tuple[str, Mapping[str, str], tuple[str, ...]], ...] = (
    ("swing", _SWING, ("compass_deg", "cog_deg")),
    ("platform", _BENCH, ("reference_deg", "recorded_deg")),
    ("magnetometer", _MAGNETOMETER, ("x", "y", "z")),
)


@dataclass(frozen=True)
class GuessedTable:
    """Guessed kind, columns, velocity unit and reference north of a table."""

    kind: str  # instrument | platform | swing | magnetometer | series | pressure
    columns: dict[str, Any]  # role -> header; time may list the headers of its parts
    scale: float | None = None  # factor to m/s, None if the headers do not state the unit
    north: str | None = None  # magnetic or true, None if the headers do not state it


def guess_columns(path: Path) -> GuessedTable | None:
    """Guess the columns of a table from its header, None if it is inconclusive."""
    delimiters = list(delimited.DELIMITERS)[: -1 if _is_delimited(path) else None]  # names may then contain blanks
    head = delimited.find_head(
        path, lambda names: guess_from_names(names) is not None, must=True, delimiters=delimiters
    )
    return guess_from_names(head.names) if head else None


def _is_delimited(path: Path) -> bool:
    """Return whether a delimiter other than a blank splits most rows into as many cells as the header."""

    def names_columns(names: Sequence[str]) -> bool:
        return len(names) > 1 and all(re.search(r"[^\W\d_]", name) for name in names)

    for delimiter in delimited.DELIMITERS.keys() - {" "}:
        head = delimited.find_head(path, names_columns, must=True, delimiters=[delimiter])
        whole = [len(row) == len(head.names) for row in head.sample] if head else []
        if 2 * sum(whole) > len(whole):
            return True
    return False


def guess_from_names(names: Sequence[str]) -> GuessedTable | None:
    """Guess the columns of a table from its column names, None if they are inconclusive.

    >>> guess_from_names(["Date/Time", "Vel East [cm/s]", "Vel North [cm/s]", "Depth (m)"]).columns["east"]
    'Vel East [cm/s]'
    """
    columns: dict[str, Any] = dict(match_roles(names))
    parts = match_roles(names, _PARTS)
    if {"year", "month", "day"} <= {*parts} or {"year", "day_of_year"} <= {*parts}:
        last = ("day_of_year",) if "month" not in parts else ("month", "day", "hour", "minute", "second")
        columns = {role: header for role, header in columns.items() if role not in ("time", "date", "clock")}
        columns["time"] = [parts[part] for part in ("year", *last) if part in parts]
    if "date" in columns and not {"time", "clock"} & set(columns):
        columns["time"] = columns.pop("date")
    timed = "time" in columns or {"date", "clock"} <= set(columns)
    flow = next((roles for roles in _FLOWS if timed and set(roles) <= set(columns)), None)
    if flow and not ("x" in flow and match_roles(names, {"z": _MAGNETOMETER["z"]})):
        if {"date", "clock"} <= set(columns):
            columns.pop("time", None)
        about = _ABOUT if "time" in columns else ("date", "clock", *_ABOUT)
        chosen = {role: columns[role] for role in ("time", *flow, *about) if role in columns}
        stated = (units.stated_factor(role, [columns[role]]) for role in flow if role in units.FLOWS)
        factors = {factor for factor, _ in filter(None, stated)}
        north = units.stated_north({role: [header] for role, header in columns.items()})
        return GuessedTable("instrument", chosen, factors.pop() if len(factors) == 1 else None, north)
    for kind, words, must in _TABLES:
        roles = match_roles(names, words)
        if set(must) <= set(roles):
            return GuessedTable(kind, roles)
    if timed and "pressure" in columns and all(name in columns.values() for name in names):
        return GuessedTable("pressure", {role: columns[role] for role in ("time", "pressure") if role in columns})
    others = [name for name in names if name not in columns.values()]
    return GuessedTable("series", {"time": columns["time"], "value": others[0]}) if timed and len(others) == 1 else None


def match_roles(names: Iterable[str], words: Mapping[str, str] = _WORDS) -> dict[str, str]:
    """Match headers to roles: the first header that fits each role, used only once except for ``clock``."""
    plain = {name: _plain(name) for name in names}
    roles: dict[str, str] = {}
    for role, pattern in words.items():
        free = (name for name in plain if role == "clock" or name not in roles.values())
        match = next((name for name in free if re.fullmatch(pattern, plain[name])), None)
        if match is not None:
            roles[role] = match
    if roles.get("clock") == roles.get("time") and "date" not in roles:
        roles.pop("clock", None)
    return roles


def _plain(name: str) -> str:
    """Normalize a header: strip its unit, convert to lower case, and join its words by underscores."""
    unitless = units.SPEED_END.sub("", _UNIT.sub("", name.strip().lower()).strip())
    return re.sub(r"[\W_]+", "_", unitless).strip("_")
