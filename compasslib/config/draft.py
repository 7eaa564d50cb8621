"""The text of a mooring's or calibration's YAML file as a draft: what files tell, and DECIDE where a person must."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import yaml

DECIDE = "DECIDE:"
WIDTH = 120  # columns of a line, as far as its value allows
CONFIG = """# Drafted by compass init; config/README.md of the pipeline has every key.
moorings: {moorings}
# attributes: {{institution: ..., principal_investigator: ..., project: ...}}  # they stand in every product
"""
WHO = {
    None: "the one whose compass is beside iron",
    True: "the one whose compass is beside iron; taken: it has a compass and most bins",
}
STILL_M = 0.3  # tide and weather move an instrument's depth by more


@dataclass(frozen=True)
class Told:
    """What the files of one instrument tell; None or NaN where they do not."""

    format: str
    files: tuple[str, ...]  # relative to the cruise folder
    keys: Mapping[str, Any]  # of the instrument, beside format and files, as they were read
    trouble: str = ""  # why they could not be read
    start_s: float = math.nan  # in the water, where pressure or depth tells, else of the record
    end_s: float = math.nan
    surfaced: bool = False  # whether pressure or depth tells when it was in the water
    step_s: float = math.nan
    bins: int = 0
    has_compass: bool = False
    depth_m: float = math.nan
    depth_range_m: float = math.nan  # of 98 % of the depths
    looks_up: bool | None = None
    heading_bias_deg: float | None = None  # taken out by the reader; None: the format does not tell
    direction_reference: str | None = None  # true where the files say so; None: they do not tell
    speed: float = math.nan  # median, as read
    serial_number: str = ""
    place: tuple[float, float] | None = None  # latitude, longitude
    water_depth_m: float | None = None


@dataclass(frozen=True)
class Place:
    """What the person who drafts said, None where nothing."""

    latitude: float | None = None
    longitude: float | None = None
    water_depth: float | None = None


def mooring(name: str, instruments: Mapping[str, Told], series: Mapping[str, Mapping[str, Any]], said: Place) -> str:
    """Return the text of config/moorings/NAME.yaml.

    Args:
        instruments: by the names that they get.
        series: covariates by name, with their keys.
        said: what the person knows.
    """
    compromised, *others = sorted(instruments, key=lambda one: (-instruments[one].has_compass, -instruments[one].bins))
    along = [one for one in others if _overlap(instruments[compromised], instruments[one])]
    return "".join(
        [
            "# Drafted by compass init from what the files tell. Decide where DECIDE stands, then: compass check\n",
            _line("name", name),
            *_place(list(instruments.values()), said),
            *_window(instruments[compromised]),
            _line("declination", "auto", "by IGRF at this place, along time; or degrees east"),
            _line("compromised", compromised, f"{DECIDE} {WHO[instruments[compromised].has_compass or None]}"),
            *_reference(along),
            "instruments:\n",
            *(line for one in (compromised, *others) for line in _instrument(one, instruments[one])),
            *(["covariates:\n"] if series else []),
            *(f"  {one}: {_flow(keys)}\n" for one, keys in series.items()),
        ]
    )


def calibration(kind: str, keys: Mapping[str, Any], comments: Mapping[str, str]) -> str:
    """Return the text of config/calibrations/NAME.yaml.

    Args:
        keys: what the files tell, None where a person may say more.
        comments: of these keys.
    """
    head = "# Drafted by compass init from what the files tell. Decide where DECIDE stands, then: compass check\n"
    lines = [_line(key, value, comments.get(key, "")) for key, value in keys.items()]
    return "".join([head, _line("kind", kind), *lines])


def decisions(text: str) -> int:
    """Return how often a draft asks a person to decide."""
    return text.count(f"# {DECIDE}")


def _place(told: Sequence[Told], said: Place) -> list[str]:
    place = next((one.place for one in told if one.place), (None, None))
    deep = next((one.water_depth_m for one in told if one.water_depth_m), None)
    rows = (
        ("latitude", said.latitude, place[0], "degrees north"),
        ("longitude", said.longitude, place[1], "degrees east, west negative"),
        ("water_depth", said.water_depth, deep, "m"),
    )
    return [
        _line(key, known if known is not None else found, "" if known is not None else _asked(found, unit))
        for key, known, found, unit in rows
    ]


def _asked(found: float | None, unit: str) -> str:
    return f"{DECIDE} {unit}" if found is None else f"{unit}, as the file says"


def _window(told: Told) -> list[str]:
    how = "in the water by its pressure or depth" if told.surfaced else "of its record; when was it in the water?"
    if math.isnan(told.start_s):
        return [_line("start", None, f"{DECIDE} UTC, in the water"), _line("end", None, f"{DECIDE} UTC")]
    times = (math.ceil(told.start_s), math.floor(told.end_s))
    start, end = (f"{datetime.fromtimestamp(t, UTC):%Y-%m-%dT%H:%M:%SZ}" for t in times)
    return [_line("start", start, f"{DECIDE} first sample {how}"), _line("end", end, f"{DECIDE} last one")]


def _reference(names: Sequence[str]) -> list[str]:
    if not names:
        return ["# reference: none that overlaps in time; without one only a calibration can correct\n"]
    return [_line("reference", list(names) if len(names) > 1 else names[0], f"{DECIDE} the one away from iron")]


def _instrument(name: str, told: Told) -> list[str]:
    return [
        f"  {name}:\n",
        *([f"    # could not be read: {told.trouble}\n"] if told.trouble else []),
        _line("format", told.format, indent=4),
        _line("files", list(told.files) if len(told.files) > 1 else told.files[0], indent=4),
        *_depth(told),
        *_directions(told),
        *(_line(key, value, _of_key(key, told), indent=4) for key, value in told.keys.items() if key != "columns"),
        *_columns(told),
        *([_line("attributes", {"serial_number": told.serial_number}, indent=4)] if told.serial_number else []),
    ]


def _depth(told: Told) -> list[str]:
    if math.isnan(told.depth_m):
        return [_line("depth", None, f"{DECIDE} m, of the transducer; the files do not tell", indent=4)]
    if told.depth_range_m < STILL_M:
        doubt = (
            f"{DECIDE} m, recorded with no change beyond {told.depth_range_m:.2g}: entered, or its pressure is stuck"
        )
        return [_line("depth", round(told.depth_m, 1), doubt, indent=4)]
    return [_line("depth", round(told.depth_m, 1), "m, the median of what it recorded", indent=4)]


def _directions(told: Told) -> list[str]:
    if told.trouble:
        return []
    up = {None: [], True: ["up"], False: ["down"]}[told.looks_up]
    lines = [_line("orientation", word, "as the files say", indent=4) for word in up]
    if told.direction_reference == "true":
        return [*lines, _line("direction_reference", "true", "as the files say", indent=4)]
    if told.direction_reference is None:
        ask = f"{DECIDE} or true, where the directions hold the declination"
        return [*lines, _line("direction_reference", "magnetic", ask, indent=4)]
    if told.format == "netcdf":  # a number here would stand in place of the file's own word
        return [*lines, "    # the declination that the file says is in its directions is taken out\n"]
    if told.heading_bias_deg:
        return [*lines, f"    # the file's heading bias or declination, {told.heading_bias_deg:+.2f}, is taken out\n"]
    ask = f"{DECIDE} degrees east that are in the directions already; the files tell of none"
    return [*lines, _line("declination_applied", 0, ask, indent=4)]


def _of_key(key: str, told: Told) -> str:
    words = {
        "orientation": "up or down; the files do not tell",
        "bin_size": "m, from one bin that was sent to the next",
        "first_bin": "m, from the transducer to the middle of the first bin",
    }
    return f"{DECIDE} {words[key]}" if key in words and told.keys[key] is None else ""


def _columns(told: Told) -> list[str]:
    columns = dict(told.keys.get("columns") or {})
    scale = columns.pop("scale", None)
    lines = [_line(role, header, indent=6) for role, header in columns.items()]
    if columns and scale is None:
        median = "" if math.isnan(told.speed) else f"; the median speed would be {told.speed:.3g} m/s"
        lines.append(_line("scale", 1, f"{DECIDE} to m/s, as 0.01 for cm/s{median}", indent=6))
    elif columns:
        lines.append(_line("scale", scale, "to m/s, by the headers", indent=6))
    return ["    columns:\n", *lines] if columns else []


def _overlap(one: Told, other: Told) -> bool:
    return min(one.end_s, other.end_s) > max(one.start_s, other.start_s)


def _line(key: str, value: object, comment: str = "", indent: int = 0) -> str:
    text = f"{' ' * indent}{key}: {_flow(value)}"
    return f"{text}  # {comment}\n" if comment else f"{text}\n"


def _flow(value: object) -> str:
    """Return a value in YAML on one line."""
    text = yaml.safe_dump(value, default_flow_style=True, width=math.inf, allow_unicode=True, sort_keys=False)
    return text.removesuffix("\n").removesuffix("\n...").removesuffix(os.linesep)
