"""Texts of drafted YAML files, with values from raw files and DECIDE for those unknown.

The schema refuses DECIDE, which the user must replace; the comment on the same line gives the evidence in the files.
"""

import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import yaml

from compasslib import angles
from compasslib.config.values import DECIDE
from compasslib.records import Record, iso_time
from compasslib.types import Floats

SILENT = ("table", "acm_table", "mmp_acm")  # formats that never state whether directions are magnetic or true
ORIENTED = ("pd0", "nortek", "netcdf", "ocean_contour", "mat", "rdi_text")  # formats that may state the orientation
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
    "latitude": "degrees north",
    "longitude": "degrees east, west negative",
    "water_depth": "m",
}
Row = tuple[str, Any, str]  # key, value and comment; a comment alone has no key


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
        """First and last time below half the median pressure or depth; None unless median and range exceed 2 m."""
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


def mooring(
    name: str, group: Mapping[str, Drafted], roles: tuple[str | None, str, Sequence[str]],
    series: Mapping[str, Mapping[str, Any]], given: Mapping[str, float | None],
) -> str:  # fmt: skip
    """Compose the text of config/moorings/NAME.yaml.

    Args:
        group: instruments that recorded at the same time.
        roles: the affected one, None if the files do not show it, with the evidence, and possible references.
        series: covariates by name, with their keys.
        given: latitude, longitude and water depth, as far as the user gave them.
    """
    affected, evidence, others = roles
    instruments = sorted(group.items(), key=lambda item: item[0] != affected)
    lines = [
        _line("name", name),
        *_place([each.where for _, each in instruments], given),
        *_window(list(group.values())),
        _line("declination", "auto", "by IGRF at this place, along time; or degrees east"),
        _line("compromised", affected or DECIDE, evidence),
        _reference(affected, others),
        "instruments:\n",
        *(line for role, each in instruments for line in _instrument(role, each)),
        *(["covariates:\n"] if series else []),
        *(f"  {key}: {_flow(keys)}\n" for key, keys in series.items()),
    ]
    return "".join([SCHEMA.format("../schema/mooring"), HEAD, *lines])


def calibration(kind: str, keys: Mapping[str, Any], comments: Mapping[str, str]) -> str:
    """Compose config/calibrations/NAME.yaml.

    Args:
        keys: values from the files; DECIDE for a required input, None for an optional one (written as a comment).
    """
    lines = [
        f"# {key}: ...  # {comments[key]}\n"
        if value is None
        else _line(key, value, comments.get(key, "") if value == DECIDE else "")
        for key, value in keys.items()
    ]
    return "".join([SCHEMA.format("../schema/calibration"), HEAD, _line("kind", kind), *lines])


def _line(key: str, value: object, comment: str = "", indent: int = 0) -> str:
    text = f"{' ' * indent}{key}: {_flow(value)}"
    return f"{text}  # {comment}\n" if comment else f"{text}\n"


def _flow(value: object) -> str:
    text = yaml.safe_dump(value, default_flow_style=True, width=math.inf, allow_unicode=True, sort_keys=False)
    return text.removesuffix("\n").removesuffix("\n...").removesuffix(os.linesep)


def _place(stated: Sequence[Mapping[str, float]], given: Mapping[str, float | None]) -> Iterator[str]:
    for key, value in given.items():
        recorded = next((each[key] for each in stated if key in each), None)
        if value is not None:
            yield _line(key, value)
        elif recorded is not None:
            yield _line(key, recorded, f"{UNITS[key]}, as the file says")
        else:
            yield _line(key, DECIDE, UNITS[key])


def _window(instruments: Iterable[Drafted]) -> list[str]:
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


def _reference(affected: str | None, others: Sequence[str]) -> str:
    if not others:
        return "# reference: none recorded at the same time; without one only a calibration can correct\n"
    if affected and len(others) == 1:
        return _line("reference", others[0], "the other instrument that recorded at the same time")
    return _line("reference", DECIDE, f"away from iron; one name or a list of names: {', '.join(others)}")


def _instrument(name: str, drafted: Drafted, *, still_m: float = 0.3) -> list[str]:
    """Draft an instrument; its depth is not stated if it changes by less than by tides and weather."""
    depth: tuple[Any, str] = round(drafted.depth_m, 1), "m, the median of what it recorded"
    if drafted.depth_m == 0.0:
        depth = DECIDE, "m, of the transducer; the files do not tell"
    elif (change := float(np.ptp(np.quantile(drafted.depths_m, [0.01, 0.99])))) < still_m:
        found = f"m; recorded as {drafted.depth_m:.1f} with no change beyond {change:.2g}"
        counts = "; its column counts where depth is under columns" * ("depth" in (drafted.keys.get("columns") or {}))
        depth = DECIDE, f"{found}: entered, or its pressure is stuck{counts}"
    rows: list[Row] = [
        ("format", drafted.format, ""),
        ("files", list(drafted.files) if len(drafted.files) > 1 else drafted.files[0], ""),
        ("depth", *depth),
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


def _directions(drafted: Drafted, record: Record) -> list[Row]:
    """Draft orientation, reference of directions and declination."""
    rows: list[Row] = []
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
    ask = "degrees east that are in the directions already, 0 for none; the files state none"
    return [*rows, ("declination_applied", DECIDE, ask)]
