"""Drafts of the YAML files of moorings and calibrations, with values from raw files and DECIDE for those unknown.

The schema refuses DECIDE, which the user must replace; the comment on the same line gives the evidence in the files.
``python -m compasslib.config.draft FOLDER`` writes the JSON schemas of all YAML files; ``make schema`` does so.
"""

from __future__ import annotations

import json
import math
import os
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from pydantic import BaseModel
from pydantic.json_schema import JsonSchemaMode, models_json_schema

from compasslib import angles
from compasslib.config.calibrations import MODELS, KindKey
from compasslib.config.schema import CruiseOptions, Mooring
from compasslib.config.values import DECIDE
from compasslib.records import Record, iso_time
from compasslib.types import Floats

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
SILENT = ("table", "acm_table", "mmp_acm")  # formats that never state whether directions are magnetic or true
ORIENTED = ("pd0", "nortek", "netcdf", "ocean_contour", "mat", "rdi_text")  # formats that may state the orientation


@dataclass(frozen=True)
class Drafted:
    """One instrument as found in its files."""

    format: str
    files: tuple[str, ...]  # relative to the cruise folder
    keys: Mapping[str, Any]  # keys of the instrument other than format and files, as read; DECIDE if unknown
    record: Record | None = None
    trouble: str = ""  # reason why the files could not be read
    north: str | None = None  # reference of directions in the header of a table
    where: Mapping[str, float] = field(default_factory=dict)  # latitude, longitude, water depth, as far as stated

    @cached_property
    def in_water_s(self) -> tuple[float, float] | None:
        """First and last time below half the median pressure or depth; None if they do not show the time in the water.

        The median and the range must exceed 2 m.
        """
        for level in (self.record.pressure_dbar, self.record.depth_m) if self.record else ():
            known = level[np.isfinite(level)]
            if self.record and 2 * len(known) > len(level) and min(np.median(known), np.ptp(known)) > 2.0:
                deep = self.record.time_s[level > np.median(known) / 2.0]
                return float(deep.min()), float(deep.max())
        return None

    @cached_property
    def span_s(self) -> tuple[float, float]:
        """Begin and end of the time in the water, or else of the record; NaN without one."""
        times = self.record.time_s[np.isfinite(self.record.time_s)] if self.record else np.zeros(0)
        return self.in_water_s or ((float(times.min()), float(times.max())) if len(times) else (math.nan, math.nan))

    @cached_property
    def depths_m(self) -> Floats:
        """Known depths, or else pressures, in the water."""
        if self.record is None:
            return np.zeros(0)
        level = self.record.depth_m if np.isfinite(self.record.depth_m).any() else self.record.pressure_dbar
        start, end = self.span_s
        return level[(self.record.time_s >= start) & (self.record.time_s <= end) & np.isfinite(level)]

    @property
    def depth_m(self) -> float:
        """Median depth, 0 if unknown."""
        return max(float(np.median(self.depths_m)), 0.0) if self.depths_m.size else 0.0

    @property
    def sectors(self) -> int:
        """Number of the 36 sectors that contain headings."""
        headings = self.record.heading_deg if self.record else np.zeros(0)
        return len(np.unique(headings[np.isfinite(headings)] // angles.SECTOR_DEG))


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


def mooring(
    name: str,
    drafted: Mapping[str, Drafted],
    roles: Roles,
    series: Mapping[str, Mapping[str, Any]],
    said: Position,
) -> str:
    """Compose the text of config/moorings/NAME.yaml.

    Args:
        drafted: instruments that recorded at the same time.
        series: covariates by name, with their keys.
    """
    instruments = {each: drafted[each] for each in sorted(drafted, key=lambda each: each != roles.affected)}
    return "".join(
        [
            SCHEMA.format("../schema/mooring"),
            HEAD,
            _line("name", name),
            *_place([each.where for each in instruments.values()], said),
            *_window(list(instruments.values())),
            _line("declination", "auto", "by IGRF at this place, along time; or degrees east"),
            *_roles(roles),
            "instruments:\n",
            *(line for each in instruments for line in _instrument(each, instruments[each])),
            *(["covariates:\n"] if series else []),
            *(f"  {each}: {_flow(keys)}\n" for each, keys in series.items()),
        ]
    )


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


def _place(stated: Sequence[Mapping[str, float]], said: Position) -> list[str]:
    lines = []
    for key, unit in (
        ("latitude", "degrees north"),
        ("longitude", "degrees east, west negative"),
        ("water_depth", "m"),
    ):
        given = getattr(said, key)
        recorded = next((each[key] for each in stated if key in each), None)
        comment = "" if given is not None else unit if recorded is None else f"{unit}, as the file says"
        value = recorded if given is None else given
        lines.append(_line(key, DECIDE if value is None else value, comment))
    return lines


def _window(instruments: Sequence[Drafted]) -> list[str]:
    """Draft start and end: the time in the water by pressure or depth, else DECIDE with the span of the records."""
    submerged = [each.in_water_s for each in instruments if each.in_water_s]
    spans = submerged or [each.span_s for each in instruments if not math.isnan(each.span_s[0])]
    if not spans:
        return [_line("start", DECIDE, "UTC, in the water"), _line("end", DECIDE, "UTC")]
    start = iso_time(math.ceil(min(first for first, _ in spans)))
    end = iso_time(math.floor(max(last for _, last in spans)))
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
    rows: list[tuple[str, Any, str]] = [
        ("format", drafted.format, ""),
        ("files", list(drafted.files) if len(drafted.files) > 1 else drafted.files[0], ""),
        ("depth", *_depth(drafted)),
        *(_directions(drafted, drafted.record) if drafted.record else []),
    ]
    keys = {key: value for key, value in drafted.keys.items() if key != "columns"}
    rows += [(key, value, UNITS.get(key, "") if value == DECIDE else "") for key, value in keys.items()]
    lines = [f"  {name}:\n", *([f"    # could not be read: {drafted.trouble}\n"] if drafted.trouble else [])]
    lines += [_line(*row, indent=4) if row[0] else f"    # {row[2]}\n" for row in rows]
    if columns := dict(drafted.keys.get("columns") or {}):
        scale, comment = columns.pop("scale", DECIDE), "to m/s, by the headers"
        lines += ["    columns:\n", *(_line(role, header, indent=6) for role, header in columns.items())]
        if scale == DECIDE:
            speed = np.hypot(drafted.record.east, drafted.record.north) if drafted.record else np.full(1, np.nan)
            known = np.isfinite(speed).any()
            median = f"; with 1 the median speed would be {np.nanmedian(speed):.3g} m/s" if known else ""
            comment = f"to m/s, as 0.01 for cm/s{median}"
        lines.append(_line("scale", scale, comment, indent=6))
    if drafted.record and (number := drafted.record.serial_number):
        lines.append(_line("attributes", {"serial_number": number}, indent=4))
    return lines


def _depth(drafted: Drafted, *, still_m: float = 0.3) -> tuple[Any, str]:
    """Draft the depth, with a comment; it is not stated if it changes by less than by tides and weather."""
    if drafted.depth_m == 0.0:
        return DECIDE, "m, of the transducer; the files do not tell"
    if (change := float(np.ptp(np.quantile(drafted.depths_m, [0.01, 0.99])))) < still_m:
        description = f"m; recorded as {drafted.depth_m:.1f} with no change beyond {change:.2g}"
        return DECIDE, f"{description}: entered, or its pressure is stuck"
    return round(drafted.depth_m, 1), "m, the median of what it recorded"


def _directions(drafted: Drafted, record: Record) -> list[tuple[str, Any, str]]:
    """Draft orientation, reference of directions and declination: key, value, comment; a comment alone has no key."""
    rows: list[tuple[str, Any, str]] = []
    silent = drafted.format in SILENT
    if drafted.format in ORIENTED and drafted.keys.get("orientation") != DECIDE:
        rows.append(("orientation", "up" if record.looks_up else "down", "as the files say"))
    north = drafted.north if silent else record.direction_reference
    bias = 0.0 if silent else record.heading_bias_deg or record.velocity_bias_deg or 0.0
    if north is None or "direction_reference" in record.unstated:
        return [*rows, ("direction_reference", DECIDE, UNITS["direction_reference"])]
    if north == "true" or silent or (drafted.format == "netcdf" and not bias):
        return [*rows, ("direction_reference", north, "as the files say")]
    if bias:  # a value here would override that of the file
        return [*rows, ("", None, f"the file's heading bias or declination, {bias:+.2f}, is taken out")]
    ask = "degrees east that are in the directions already, 0 for none; the files tell of none"
    return [*rows, ("declination_applied", DECIDE, ask)]


def _line(key: str, value: object, comment: str = "", indent: int = 0) -> str:
    text = f"{' ' * indent}{key}: {_flow(value)}"
    return f"{text}  # {comment}\n" if comment else f"{text}\n"


def _flow(value: object) -> str:
    text = yaml.safe_dump(value, default_flow_style=True, width=math.inf, allow_unicode=True, sort_keys=False)
    return text.removesuffix("\n").removesuffix("\n...").removesuffix(os.linesep)


# JSON schemas, generated from the models, for completion and validation of the YAML files in editors.

FOLDER = "config/schema"  # relative to the folder of a cruise
DIALECT = "https://json-schema.org/draft/2020-12/schema"


def schemas() -> dict[str, str]:
    """Generate the JSON schemas of config.yaml, of moorings and of calibrations, by name of the schema file."""
    models: list[type[BaseModel]] = [KindKey, *MODELS.values()]
    named: list[tuple[type[BaseModel], JsonSchemaMode]] = [(model, "validation") for model in models]
    _, kinds = models_json_schema(named)
    by_kind = [
        {"if": {"properties": {"kind": {"const": kind}}}, "then": {"$ref": f"#/$defs/{model.__name__}"}}
        for kind, model in MODELS.items()
    ]
    known = kinds["$defs"]["KindKey"]["properties"]
    calibration = {"type": "object", "required": ["kind"], "properties": known, "allOf": by_kind, **kinds}
    made = {"config": CruiseOptions.model_json_schema(), "mooring": Mooring.model_json_schema()}
    return {
        f"{name}.json": json.dumps({"$schema": DIALECT} | _simplify(schema), indent=1, ensure_ascii=False) + "\n"
        for name, schema in (made | {"calibration": calibration}).items()
    }


def _simplify(schema: Any) -> Any:
    """Remove advice and examples, which serve error messages only, and uninformative titles and null defaults."""
    if isinstance(schema, list):
        return [_simplify(part) for part in schema]
    if not isinstance(schema, dict):
        return schema
    idle = {"advice": schema.get("advice"), "title": schema.get("title"), "default": None, "examples": None}
    return {
        key: _simplify(value)
        for key, value in schema.items()
        if not (key in idle and (key == "examples" or (value == idle[key] and not isinstance(value, dict))))
    }


if __name__ == "__main__":
    for file, text in schemas().items():
        Path(sys.argv[1], file).write_text(text, encoding="utf-8")
