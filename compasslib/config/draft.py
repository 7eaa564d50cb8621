"""Drafts of the YAML files of moorings and calibrations, with values from raw files and DECIDE for those unknown.

The schema refuses DECIDE, which the user must replace; the comment on the same line gives the evidence in the files.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import yaml

from compasslib.config.values import DECIDE
from compasslib.records import iso_time

SCHEMA = "# yaml-language-server: $schema={}.json\n"
CONFIG = f"""{SCHEMA.format("schema/config")}# Drafted by compass init; config/README.md of the pipeline has every key.
moorings: {{moorings}}
# A deposit asks for these four; they stand in every product:
# attributes: {{{{license: ..., institution: ..., publisher_url: ..., principal_investigator: ...}}}}
"""
HEAD = f"# Drafted by compass init from the files. Replace every {DECIDE} by a value, then: compass check\n"
UNITS = {
    "orientation": "up or down; the files do not tell",
    "direction_reference": "magnetic, or true where the directions hold the declination",
    "bin_size": "m, from one bin that was sent to the next",
    "first_bin": "m, from the transducer to the middle of the first bin",
    "time_format": "as '%d/%m/%Y %H:%M' or '%m/%d/%Y %H:%M'",
}


@dataclass(frozen=True)
class Drafted:
    """Properties of one instrument found in its files; None or NaN if unknown."""

    format: str
    files: tuple[str, ...]  # relative to the cruise folder
    keys: Mapping[str, Any]  # keys of the instrument other than format and files, as read; DECIDE if unknown
    trouble: str = ""  # reason why the files could not be read
    start_s: float = math.nan  # begin of the time in the water if pressure or depth shows it, else of the record
    end_s: float = math.nan
    surfaced: bool = False  # whether pressure or depth shows the time in the water
    step_s: float = math.nan
    bins: int = 0
    sectors: int = 0  # number of the 36 sectors that contain headings
    depth_m: float = math.nan
    depth_range_m: float = math.nan  # between the 1st and 99th percentile of the depths
    looks_up: bool | None = None
    heading_bias_deg: float | None = None  # removed by the reader; None if the format does not record it
    direction_reference: str | None = None  # if recorded in the files
    speed: float = math.nan  # median, as read
    serial_number: str = ""
    place: tuple[float, float] | None = None  # latitude, longitude
    water_depth_m: float | None = None


@dataclass(frozen=True)
class Position:
    """Position and water depth given on the command line, None if not given."""

    latitude: float | None = None
    longitude: float | None = None
    water_depth: float | None = None


@dataclass(frozen=True)
class Roles:
    """Affected instrument and possible references, with the evidence."""

    affected: str | None  # None if the files do not show it
    evidence: str
    others: tuple[str, ...] = ()  # instruments that recorded at the same time


@dataclass(frozen=True)
class Mooring:
    """Instruments that recorded at the same time, and covariates."""

    instruments: Mapping[str, Drafted]
    roles: Roles
    series: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # covariates by name, with their keys


def mooring(name: str, drafted: Mooring, said: Position) -> str:
    """Compose the text of config/moorings/NAME.yaml."""
    affected_first = sorted(drafted.instruments, key=lambda each: each != drafted.roles.affected)
    instruments = {each: drafted.instruments[each] for each in affected_first}
    lines = [SCHEMA.format("../schema/mooring"), HEAD, _line("name", name), *_place(instruments, said)]
    lines += _window(instruments)
    lines += [
        _line("declination", "auto", "by IGRF at this place, along time; or degrees east"),
        *_roles(drafted.roles),
    ]
    lines += ["instruments:\n", *(line for each in instruments for line in _instrument(each, instruments[each]))]
    lines += ["covariates:\n"] * bool(drafted.series)
    return "".join([*lines, *(f"  {each}: {_flow(keys)}\n" for each, keys in drafted.series.items())])


def calibration(kind: str, keys: Mapping[str, Any], comments: Mapping[str, str]) -> str:
    """Compose the text of config/calibrations/NAME.yaml.

    Args:
        keys: values from the files; DECIDE for a required input, None for an optional one (written as a comment).
    """
    lines = [
        _line(key, value, comments.get(key, "")) if value is not None else f"# {key}: ...  # {comments[key]}\n"
        for key, value in keys.items()
    ]
    return "".join([SCHEMA.format("../schema/calibration"), HEAD, _line("kind", kind), *lines])


def decisions(text: str) -> int:
    """Count the values of a draft that the user must decide."""
    return len(re.findall(rf"^[^#\n]*: {DECIDE}\b", text, re.MULTILINE))


def _place(instruments: Mapping[str, Drafted], said: Position) -> list[str]:
    drafted = instruments.values()
    latitude, longitude = next((each.place for each in drafted if each.place), (None, None))
    deep = next((each.water_depth_m for each in drafted if each.water_depth_m), None)
    lines = []
    for key, recorded, unit in (
        ("latitude", latitude, "degrees north"),
        ("longitude", longitude, "degrees east, west negative"),
        ("water_depth", deep, "m"),
    ):
        if (stated := getattr(said, key)) is not None:
            lines.append(_line(key, stated))
        else:
            comment = unit if recorded is None else f"{unit}, as the file says"
            lines.append(_line(key, DECIDE if recorded is None else recorded, comment))
    return lines


def _window(instruments: Mapping[str, Drafted]) -> list[str]:
    """Draft start and end: the time in the water by pressure or depth, else DECIDE with the span of the records."""
    submerged = [each for each in instruments.values() if each.surfaced]
    spans = [each for each in submerged or instruments.values() if not math.isnan(each.start_s)]
    if not spans:
        return [_line("start", DECIDE, "UTC, in the water"), _line("end", DECIDE, "UTC")]
    start = iso_time(math.ceil(min(each.start_s for each in spans)))
    end = iso_time(math.floor(max(each.end_s for each in spans)))
    if submerged:
        return [_line("start", start, "in the water, by pressure or depth"), _line("end", end)]
    return [
        _line("start", DECIDE, f"UTC, in the water; the first sample is of {start}"),
        _line("end", DECIDE, f"UTC; the last sample is of {end}"),
    ]


def _roles(roles: Roles) -> list[str]:
    affected = _line("compromised", roles.affected or DECIDE, roles.evidence)
    if not roles.others:
        return [affected, "# reference: none recorded at the same time; without one only a calibration can correct\n"]
    if roles.affected and len(roles.others) == 1:
        return [affected, _line("reference", roles.others[0], "the other instrument that recorded at the same time")]
    names = ", ".join(roles.others)
    return [affected, _line("reference", DECIDE, f"away from iron; one name or a list of names: {names}")]


def _instrument(name: str, drafted: Drafted) -> list[str]:
    lines = [f"  {name}:\n", *[f"    # could not be read: {drafted.trouble}\n"] * bool(drafted.trouble)]
    lines += [_line("format", drafted.format, indent=4)]
    lines += [_line("files", list(drafted.files) if len(drafted.files) > 1 else drafted.files[0], indent=4)]
    lines += [_depth(drafted), *_directions(drafted)]
    for key, value in drafted.keys.items():
        if key != "columns":
            lines.append(_line(key, value, UNITS.get(key, "") if value == DECIDE else "", indent=4))
    lines += _columns(drafted)
    if drafted.serial_number:
        lines.append(_line("attributes", {"serial_number": drafted.serial_number}, indent=4))
    return lines


def _depth(drafted: Drafted) -> str:
    """Compose the line of the depth, not stated if it changes by less than by tides and weather."""
    if math.isnan(drafted.depth_m):
        return _line("depth", DECIDE, "m, of the transducer; the files do not tell", indent=4)
    if drafted.depth_range_m < 0.3:
        description = f"m; recorded as {drafted.depth_m:.1f} with no change beyond {drafted.depth_range_m:.2g}"
        return _line("depth", DECIDE, f"{description}: entered, or its pressure is stuck", indent=4)
    return _line("depth", round(drafted.depth_m, 1), "m, the median of what it recorded", indent=4)


def _directions(drafted: Drafted) -> list[str]:
    if drafted.trouble:
        return []
    said, north, bias = "as the files say", drafted.direction_reference, drafted.heading_bias_deg
    lines = [] if drafted.looks_up is None else [_line("orientation", "up" if drafted.looks_up else "down", said, 4)]
    if north is None:
        return [*lines, _line("direction_reference", DECIDE, UNITS["direction_reference"], 4)]
    if north == "true" or bias is None or (drafted.format == "netcdf" and not bias):
        return [*lines, _line("direction_reference", north, said, 4)]
    if bias:  # a value here would override that of the file
        return [*lines, f"    # the file's heading bias or declination, {bias:+.2f}, is taken out\n"]
    ask = "degrees east that are in the directions already, 0 for none; the files tell of none"
    return [*lines, _line("declination_applied", DECIDE, ask, 4)]


def _columns(drafted: Drafted) -> list[str]:
    columns = dict(drafted.keys.get("columns") or {})
    scale = columns.pop("scale", None)
    lines = [_line(role, header, indent=6) for role, header in columns.items()]
    if columns and scale is None:
        median = "" if math.isnan(drafted.speed) else f"; with 1 the median speed would be {drafted.speed:.3g} m/s"
        lines.append(_line("scale", DECIDE, f"to m/s, as 0.01 for cm/s{median}", indent=6))
    elif columns:
        lines.append(_line("scale", scale, "to m/s, by the headers", indent=6))
    return ["    columns:\n", *lines] if columns else []


def _line(key: str, value: object, comment: str = "", indent: int = 0) -> str:
    text = f"{' ' * indent}{key}: {_flow(value)}"
    return f"{text}  # {comment}\n" if comment else f"{text}\n"


def _flow(value: object) -> str:
    text = yaml.safe_dump(value, default_flow_style=True, width=math.inf, allow_unicode=True, sort_keys=False)
    return text.removesuffix("\n").removesuffix("\n...").removesuffix(os.linesep)
