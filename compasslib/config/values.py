"""Validators of single values in a cruise's YAML files: numbers, times, paths, names, with advice on mistakes.

Each takes a value as read from YAML and returns the converted value, or raises the error that ``problem`` creates.
"""

from __future__ import annotations

import difflib
import math
import os
import posixpath
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime
from pathlib import Path, PureWindowsPath
from typing import Any, Literal

import numpy as np
from pydantic import ValidationInfo
from pydantic_core import PydanticCustomError

from compasslib.readers.times import FARTHEST_ZONE_H

DECIDE = "DECIDE"  # placeholder in a draft for a value that the user must decide
NAME_WORDS = "1 to 64 letters, digits, '_', '.' and '-', the first a letter or digit"
VELOCITY_SETS = (("east", "north"), ("speed", "direction"), ("x", "y", "heading"))
SWAPPED = "check the sign and the order of latitude and longitude"
# Global attributes of corrected.nc that are computed or fixed by its format; a YAML file may not set them. It may set
# all others, including those with a default (title, institution, ...).
STATED = (
    *("Conventions", "featureType", "cdm_data_type", "data_type", "data_mode", "format_version", "update_interval"),
    *("cdm_timeseries_variables", "cdm_profile_variables"),
    *("standard_name_vocabulary", "id", "product_version", "processing_level", "QC_indicator"),
    *("headings_recorded", "headings_corrected", "correction_method", "correction_coefficients", "effects"),
    *("declination_source", "software_version", "source_files", "history"),
    *("date_created", "date_modified", "date_issued", "date_metadata_modified"),
    *("geospatial_lat_min", "geospatial_lat_max", "geospatial_lat_units"),
    *("geospatial_lon_min", "geospatial_lon_max", "geospatial_lon_units"),
    *("geospatial_vertical_min", "geospatial_vertical_max", "geospatial_vertical_units"),
    *("geospatial_vertical_positive", "geospatial_bounds", "geospatial_bounds_crs", "geospatial_bounds_vertical_crs"),
    *("water_depth", "water_depth_units", "sensor_orientation"),
    *("time_coverage_start", "time_coverage_end", "time_coverage_duration", "time_coverage_resolution"),
)

TIME_SCALES = ("epoch", "epoch_ms", "datenum", "matplotlib", "decimal_year", "excel")  # numeric time scales

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
_STATED = {name.lower() for name in STATED}
_ATTRIBUTE = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,63}")
_EXPONENT = re.compile(r"[-+]?\d+[eE][-+]?\d+")
_TIME = re.compile(r"\d{4}-\d\d-\d\d([Tt ]\d\d:\d\d(:\d\d(\.\d{1,6})?)?( ?(Z|z|UTC)|[+-]\d\d(:?\d\d)?)?)?", re.ASCII)
_EARLIEST, _LATEST = datetime(1980, 1, 1, tzinfo=UTC), datetime(2101, 1, 1, tzinfo=UTC)
SHOWN = 60  # characters of a value or name shown in a message


def problem(
    key: str | None = None, expected: str | None = None, actual: str | None = None, advice: str | None = None
) -> PydanticCustomError:
    """Create the error of a value, or of a key below it; parts not given are taken from the field."""
    words = {"key": key, "expected": expected, "found": actual, "advice": advice}
    return PydanticCustomError("cruise", "not usable", words)


def shown(value: object) -> str:
    """Format a value for an error message, as written in YAML."""
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return repr(value) if len(value) <= SHOWN else repr(value[:SHOWN]) + " and more"
    if isinstance(value, dict | list | tuple):
        return "a mapping" if isinstance(value, dict) else "a list"
    return f"{value:.15g}" if isinstance(value, float) else str(value)


def number(value: Any) -> float:
    """Check a finite number; other strings, booleans, NaN and infinities are refused."""
    # YAML 1.1 reads 1e-2, without a point, as a string.
    if isinstance(value, str) and _EXPONENT.fullmatch(value):
        value = float(value)
    if isinstance(value, str):
        plain = "write a number with a point, without quotes, unit or leading zeros"
        raise problem(advice=plain if re.search(r"\d", value) else None)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise problem()
    return float(value)


def count(value: Any) -> int:
    """Check a whole number."""
    whole = number(value)
    if not whole.is_integer():
        raise problem()
    return int(whole)


def switch(value: Any) -> bool:
    """Check a boolean; yes, no, on and off are accepted as in YAML 1.1."""
    words = {"yes": True, "on": True, "no": False, "off": False}
    if isinstance(value, str) and value.lower() in words:
        return words[value.lower()]
    if not isinstance(value, bool):
        raise problem()
    return value


def text(value: Any) -> str:
    """Check a non-empty string."""
    if isinstance(value, bool | int | float):
        raise problem(advice=f"write it in quotes: '{shown(value)}'")
    if not isinstance(value, str) or not value.strip():
        raise problem()
    return value


def column(value: Any) -> str | int:
    """Check the header of a column, or its number from 1."""
    if isinstance(value, int) and not isinstance(value, bool) and value > 0:
        return value
    return text(value)


def time_columns(value: Any) -> str | int | tuple[str | int, ...]:
    """Check the column of a time, or the columns of its parts."""
    if isinstance(value, list | tuple) and not 2 <= len(value) <= 6:
        raise problem(advice="write [YEAR, DAY_OF_YEAR], or [YEAR, MONTH, DAY, HOUR, MINUTE, SECOND] as far as they go")
    return tuple(map(column, value)) if isinstance(value, list | tuple) else column(value)


def name(value: Any) -> str:
    """Check a name that serves as a folder name."""
    if not _NAME.fullmatch(text(value)):
        raise problem(expected=NAME_WORDS, advice="write for example EG4")
    return str(value)


def sphere(value: Any) -> str | bool:
    """Check the name of a sphere, or true for one without a name."""
    if value is False:
        raise problem()
    return True if value is True else name(value)


def nearest(word: str, allowed: Sequence[str]) -> str | None:
    """Suggest the allowed word that is most similar to a given one; None if none is similar."""
    near = difflib.get_close_matches(word, allowed, 1)
    return f"write {near[0]}" if near else None


def names(value: Any) -> Any:
    """Convert one name or a list of names to a tuple."""
    if value is None:
        return ()
    return tuple(value) if isinstance(value, list) else (value,)


def figure_formats(value: Any) -> tuple[str, ...]:
    """Check the formats of figures, and add png, which comes first, unless there is none."""
    listed = names(value)
    if any(item not in ("png", "pdf") for item in listed):
        raise problem()
    return tuple(sorted({"png", *listed}, reverse=True)) if listed else ()


def span(value: Any, *, from_zero: bool = False) -> tuple[float, float]:
    """Check a range of positive numbers, or of those from 0 on, as [lower, upper] or as a single number for both."""
    ends = tuple(number(end) for end in value) if isinstance(value, list) else (number(value),) * 2
    if len(ends) != 2 or not 0.0 <= ends[0] <= ends[1] or (ends[0] == 0.0 and not from_zero):
        raise problem()
    return ends[0], ends[1]


def coefficients(value: Any) -> dict[str, float]:
    """Check the coefficients A to E, all of which are required."""
    if not isinstance(value, dict) or set(value) != set("ABCDE"):
        raise problem()
    return {letter: number(value[letter]) for letter in "ABCDE"}


def covariance(value: Any) -> tuple[tuple[float, ...], ...]:
    """Check that the covariance of the five coefficients is symmetric and positive semidefinite."""
    if not (isinstance(value, list) and len(value) == 5 and all(isinstance(r, list) and len(r) == 5 for r in value)):
        raise problem()
    rows = np.array([[number(cell) for cell in row] for row in value])
    scale = max(float(np.abs(rows).max()), 1e-300)
    if np.abs(rows - rows.T).max() > 1e-6 * scale or np.linalg.eigvalsh(rows).min() < -1e-6 * scale:
        raise problem()
    return tuple(map(tuple, rows.tolist()))


def declination(value: Any) -> float | Literal["auto"]:
    """Check a declination, degrees east, or ``auto``."""
    if value == "auto":
        return "auto"
    degrees = number(value)
    if not -180.0 <= degrees <= 180.0:
        raise problem()
    return degrees


def quality_flags(value: Any) -> tuple[int, ...]:
    """Check and sort the quality flags of velocities that products may contain."""
    given = value if isinstance(value, list | tuple) else [value]
    if not given or any(isinstance(flag, bool) or flag not in (1, 2, 3) for flag in given):
        raise problem()
    return tuple(sorted({int(flag) for flag in given}))


def time_s(value: Any) -> float:
    """Parse a date (midnight) or an ISO 8601 time, UTC if it has no zone, to UTC seconds since 1970."""
    moment = value
    if not isinstance(value, date):
        if not isinstance(value, str) or not _TIME.fullmatch(value.strip()):
            raise problem()
        try:
            moment = datetime.fromisoformat(re.sub(r" ?(UTC|z|Z)$", "Z", value.strip()))
        except ValueError:  # for example month 13
            raise problem() from None
    if not isinstance(moment, datetime):
        moment = datetime(moment.year, moment.month, moment.day, tzinfo=UTC)
    if moment.tzinfo is None:
        moment = moment.replace(tzinfo=UTC)
    if not _EARLIEST <= moment < _LATEST:
        raise problem()
    return float(moment.timestamp())


def character(**named: str) -> Callable[[Any], str]:
    """Create a validator of a character that is given literally or by its name."""

    def check(value: Any) -> str:
        known = named.get(value, value) if isinstance(value, str) else None
        if known not in named.values():
            raise problem()
        return str(known)

    return check


def time_format(value: Any) -> str:
    """Check the format of the times in a table."""
    given = text(value)
    if given in TIME_SCALES:
        return given
    dated = all(re.search(f"%[{letters}]", given) for letters in ("Yy", "mbBj", "dj"))
    if not dated:
        raise problem(advice="write year, month and day, for example '%d/%m/%Y %H:%M'")
    return given


def zone(value: Any) -> str:
    """Parse UTC or an offset from it, such as +02:00."""
    given = text(value).strip()
    match = re.fullmatch(r"([+-])(\d\d):?([0-5]\d)?", given)
    if given.upper() in ("UTC", "Z", "GMT"):
        return "UTC"
    if not match or int(match[2]) > FARTHEST_ZONE_H:
        raise problem()
    return f"{match[1]}{match[2]}:{match[3] or '00'}"


def declination_applied(value: Any) -> float | dict[str, float]:
    """Check the declination contained in a file's directions, degrees: one number, or {heading, velocity}."""
    parts = dict(value) if isinstance(value, dict) else {"": value}
    if isinstance(value, dict) and {*parts} != {"heading", "velocity"}:
        given = ", ".join(map(str, parts)) or "an empty mapping"
        raise problem(actual=given, advice="write both, for example {heading: 0, velocity: -17.4}")
    degrees = {name: number(part) for name, part in parts.items()}
    if any(abs(item) > 180.0 for item in degrees.values()):
        raise problem()
    return degrees if isinstance(value, dict) else degrees[""]


def sound_speed(value: Any) -> str | dict[str, float]:
    """Check what corrects the speed of sound: ``auto``, ``keep`` or {salinity: S}, the practical salinity."""
    if value in ("auto", "keep"):
        return str(value)
    if not isinstance(value, dict) or {*value} != {"salinity"} or not 0.0 <= number(value["salinity"]) <= 42.0:
        raise problem()
    return {"salinity": number(value["salinity"])}


def missing(value: Any) -> tuple[str, ...]:
    """Check the fill values of a table, one or a list of strings and numbers."""
    listed = value if isinstance(value, list | tuple) else [value]
    if not all(isinstance(item, str | int | float) and not isinstance(item, bool) for item in listed):
        raise problem()
    return tuple(str(item).strip() for item in listed)


def iso(seconds: float) -> str:
    """Format UTC seconds since 1970 as an ISO 8601 time."""
    return datetime.fromtimestamp(seconds, UTC).isoformat().replace("+00:00", "Z")


def attributes(value: Any) -> dict[str, str | int | float]:
    """Check global attributes for the archive and remove empty ones."""
    if not isinstance(value, dict):
        raise problem()
    for attribute, content in value.items():
        if not _ATTRIBUTE.fullmatch(str(attribute)):
            expected, advice = "attribute names of letters, digits and '_'", "write for example ship"
            raise problem(None, expected, shown(attribute), advice)
        if stated(attribute):
            expected = "attributes that describe, such as institution, title or comment"
            raise problem(attribute, expected, f"{shown(attribute)}, which the product states itself", "delete it")
        if isinstance(content, bool) or not isinstance(content, str | int | float | None):
            raise problem(attribute, "a text or a number", shown(content), f"write it in quotes: {attribute}: '...'")
    return {attribute: content for attribute, content in value.items() if content is not None}


def stated(attribute: str) -> bool:
    """Return whether the product sets an attribute itself, ignoring case as names that differ in it are confusing."""
    return attribute.lower() in _STATED


def check_table(headers: dict[str, Any], depth: float | None) -> None:
    """Check that the columns of a table provide time, depth and exactly one set of velocity components."""
    check_clock(headers)
    if depth is None and not {"depth", "pressure"} & set(headers):
        advice = "add depth: 120 to the instrument, or depth: depth_m to its columns"
        raise problem("columns", "a depth or pressure column where the instrument has no depth", "neither", advice)
    for roles in VELOCITY_SETS:
        absent = [role for role in roles if role not in headers]
        # A heading may accompany any set, hence a heading alone does not require x and y.
        present = [role for role in roles if role in headers and role != "heading"]
        if present and absent:
            actual, advice = f"{' and '.join(present)} without it", f"add for example {absent[0]}: name_in_the_header"
            raise problem(f"columns.{absent[0]}", f"{'+'.join(roles)} together", actual, advice)
    complete = ["+".join(roles) for roles in VELOCITY_SETS if set(roles) <= set(headers)]
    if len(complete) != 1:
        advice = "keep one of them" if complete else "add for example east: u_cm_s and north: v_cm_s"
        actual = " and ".join(complete) or "none of them"
        raise problem("columns", "exactly one of east+north, speed+direction and x+y+heading", actual, advice)


def check_clock(headers: dict[str, Any]) -> None:
    """Check that the columns of a table provide the time, in one column or as separate date and clock."""
    apart = {"date", "clock"} & set(headers)
    if "time" in headers and apart:
        expected, advice = "time, or date and clock apart", "keep one of the two ways"
        raise problem("columns.time", expected, f"{' and '.join(sorted(apart))} beside it", advice)
    if len(apart) == 1:
        other = "clock" if "date" in apart else "date"
        advice = f"add {other}, or write time: where one column holds both"
        raise problem(f"columns.{other}", "date and clock together", f"{apart.pop()} alone", advice)
    if "time" not in headers and not apart:
        raise problem("columns.time", "the header of the time column", "nothing", "add for example time: time_utc")


# Paths: files must exist inside the cruise folder; globs are expanded.

RESULTS = "results"


@dataclass(frozen=True)
class RawFolder:
    """Folder in which raw files are searched, passed to the models as their validation context."""

    root: Path
    made_later: bool  # the raw files are made by rules (demonstration) or fetched from a storage, and may be absent


def paths(value: Any) -> tuple[str, ...]:
    """Check one path or a list of them, inside the cruise folder and relative to it."""
    listed = [text(path) for path in (value if isinstance(value, list | tuple) else [value])]
    for path in listed:
        if path.startswith(("/", "\\", "~")) or PureWindowsPath(path).drive or ".." in re.split(r"[/\\]", path):
            inside = "copy or link the file into the cruise folder and write its path from there"
            raise problem(None, "a path inside the cruise folder, relative to it", shown(path), inside)
        _refuse_unusable(path)
    return tuple(map(posixpath.normpath, listed))


def _refuse_unusable(path: str) -> None:
    if not path.isprintable():  # bytes that are not UTF-8 become surrogates, which are not printable
        raise problem(None, "a path in UTF-8 without control characters", shown(path), "rename the file")
    if "{" in path or "}" in path:  # Snakemake would interpret them as wildcards
        raise problem(None, "a path without braces", shown(path), "rename the file")


def mooring_paths(value: Any) -> str | tuple[str, ...]:
    """Check the folder of the mooring files (a string) or a list of mooring files (a tuple)."""
    return paths(value) if isinstance(value, list | tuple) else paths(value)[0]


def raw_files(value: Any, info: ValidationInfo) -> tuple[str, ...]:
    """Find existing raw files, with globs expanded and sorted; without a ``RawFolder`` only check their form."""
    listed, place = paths(value), info.context
    if not listed:
        raise problem(None, "at least one file", "an empty list")
    actual = [file for path in listed for file in ([path] if place is None else _expand_glob(path, place))]
    for file in actual:
        inside = file.startswith(f"{RESULTS}/")
        if place is not None and not inside:
            results = os.path.realpath(place.root / RESULTS)
            inside = os.path.realpath(place.root / file).startswith(f"{results}{os.sep}")
        if inside:
            apart = "copy it to another folder, for example raw"
            raise problem(None, f"a file outside {RESULTS}/, which each run may write over", shown(file), apart)
    return tuple(dict.fromkeys(actual))


def _expand_glob(path: str, place: RawFolder) -> list[str]:
    is_glob = any(mark in path for mark in "*?[")
    if os.path.isfile(place.root / path) or (place.made_later and not is_glob):
        return [path]
    if place.made_later:
        expected = "plain paths, as these files are made or fetched later"
        raise problem(None, expected, shown(path), "list the files")
    if os.path.isdir(place.root / path):
        raise problem(None, "a file", f"the folder {path}", f"write {path}/* for all files in it")
    # Hidden files are left out; ** does not follow symbolic links, which may form loops.
    pattern = f"{path}/*" if path.endswith("**") else re.sub(r"\*\*+(?=[^/*])|(?<=[^/*])\*\*+", "*", path)
    if pattern.count("**") > 1:  # each multiplies the time by the depth of the folders
        raise problem(None, "a glob with ** once at most", shown(path), "name the folders, or write *")
    there = place.root.glob(pattern) if is_glob else ()
    matches = [match.relative_to(place.root) for match in there if match.is_file()]
    files = sorted(str(match) for match in matches if not any(part.startswith(".") for part in match.parts))
    for file in files:
        _refuse_unusable(file)
    if not files:
        other = os.path.lexists(place.root / path)
        actual = f"no file that matches {path}" if is_glob else f"no file {path}"
        actual = f"{path}, a pipe, a device or a link that leads nowhere" if other else actual
        advice = "put it there or correct the path, relative to the cruise folder"
        raise problem(None, "an existing file", actual, advice)
    return files
