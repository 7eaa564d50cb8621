"""Detect the kind of a file from its first bytes, so that errors can name it and drafts can use it.

Sources: RDI Workhorse Commands and Output Data Format (PD0 7F7F, PD12 7F6E); Nortek System Integrator Guide (A5 05) and
Signature Principles (A5 0A); Unidata's NetCDF and HDF5 file formats; MAT-File Format; Sea Solutions of Sea-Bird.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from compasslib.errors import InputError, TransientError
from compasslib.readers import delimited, vocabulary
from compasslib.readers.files import GZIP_MAGIC, LATIN_TEXT, MEGABYTE, TooLarge, is_utf16, unreadable

HEAD_BYTES = 65536
ALIKE = {"acm_table": "table", "csv": "table", "ocean_contour": "netcdf"}  # formats of one kind of file
TEXTS = ("table", "acm_table", "csv", "rdi_text", "iaga2002", "nmea0183", "odv")
ELSEWHERE = {
    "iaga2002": "name it under covariates as {format: iaga2002, files: ...}",
    "nmea0183": "a calibration of kind swing reads it with format: nmea0183",
}
CONVERT = "export it as a text table and write format: table"
EXPORT = "give the file that the instrument or its program wrote"
UNPACK = "unpack it"
AGAIN = "copy or export it again"
SKIP = "write format: table, skip_rows: (the number of lines up to {}) and columns by their numbers{}"


@dataclass(frozen=True)
class Kind:
    """A kind of file."""

    name: str  # with article, as used in messages
    form: str | None  # format that reads it; None if unsupported
    holds: bytes = b""  # pattern matched at the first byte of the file
    advice: str = CONVERT  # if no format reads it


EMPTY = Kind("an empty file", None, rb"\Z", AGAIN)
ZEROS = Kind("a file of nothing but zeros", None, rb"\0+\Z", AGAIN)
PD0 = Kind("an RDI PD0 file", "pd0", rb"\x7f\x7f..\0")
IOS_TIMES = (
    "; without a column of times, add one in a copy: START TIME plus TIME INCREMENT a row (PST: timezone: '-08:00')"
)
BELOW = (  # tables below a header
    Kind("an IOS shell file", None, rb"(?:\*[^\n]*\n){1,3}?\*IOS HEADER", SKIP.format("*END OF HEADER", IOS_TIMES)),
    Kind("an ODF file", None, rb"\s*ODF_HEADER\s*,", SKIP.format("-- DATA --", " (a time is two: date: 1, clock: 2)")),
)
KINDS = (
    EMPTY,
    ZEROS,
    PD0,
    Kind("an RDI PD12 file", "pd12", rb"n\x7f.[\0-\x0f]|.*<SampleData [^>]*>n\x7f"),
    Kind("a Nortek file", "nortek", rb"\xa5(?:[\x0a\x0c][\x15-\x2f\xa0].|\x05\x18\0|\x04\x70\0|\0\0\x01)"),
    Kind("a MATLAB file", "mat", rb"MATLAB (?:5\.0|7\.3) MAT-file"),
    Kind("a netCDF file", "netcdf", rb"CDF[\x01\x02\x05]"),
    Kind("a netCDF-4 or HDF5 file", "netcdf", rb"\x89HDF\r\n\x1a\n"),
    Kind("a file of Office (Excel, Word)", None, rb"PK\x03\x04.*(?:xl|word)/|\xd0\xcf\x11\xe0"),
    Kind("a packed file", None, rb"PK[\x03\x05][\x04\x06]|BZh[1-9]|\xfd7zXZ\0|7z\xbc\xaf|Rar!", UNPACK),
    Kind("a database (SQLite, RBR's .rsk, Parquet or JSON)", None, rb"SQLite format 3\0|PAR1|\s*[{\[]\s*[\"{\[]"),
    Kind(
        "an image or a document",
        None,
        rb"(?i)\s*(?:%PDF-|<!doctype html|<html|<\?xml|\{\\rtf)|\x89PNG|\xff\xd8\xff|GIF8[79]a|II\*\0|MM\0\*",
        EXPORT,
    ),
    Kind("scans of a Falmouth 3D-ACM", "mmp_acm", rb"(?:\x01[A-Z]{2}\d{7}_[^\x02]{21}\x02.{279,320}|.{279})DATA"),
    Kind("an IAGA-2002 file", "iaga2002", rb"[^\n]{0,999}Format\s+IAGA-2002"),
    Kind("a Sea-Bird file (cnv or hex)", None, rb"\s*\* ?Sea-?Bird"),
    Kind("unpacked scans of a Falmouth 3D-ACM", "mmp_acm", rb"(?:[^\n]*\n){0,12}[^\n]*\bHDNG[\s,]+TX[\s,]+TY\b"),
    Kind(
        "telemetry of a Nortek instrument (NMEA sentences $PNOR...)",
        None,
        rb"(?:[^\n]*\n){0,20}[^\n]{0,40}\$PNOR",
        "give the file that the instrument recorded",
    ),
    Kind("an NMEA 0183 log", "nmea0183", rb"(?:[^\n]*\n){0,20}[^\n]{0,40}[$!][A-Z]{2}[A-Z0-9]{3},[^\n]*\*[0-9A-F]{2}"),
    Kind(
        "a text export of RDI's programs",
        "rdi_text",
        rb"(?:[^\n]*\n){0,20}\s*(?:Pings/Ens|Time/Ping|First Ensemble (?:Date|Time)|1st Bin Range|Ensemble Interval)\b",
    ),
    Kind(
        "a text of Nortek's conversion, which has no header",
        None,
        rb"(?:\s*\d{1,2} +\d{1,2} +\d{4} +\d{1,2} +\d{1,2} +[\d.]+ +[01]{8} +[01]{8} [^\n]*\n)+",
        "give its .hdr too, in the same folder, with format: nortek; or format: table with columns by their numbers",
    ),
    Kind(
        "raw counts of an Aanderaa logger",
        None,
        rb"(?:[01]\d{3}(?:[ \t]+[01]\d{3}){3,}\s*\n){3}",
        "convert them by the coefficients of the sensors, and give a text table with format: table",
    ),
    Kind(
        "a pointer of Git LFS or git-annex to a file that is elsewhere",
        None,
        rb"version https://git-lfs\.|(?:\.\.?)?/\S*annex/objects/",
        "fetch the file itself (git lfs pull, or git annex get)",
    ),
    Kind(
        "RDI PD15 ensembles, as relayed by satellite",
        None,
        rb".{0,80}?_w[~\x7f]",
        "give the recording of the instrument; or join the low six bits of each character, from _w on, to a PD0 file",
    ),
    *BELOW,
    Kind("an ODV spreadsheet", "odv", rb"(?://[^\n]*\n)*Cruise[\t;]Station[\t;]"),
    Kind(
        "a binary file written as hexadecimal text",
        None,
        rb"(?:[^\n]*\n)?[^\n]{0,80}?(?<![\w.:])(?=\d*[A-Fa-f])[\dA-Fa-f]{40}",
        "turn the digits alone, without time stamps between them, into bytes (xxd -r -p)",
    ),
    Kind("a header file of Nortek's conversion", "nortek", rb"(?i)\[[^\]\n]*\.(?:aqd|prf|wpr|vec|hdr)\]\s"),
)
TABLE = Kind("a text table", "table")
PROSE = Kind("a text without columns", None, advice=EXPORT)


def detect_kind(path: str | Path) -> Kind | None:
    """Detect the kind of a file, None if unknown; the name of a gzip file includes the kind of its content.

    Raises:
        InputError: the file cannot be read.
    """
    from compasslib.readers.pd0.frames import scan

    try:
        with Path(path).open("rb") as file:
            head = file.read(HEAD_BYTES)
            packed = head.startswith(GZIP_MAGIC)
            if packed:
                head = zlib.decompressobj(wbits=31).decompress(head, HEAD_BYTES)
            kind = next((each for each in KINDS if re.match(each.holds, head, re.DOTALL)), None) or _kind_of_text(head)
            if not packed and (kind is None or kind is ZEROS or (kind.form in TEXTS and not _is_text(head))):
                kind = PD0 if scan(head + file.read(MEGABYTE))[0] else kind  # ensembles behind other bytes
    except zlib.error:
        return Kind("a gzip file", None, advice=UNPACK)
    except OSError as error:
        raise unreadable(path, error) from None
    if kind is None or not packed:
        return kind
    form = kind.form if kind is TABLE else None
    return replace(kind, name=f"a gzip file that holds {kind.name}", form=form, advice=UNPACK)


@contextmanager
def format_hints(
    form: str, paths: Sequence[str | Path], *, offered: Collection[str] = (), advice: str = "", skipped: bool = False
) -> Iterator[None]:
    """Replace a reader's error by one that names the actual kind of a file given with the wrong format.

    Args:
        offered: formats that the error may recommend.
        advice: advice if the detected format is not offered; by default that of the detected kind.
        skipped: whether the reader was told to skip the header above a table.

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
            known = (kind in (TABLE, PROSE) and form in TEXTS) or (kind in BELOW and skipped)
            if kind is None or kind is EMPTY or known:
                continue  # the reader's own message says more
            if ALIKE.get(kind.form or "", kind.form) != (alike := ALIKE.get(form, form)):
                expected = next(
                    (each.name for each in (*KINDS, TABLE) if each.form == alike), f"a file of format {form}"
                )
                to_do = advice or ELSEWHERE.get(kind.form or "", kind.advice)
                to_do = f"write format: {kind.form}" if kind.form in offered else to_do
                raise InputError(str(path), expected=expected, found=kind.name, advice=to_do) from None
        raise error from None


def _kind_of_text(head: bytes) -> Kind | None:
    """Tell a table from prose by the second half of the lines, below any preamble; None for other bytes."""
    if is_utf16(head):
        head = head[: len(head) // 2 * 2].decode("utf-16", errors="replace").encode("latin-1", errors="replace")
    if not _is_text(head):
        return None
    lines = [line for line in head.splitlines() if line.strip()]
    below = lines[len(lines) // 2 :]
    numeric = [line for line in below if len(re.findall(rb"\d", line)) > len(re.findall(rb"[A-Za-z]", line))]
    rows = sum(bool(re.search(rb"\S[,;|\t ]+\S", line)) for line in numeric)
    return TABLE if 2 * rows >= len(below) else PROSE


def _is_text(head: bytes) -> bool:
    return len(head.translate(None, LATIN_TEXT)) <= 0.02 * len(head)


_UNIT = re.compile(
    r"[\[(][^\])]*[\])]|_(?:m|metres?|deg|degrees?|dbar|c|degc|utc|gmt|kn|knots|nt|ut|counts)$|°|\s+utc$"
)
# Ve true, direction (magnetic); of a heading, the north tells a compass from a course.
_NORTH = re.compile(r"^(?!.*(?:head|hdg|compass))(.*\w)[\s_]+\(?(?:true|magnetic)\)?$")
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
    "year": r"y{2,4}|yrs?|years?",
    "month": r"mm?|mo|mon|months?",
    "day": r"dd?|days?",
    "day_of_year": r"day_?of_?year|year_?day|doy|jday|julian_?day",
    "hour": r"hh?|hours?|hr",
    "minute": r"min|minutes?|mi|mn",
    "second": r"ss?|sec|seconds?",
}
_BENCH = {
    "reference_deg": r"reference|ref|bench|platform|table|true|known",
    "recorded_deg": r"recorded|rec|compass|heading|hdg|instrument|measured|read(?:ing)?",
}
_SWING = {
    "compass_deg": r"compass|heading|hdg|hdm|magnetic_?heading",
    "cog_deg": r"(?:\w+_)?cog|course(?:_?over_?ground)?|track",
    "speed_kn": r"(?:\w+_)?sog|speed(?:_?over_?ground)?",
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
    head = delimited.find_head(path, lambda names: guess_from_names(names) is not None, must=True)
    guess = guess_from_names(head.names) if head else None
    if head is None or guess is None:
        return None
    if head.delimiter == " ":  # columns, or words of one name: columns part most rows alike
        alike = sum(len(row) == len(head.names) for row in head.sample)
        if 2 * alike < len(head.sample) or re.search("[\t;,]", head.text):
            return None
    flow = [head.names.index(guess.columns[role]) for role in vocabulary.FLOWS if role in guess.columns]
    return guess_from_names(head.names, delimited.unit_lines(head, flow))


def guess_from_names(names: Sequence[str], below: Sequence[Sequence[str]] = ()) -> GuessedTable | None:
    """Guess the columns of a table from its column names and unit lines, None if they are inconclusive.

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
        at = {role: names.index(header) for role, header in chosen.items() if header in names}
        said = {role: [row[k] for row in (names, *below) if k < len(row)] for role, k in at.items()}
        stated = (vocabulary.stated_factor(role, said[role]) for role in flow if role in vocabulary.FLOWS)
        factors = {factor for factor, _ in filter(None, stated)}
        north = vocabulary.stated_north(said)
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
    unitless = {name: vocabulary.SPEED_END.sub("", _UNIT.sub("", name.strip().lower()).strip()) for name in names}
    unitless = {name: _NORTH.sub(r"\1", text) for name, text in unitless.items()}
    plain = {name: re.sub(r"[\W_]+", "_", text).strip("_") for name, text in unitless.items()}
    roles: dict[str, str] = {}
    for role, pattern in words.items():
        free = (name for name in plain if role == "clock" or name not in roles.values())
        match = next((name for name in free if re.fullmatch(pattern, plain[name])), None)
        if match is not None:
            roles[role] = match
    if roles.get("clock") == roles.get("time") and "date" not in roles:
        roles.pop("clock", None)
    return roles
