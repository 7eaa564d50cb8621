"""Guesses of which column of a table is what, by the words of its header: for drafts, which a person looks through."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from compasslib.readers import delimited

PRESSURE_ALONE = 3  # columns of a profiler's pressure, perhaps with temperature
SPEEDS = {"mm": 0.001, "cm": 0.01, "m": 1.0}  # a second, in m/s
_SPEED = re.compile(r"(?:^|[\W_])(mm|cm|m)[\W_]*(?:/|p|per)?[\W_]*s(?:ec|econd)?(?:\W*-?1)?\W*$")
_UNIT = re.compile(
    r"[\[(][^\])]*[\])]|_(?:m|metres?|deg|degrees?|dbar|c|degc|utc|gmt|kn|knots|nt|ut|counts)$|°|\s+utc$"
)
_NORTH = {
    "magnetic": r"deg[\W_]*m\b|\bmag(?:netic)?\b",
    "true": r"deg[\W_]*t\b|\btrue\b",
}  # to which a direction counts
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
_ABOUT = ("date", "clock", "depth", "pressure", "heading", "tilt_x", "tilt_y", "temperature")
_FLOWS = (("east", "north"), ("speed", "direction"), ("x", "y", "heading"))
# What a table is, the words of its columns, and those that it must have, in the order in which they are tried.
_TABLES: tuple[tuple[str, Mapping[str, str], tuple[str, ...]], ...] = (
    ("swing", _SWING, ("compass_deg", "cog_deg")),
    ("platform", _BENCH, ("reference_deg", "recorded_deg")),
    ("magnetometer", _MAGNETOMETER, ("x", "y", "z")),
)


@dataclass(frozen=True)
class GuessedTable:
    """A guess of the content of a table."""

    kind: str  # instrument | platform | swing | magnetometer | series | pressure
    columns: dict[str, str]  # role -> header
    scale: float | None = None  # to m/s, None where the headers do not tell
    north: str | None = None  # magnetic or true, None where the headers do not tell


def guess_columns(path: Path) -> GuessedTable | None:
    """Guess the columns of a table, None where its header does not tell."""
    delimiters = list(delimited.DELIMITERS)[: -1 if _is_delimited(path) else None]  # blanks may stand inside such names
    lines = delimited.find_lines(
        path, lambda names: guess_from_names(names) is not None, must=True, delimiters=delimiters
    )
    return guess_from_names(lines.header) if lines else None


def _is_delimited(path: Path) -> bool:
    """Tell whether a character other than a blank separates the cells of most lines, the same number in each."""

    def names_columns(names: Sequence[str]) -> bool:
        return len(names) > 1 and all(re.search(r"[^\W\d_]", name) for name in names)

    for delimiter in delimited.DELIMITERS.keys() - {" "}:
        lines = delimited.find_lines(path, names_columns, must=True, delimiters=[delimiter])
        whole = [len(row) == len(lines.header) for row in lines.rows] if lines else []
        if 2 * sum(whole) > len(whole):
            return True
    return False


def guess_from_names(names: Sequence[str]) -> GuessedTable | None:
    """Guess the columns of a table with such a header, None where it does not tell.

    >>> guess_from_names(["Date/Time", "Vel East [cm/s]", "Vel North [cm/s]", "Depth (m)"]).columns["east"]
    'Vel East [cm/s]'
    """
    columns = _roles(names, _WORDS)
    if "date" in columns and not {"time", "clock"} & set(columns):
        columns["time"] = columns.pop("date")
    timed = "time" in columns or {"date", "clock"} <= set(columns)
    flow = next((roles for roles in _FLOWS if timed and set(roles) <= set(columns)), None)
    if flow and not ("x" in flow and _roles(names, {"z": _MAGNETOMETER["z"]})):
        if {"date", "clock"} <= set(columns):
            columns.pop("time", None)
        clock = ("time",) if "time" in columns else ()
        chosen = {role: columns[role] for role in (*clock, *flow, *_ABOUT) if role in columns}
        if clock:
            chosen = {role: header for role, header in chosen.items() if role not in ("date", "clock")}
        speeds = (_SPEED.search(re.sub(r"[\])]", "", columns[role].lower())) for role in flow)
        units = {match[1] for match in speeds if match}
        names = [columns[role].lower() for role in (*flow, "heading") if role in columns]
        norths = {north for north, words in _NORTH.items() for name in names if re.search(words, name)}
        scale = SPEEDS[units.pop()] if len(units) == 1 else None
        return GuessedTable("instrument", chosen, scale, norths.pop() if len(norths) == 1 else None)
    for kind, words, must in _TABLES:
        roles = _roles(names, words)
        if set(must) <= set(roles):
            return GuessedTable(kind, roles)
    if timed and "pressure" in columns and len(names) <= PRESSURE_ALONE:
        return GuessedTable("pressure", {role: columns[role] for role in ("time", "pressure") if role in columns})
    others = [name for name in names if name not in columns.values()]
    return GuessedTable("series", {"time": columns["time"], "value": others[0]}) if timed and len(others) == 1 else None


def _roles(names: Iterable[str], words: Mapping[str, str]) -> dict[str, str]:
    """Match headers to roles, the first that has a role's words, none twice."""
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
    """Strip a header of its unit; small letters, what parts its words as one sign."""
    unitless = _SPEED.sub("", _UNIT.sub("", name.strip().lower()).strip())
    return re.sub(r"[\W_]+", "_", unitless).strip("_")
