"""Read time series of ODV spreadsheets, as SeaDataNet exchanges them: text whose columns each have quality flags.

Columns are identified by the parameters (P01) in the preamble, else by their names; a column QV:... behind a column
holds its flags. Sources: SeaDataNet, Data File Formats (ODV4, 1.25); vocabularies P01 and L20 of the NVS; Ocean
Data View, User's Guide (flags of ODV).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from compasslib.errors import InputError
from compasslib.readers import delimited, detect, vocabulary
from compasslib.readers.table import to_record
from compasslib.records import BAD, GOOD, NOT_CHECKED, PROBABLY_BAD, Record

LAYOUT = delimited.Layout(comment="//")
PARAMETERS = {  # beginning of a P01 code -> role
    "LCEW": "east", "LCNS": "north", "LCSA": "speed", "LCDA": "direction", "HEAD": "heading", "PTCH": "tilt_x",
    "ROLL": "tilt_y", "PRES": "pressure", "ADEPZZ": "depth", "TEMP": "temperature", "DTUT8601": "time", "CJDY": "time",
}  # fmt: skip
OF_ODV = {"0": GOOD, "1": NOT_CHECKED, "4": PROBABLY_BAD, "8": BAD}
_SUBJECT = re.compile(r"<subject>SDN:LOCAL:([^<]+)</subject>\s*<object>SDN:P01::(\w+)</object>")
_FLAGS = re.compile(r"QV(?::(?P<name>[^.]*))?(?:\.\d+)?|QF(?:\.\d+)?")
_TIME = re.compile(  # of a row, or of its station
    r"(?i)time_iso8601.*|(?P<julian>chronological julian date.*)|(?P<station>yyyy-mm-ddThh:mm(?::ss(?:\.s+)?)?)"
)


def read(
    paths: Sequence[Path],
    *,
    columns: Mapping[str, Any] | None = None,
    flags: Mapping[str, Sequence[object]] | None = None,
    direction_reference: str | None = None,
) -> Record:
    """Read the time series of one instrument.

    Raises:
        InputError: a file holds several stations or no velocities, or as for tables.
    """
    named = {role: name for role, name in (columns or {}).items() if name is not None}
    scale, tables = named.pop("scale", None), []
    for path in paths:
        head = delimited.find_head(path, lambda names: names[:2] == ["Cruise", "Station"], LAYOUT, must=True)
        if head is None:
            advice = "check that format: odv and the file belong together"
            raise InputError(str(path), expected="a header Cruise, Station, ...", found="none", advice=advice)
        rows = (line.split(head.delimiter.encode(), 2) for line in head.source[head.begin :].splitlines())
        stations = {(*row[:2],) for row in rows if row[0].strip() and not row[0].startswith(b"//")}
        if len(stations) > 1:
            expected, advice = "the time series of one station", "write one station a file"
            raise InputError(str(path), expected=expected, found=f"{len(stations)} stations", advice=advice)
        headers = find_columns(head) | named
        flow = next((roles for roles in (("east", "north"), ("speed", "direction")) if {*roles} <= {*headers}), ())
        if "time" not in headers or not flow:
            expected, advice = "columns of time and velocities", "name them in the mooring file: columns"
            raise InputError(str(path), expected=expected, found=", ".join(head.names), advice=advice)
        for role in {"east", "north", "speed", "direction"} - {*flow}:
            headers.pop(role, None)
        flagged, known = dict[str, str](), dict[str, int]()
        for role, name in headers.items():
            after = head.names[head.names.index(name) + 1 :] if name in head.names else []
            if after and (match := _FLAGS.fullmatch(after[0])):
                flagged[f"flag_{role}"] = after[0]
                words = vocabulary.find_vocabulary(str(match["name"]))[1].items()
                meanings = {value.lower(): vocabulary.MEANINGS[word] for value, word in words}
                known |= meanings or OF_ODV
        known |= vocabulary.parse_flag_settings(flags)
        match = _TIME.fullmatch(str(headers["time"]))
        carried = {"time"} if match and match["station"] else ()
        layout = replace(LAYOUT, time_format="julian") if match and match["julian"] else LAYOUT
        tables.append(delimited.read_table(path, headers | flagged, "correct columns", layout, known, carried=carried))
    record = to_record(paths, tables, scale, direction_reference)
    is_stated = direction_reference or any(vocabulary.stated_north(table.said) for table in tables)
    return replace(record, unstated=() if is_stated else ("direction_reference",))


def find_columns(head: delimited.Head) -> dict[str, str]:
    """Find the columns of roles by their parameters, else by their names, without those of flags."""
    names = [name for name in head.names if name and not _FLAGS.fullmatch(name)]
    preamble = head.source[: head.begin].decode(errors="replace")
    parameter = {_without_unit(subject): code for subject, code in _SUBJECT.findall(preamble)}
    columns: dict[str, str] = {}
    for name in names:
        code = parameter.get(_without_unit(name), "")
        role = next((role for begin, role in PARAMETERS.items() if code.startswith(begin)), None)
        columns |= {role: name} if role and role not in columns else {}
    roles = detect.match_roles(name for name in names if name not in columns.values())
    roles = {role: name for role, name in roles.items() if role not in delimited.DATE_AND_CLOCK}
    times = sorted(filter(_TIME.fullmatch, names), key=lambda name: (not name.startswith("time"), name.startswith("Y")))
    return roles | ({"time": times[0]} if times else {}) | columns


def _without_unit(name: str) -> str:
    return name.partition("[")[0].strip()
