"""Types of single values in a cruise's YAML files: numbers, times, names, paths.

What pydantic refuses is described by the field (``cruise.describe``); ``problem`` creates an error with other words.
"""

import difflib
import os
import posixpath
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path, PureWindowsPath
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, ValidationInfo
from pydantic_core import PydanticCustomError

DECIDE = "DECIDE"  # placeholder in a draft for a value that the user must decide
NAME = r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}"
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
SHOWN = 60  # characters of a value or name shown in a message
RESULTS = "results"


def problem(
    key: str | None = None, expected: str | None = None, actual: str | None = None, advice: str | None = None
) -> PydanticCustomError:
    """Create the error of a value, or of a key below it; parts not given are taken from the field."""
    words = {"key": key, "expected": expected, "found": actual, "advice": advice}
    return PydanticCustomError("cruise", "not usable", words)


def shown(value: object) -> str:
    """Format a value for an error message, as written in YAML."""
    if isinstance(value, str):
        return repr(value) if len(value) <= SHOWN else repr(value[:SHOWN]) + " and more"
    if isinstance(value, dict | list | tuple):
        return "a mapping" if isinstance(value, dict) else "a list"
    if value is None or isinstance(value, bool):
        return {None: "nothing", True: "true", False: "false"}[value]
    return f"{value:.15g}" if isinstance(value, float) else str(value)


def nearest(word: str, allowed: Sequence[str]) -> str | None:
    """Suggest the allowed word that is most similar to a given one; None if none is similar."""
    near = difflib.get_close_matches(word, allowed, 1)
    return f"write {near[0]}" if near else None


def spelled(kind: Any, words: dict[Any, Any]) -> BeforeValidator:
    """Replace other spellings of a value, which is of ``kind`` in YAML."""

    def replace(value: Any) -> Any:
        written = value.lower() if isinstance(value, str) else value
        return words.get(written, value) if isinstance(written, str | bool) else value

    return BeforeValidator(replace, json_schema_input_type=kind)


def listed(single: Any, count: int = 1) -> BeforeValidator:
    """Let one value stand for a list of it, or for each of ``count``."""
    return BeforeValidator(
        lambda value: value if isinstance(value, list | tuple) else (value,) * count,
        json_schema_input_type=single | list[single],
    )


def ascending(ends: tuple[float, float]) -> tuple[float, float]:
    """Return both ends of an interval; the second must not be below the first."""
    if ends[0] > ends[1]:
        raise problem()
    return ends


def exponent(value: Any) -> Any:
    """Convert a number like 1e-2, without a point, which YAML 1.1 reads as a string."""
    return float(value) if isinstance(value, str) and re.fullmatch(r"[-+]?\d+[eE][-+]?\d+", value) else value


def name(value: str) -> str:
    """Check a name that serves as a folder name."""
    if not re.fullmatch(NAME, value):
        raise problem(expected=NAME_WORDS, advice="write for example EG4")
    return value


def covariance(rows: tuple[tuple[float, ...], ...]) -> tuple[tuple[float, ...], ...]:
    """Check that the covariance of the five coefficients is symmetric and positive semidefinite."""
    matrix = np.array(rows)
    slack = 1e-6 * max(float(np.abs(matrix).max()), 1e-300)
    if np.abs(matrix - matrix.T).max() > slack or np.linalg.eigvalsh(matrix).min() < -slack:
        raise problem()
    return rows


def time_s(value: str) -> float:
    """Parse a date (midnight) or an ISO 8601 time, UTC if it has no zone, to UTC seconds since 1970."""
    try:
        moment = datetime.fromisoformat(re.sub(r" ?(UTC|z)$", "Z", value.strip()))
    except ValueError:
        raise problem() from None
    moment = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
    if not datetime(1980, 1, 1, tzinfo=UTC) <= moment < datetime(2101, 1, 1, tzinfo=UTC):
        raise problem()
    return moment.timestamp()


def time_format(value: str) -> str:
    """Check the format of the times in a table."""
    if value not in TIME_SCALES and not all(re.search(f"%[{letters}]", value) for letters in ("Yy", "mbBj", "dj")):
        raise problem(advice="write year, month and day, for example '%d/%m/%Y %H:%M'")
    return value


def zone(value: str) -> str:
    """Parse UTC or an offset from it, such as +02:00."""
    if value.strip().upper() in ("UTC", "Z", "GMT"):
        return "UTC"
    match = re.fullmatch(r"([+-](?:0\d|1[0-4])):?([0-5]\d)?", value.strip())
    if not match:
        raise problem()
    return f"{match[1]}:{match[2] or '00'}"


def attributes(value: dict[str, Any]) -> dict[str, Any]:
    """Check global attributes for the archive and remove empty ones."""
    for attribute, content in value.items():
        if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,63}", attribute):
            raise problem(
                None, "attribute names of letters, digits and '_'", shown(attribute), "write for example ship"
            )
        if stated(attribute):
            expected = "attributes that describe, such as institution, title or comment"
            raise problem(attribute, expected, f"{shown(attribute)}, which the product states itself", "delete it")
        if isinstance(content, bool) or not isinstance(content, str | int | float | None):
            raise problem(attribute, "a text or a number", shown(content), f"write it in quotes: {attribute}: '...'")
    return {attribute: content for attribute, content in value.items() if content is not None}


def stated(attribute: str) -> bool:
    """Return whether the product sets an attribute itself, ignoring case as names that differ in it are confusing."""
    return attribute.lower() in {each.lower() for each in STATED}


def check_table(headers: dict[str, Any], depth: float | None) -> None:
    """Check that the columns of a table provide time, depth and exactly one set of velocity components."""
    check_clock(headers)
    if depth is None and not {"depth", "pressure"} & set(headers):
        advice = "add depth: 120 to the instrument, or depth: depth_m to its columns"
        raise problem("columns", "a depth or pressure column where the instrument has no depth", "neither", advice)
    given = {role for roles in VELOCITY_SETS for role in roles if role in headers}
    # A heading may accompany any set.
    if not any(set(roles) <= given <= {*roles, "heading"} for roles in VELOCITY_SETS):
        actual = " and ".join(sorted(given)) or "none of them"
        advice = "name the columns of one of them, for example east: u_cm_s and north: v_cm_s"
        raise problem("columns", "exactly one of east+north, speed+direction and x+y+heading", actual, advice)


def check_clock(headers: dict[str, Any]) -> None:
    """Check that the columns of a table provide the time, in one column or as separate date and clock."""
    given = [role for role in ("time", "date", "clock") if role in headers]
    if given not in (["time"], ["date", "clock"]):
        expected, advice = "the column of the time, or those of date and clock", "write for example time: time_utc"
        raise problem("columns.time", expected, " and ".join(given) or "nothing", advice)


# Paths: files must exist inside the cruise folder; globs are expanded.


@dataclass(frozen=True)
class RawFolder:
    """Folder in which raw files are searched, passed to the models as their validation context."""

    root: Path
    made_later: bool  # the raw files are made by rules (demonstration) or fetched from a storage, and may be absent


def _path(path: str) -> str:
    """Check a path inside the cruise folder and relative to it."""
    if path.startswith(("/", "\\", "~")) or PureWindowsPath(path).drive or ".." in re.split(r"[/\\]", path):
        inside = "copy or link the file into the cruise folder and write its path from there"
        raise problem(None, "a path inside the cruise folder, relative to it", shown(path), inside)
    return posixpath.normpath(_usable(path))


def _usable(path: str) -> str:
    if not path.isprintable():  # bytes that are not UTF-8 become surrogates, which are not printable
        raise problem(None, "a path in UTF-8 without control characters", shown(path), "rename the file")
    if "{" in path or "}" in path:  # Snakemake would interpret them as wildcards
        raise problem(None, "a path without braces", shown(path), "rename the file")
    return path


def _raw_files(given: tuple[str, ...], info: ValidationInfo) -> tuple[str, ...]:
    """Find existing raw files, with globs expanded and sorted; without a ``RawFolder`` only check their form."""
    place = info.context
    if not given:
        raise problem(None, "at least one file", "an empty list")
    actual = [file for path in given for file in ([path] if place is None else _expand_glob(path, place))]
    results = os.path.realpath((place.root if place else Path()) / RESULTS)
    for file in actual:
        if os.path.realpath((place.root if place else Path()) / file).startswith(f"{results}{os.sep}"):
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
    there = place.root.glob(pattern) if is_glob else ()
    matches = [match.relative_to(place.root) for match in there if match.is_file()]
    files = sorted(str(match) for match in matches if not any(part.startswith(".") for part in match.parts))
    if not files:
        advice = "put it there or correct the path, relative to the cruise folder"
        raise problem(None, "an existing file", f"no file {'that matches ' * is_glob}{path}", advice)
    return [_usable(file) for file in files]


# Annotated types, as the models use them.

_STRICT = Field(strict=True)
_LETTER = Literal["A", "B", "C", "D", "E"]
Number = Annotated[float, Field(strict=True, allow_inf_nan=False), BeforeValidator(exponent)]
Positive = Annotated[Number, Field(gt=0)]
Degrees = Annotated[Number, Field(ge=-180, le=180)]
Count = Annotated[int, _STRICT]
Switch = Annotated[bool, _STRICT, spelled(bool, {"yes": True, "on": True, "no": False, "off": False})]
Text = Annotated[str, Field(pattern=r"\S")]
Cell = str | Count | Number
Column = Text | Annotated[int, Field(strict=True, ge=1)]
TimeColumns = Column | Annotated[tuple[Column, ...], Field(min_length=2, max_length=6)]
Name = Annotated[str, AfterValidator(name)]
Names = Annotated[tuple[Name, ...], listed(str)]
Sphere = Name | Literal[True]
Time = Annotated[float, BeforeValidator(lambda value: time_s(str(value)), json_schema_input_type=str)]
Paths = Annotated[tuple[Annotated[str, AfterValidator(_path)], ...], listed(str)]
Files = Annotated[Paths, AfterValidator(_raw_files)]
MooringPaths = Annotated[str, AfterValidator(_path)] | Paths
Attributes = Annotated[dict[str, Any], AfterValidator(attributes)]
Declination = Degrees | Literal["auto"]
DeclinationApplied = Degrees | Annotated[dict[Literal["heading", "velocity"], Degrees], Field(min_length=2)]
Salinity = Annotated[dict[Literal["salinity"], Annotated[Number, Field(ge=0, le=42)]], Field(min_length=1)]
SoundSpeed = Literal["auto", "keep"] | Salinity
TimeFormat = Annotated[Text, AfterValidator(time_format)]
Delimiter = Annotated[
    Literal[",", ";", "\t", " "], spelled(str, {"comma": ",", "semicolon": ";", "tab": "\t", "blank": " "})
]
Decimal = Annotated[Literal[".", ","], spelled(str, {"point": ".", "comma": ","})]
Zone = Annotated[str, AfterValidator(zone)]
Missing = Annotated[tuple[Annotated[Cell, AfterValidator(lambda value: str(value).strip())], ...], listed(Cell)]
WRITTEN = Literal["magnetic", "true", True]
Reference = Annotated[
    Literal["magnetic", "true"], spelled(WRITTEN, {True: "true"})
]  # an unquoted true is a truth value
FigureFormat = Literal["png", "pdf"]
Formats = Annotated[
    tuple[FigureFormat, ...],
    listed(FigureFormat),
    AfterValidator(lambda given: tuple(sorted({"png", *given}, reverse=True)) if given else ()),
]
FlagValues = Annotated[
    tuple[Literal[1, 2, 3], ...],
    Field(min_length=1),
    listed(int),
    AfterValidator(lambda flags: tuple(sorted(set(flags)))),
]
Coefficients = Annotated[dict[_LETTER, Number], Field(min_length=5), AfterValidator(lambda x: dict(sorted(x.items())))]
Covariance = Annotated[
    tuple[Annotated[tuple[Number, ...], Field(min_length=5, max_length=5)], ...],
    Field(min_length=5, max_length=5),
    AfterValidator(covariance),
]
Span = Annotated[tuple[Positive, Positive], AfterValidator(ascending), listed(float, 2)]
DepthM = Annotated[Number, Field(ge=0)]
Depths = Annotated[tuple[DepthM, DepthM], AfterValidator(ascending), listed(float, 2)]
