"""Words for quality flags and units: meanings of flags as OceanSITES flags, and units as factors to those of records.

Flags are those of OceanSITES (manual 1.2 to 1.4), IMOS, Argo (reference table 2), SeaDataNet (L20), QARTOD and WOCE (of
CTDs). A meaning or value found neither there nor under the mooring file's key ``flags`` never counts as good.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from compasslib.records import BAD, GOOD, MISSING, NOT_CHECKED, PROBABLY_BAD, PROBABLY_GOOD, Flags

ORDER = (GOOD, PROBABLY_GOOD, NOT_CHECKED, PROBABLY_BAD, BAD, MISSING)  # from best to worst
KEYS = {"good": GOOD, "bad": BAD, "unchecked": NOT_CHECKED}  # of the mooring file's ``flags``
_WORDS = {
    NOT_CHECKED: (
        "unknown no_qc no_qc_performed no_quality_control no_quality_control_performed not_evaluated not_checked "
        "unchecked not_evaluated_or_unknown not_evaluated_not_available_or_unknown not_calibrated no_flag_assigned"
    ),
    GOOD: "good good_data good_value pass passed acceptable acceptable_measurement good_measurement",
    PROBABLY_GOOD: (
        "probably_good probably_good_data probably_good_value value_changed changed_value changed interpolated "
        "interpolated_value interpolated_values estimated estimated_value nominal_value despiked "
        "interpolated_measurement interpolated_over_interval_larger_than_2_dbar "
        "interpolated_over_a_pressure_interval_larger_than_2_dbar"
    ),
    PROBABLY_BAD: (
        "probably_bad probably_bad_data probably_bad_value potentially_correctable_bad_data suspect suspicious "
        "bad_data_that_are_potentially_correctable bad_data_potentially_correctable suspect_or_of_high_interest "
        "suspect_or_high_interest suspect_data questionable questionable_measurement value_below_detection "
        "value_in_excess value_phenomenon_uncertain value_below_limit_of_quantification"
    ),
    BAD: "bad bad_data bad_value bad_measurement fail failed",
    MISSING: "missing missing_data missing_value missing_values not_reported not_sampled",
}
MEANINGS = {word: flag for flag, words in _WORDS.items() for word in words.split()}
_COMMON = {"0": "no_qc_performed", "1": "good_data", "2": "probably_good_data", "3": "probably_bad", "4": "bad_data"}
_COMMON |= {"5": "value_changed", "8": "interpolated_value", "9": "missing_value"}
_L20 = _COMMON | {"6": "value_below_detection", "7": "value_in_excess", "A": "value_phenomenon_uncertain"}
_L20 |= {"B": "nominal_value", "Q": "value_below_limit_of_quantification"}
_QARTOD = {"1": "pass", "2": "not_evaluated", "3": "suspect", "4": "fail", "9": "missing_data"}
_WOCE = {"1": "not_calibrated", "2": "acceptable_measurement", "3": "questionable_measurement", "4": "bad_measurement"}
_WOCE |= {"5": "not_reported", "6": "interpolated_measurement", "7": "despiked", "9": "not_sampled"}
# Name, pattern of texts that name it, and value -> meaning of each vocabulary, for flags without stated meanings.
VOCABULARIES: tuple[tuple[str, str, Mapping[str, str]], ...] = (
    ("OceanSITES", r"oceansites", _COMMON | {"7": "nominal_value"}),
    ("SeaDataNet L20", r"seadatanet|sdn:l20", _L20),
    ("QARTOD", r"qartod", _QARTOD),
    ("WOCE", r"\bwoce", _WOCE),
    ("Argo", r"\bargo\b", _COMMON),
    ("IMOS", r"\bimos\b", _COMMON),
)


def parse_flag_settings(key: Mapping[str, Iterable[object]] | None) -> dict[str, int]:
    """Map each meaning or value under the mooring file's key ``flags`` (good, bad, unchecked) to an OceanSITES flag."""
    return {normalize(item): KEYS[name] for name, items in (key or {}).items() for item in items}


def normalize(word: object) -> str:
    """Normalize a meaning or value for comparison: lower case, words joined by underscores."""
    return re.sub(r"[\s-]+", "_", str(word).strip().lower())


def flag_of(value: str, word: str, stated: Mapping[str, int]) -> int | None:
    """Look up the OceanSITES flag of a value and its meaning; ``stated`` takes precedence; None if unknown."""
    word, value = normalize(word), normalize(value)
    return stated.get(word, stated.get(value, MEANINGS.get(word)))


def find_vocabulary(*texts: str) -> tuple[str, Mapping[str, str]]:
    """Find the vocabulary, as name and value -> meaning, that the first of several texts names; empty without one."""
    for text in texts:
        for name, pattern, words in VOCABULARIES:
            if re.search(pattern, text.lower()):
                return name, words
    return "", {}


def worst_flag(flags: Sequence[ArrayLike]) -> Flags:
    """Compute the element-wise worst of several flags with broadcasting."""
    rank = np.zeros(max(ORDER) + 1, dtype=np.int8)
    rank[list(ORDER)] = np.arange(len(ORDER))
    highest: Any = reduce(np.maximum, (rank[np.asarray(flag)] for flag in flags))
    return np.array(ORDER, dtype=np.int8)[highest]


def describe_unknown_flags(where: str, unknown: Mapping[str, int], most: int = 5) -> str:
    """Compose the warning about unknown flag meanings of a variable or column, with their numbers of samples."""
    shown = ", ".join(f"{meaning} ({n} samples)" for meaning, n in list(unknown.items())[:most])
    more = f" and {len(unknown) - most} more" if len(unknown) > most else ""
    return (
        f"{where}: the meaning of the flags {shown}{more} is not known, and they count as probably bad; say it in the "
        f"mooring file, for example flags: {{bad: [{next(iter(unknown))}]}}, or under good or unchecked."
    )


SPEED = {"m s-1": 1.0, "m/s": 1.0, "m.s-1": 1.0, "meter second-1": 1.0, "meters per second": 1.0, "meters/second": 1.0}
SPEED |= {unit.replace("m", "cm", 1): 0.01 for unit in ("m s-1", "m/s", "m.s-1")} | {"cm/sec": 0.01, "m/sec": 1.0}
SPEED |= {unit.replace("m", "mm", 1): 0.001 for unit in ("m s-1", "m/s", "m.s-1")}
ANGLE = dict.fromkeys(("degree", "degrees", "deg", "degree_true", "degrees_true", "degrees_magnetic"), 1.0)
ANGLE |= {"hundredths of degrees": 0.01, "tenths of degrees": 0.1}
_PREFIXES = {"c": 0.01, "centi": 0.01, "centi-": 0.01, "d": 0.1, "deci": 0.1, "deci-": 0.1}  # OOI: cdegrees
ANGLE |= {f"{prefix}{unit}": by for prefix, by in _PREFIXES.items() for unit in ("degree", "degrees", "deg")}
ANGLE |= dict.fromkeys(("rad", "radian", "radians"), math.degrees(1.0))
PRESSURE = dict.fromkeys(("dbar", "decibar", "decibars", "db"), 1.0) | {"pa": 1e-4, "hpa": 1e-2, "mbar": 1e-2}
PRESSURE |= {"kpa": 0.1, "bar": 10.0, "deca-pascals": 1e-3, "dapa": 1e-3}
LENGTH = dict.fromkeys(("m", "meter", "meters", "metre", "metres"), 1.0) | {"cm": 0.01, "km": 1000.0}
CELSIUS = ("c", "degc", "deg_c", "degree_c", "degrees_c", "celsius", "degree_celsius", "degrees_celsius", "deg c")
KELVIN, ZERO_CELSIUS = ("k", "kelvin"), 273.15
TEMPERATURE = dict.fromkeys((*CELSIUS, *KELVIN, "degrees c", "degree c"), 1.0)
FACTORS = dict.fromkeys(("heading", "direction", "tilt_x", "tilt_y", "declination"), ANGLE)
FACTORS |= {"east": SPEED, "north": SPEED, "speed": SPEED, "pressure": PRESSURE, "temperature": TEMPERATURE}
FACTORS |= dict.fromkeys(("depth", "range", "cell_depth"), LENGTH)
FLOWS = ("east", "north", "speed", "x", "y")  # roles of velocities in tables
LENGTHS = {"mm": 0.001, "cm": 0.01, "dm": 0.1, "m": 1.0, "ft": 0.3048, "": 1852.0 / 3600.0}  # a second; empty: knots
SPEED_END = re.compile(  # speed at the end of a header, in brackets or not
    r"(?:^|[\W_])(?:(mm|cm|dm|m|ft|(?:milli|centi|deci)?met(?:er|re)s?)[\W_]*(?:/|p|per)?[\W_]*"
    r"s(?:ec(?:ond)?s?)?(?:\W*-?1|⁻¹)?|kn|kts?|knots?)\W*$"
)
_BRACKETS = re.compile(r"[\[(]([^\])]*)[\])]")
_NORTH = {  # words for the reference north of directions
    "magnetic": re.compile(r"(?:deg(?:rees?)?|°)[\W_]*m(?![a-z])|(?<![a-z])mag(?:netic)?(?![a-z])"),
    "true": re.compile(r"(?:deg(?:rees?)?|°)[\W_]*t(?![a-z])|(?<![a-z])true(?![a-z])"),
}


def stated_factor(role: str, texts: Iterable[str]) -> tuple[float, str] | None:
    """Find the factor and the name of the unit that the texts of a table's column state; None without any known."""
    lower = [text.lower() for text in texts]
    parts = [part for text in lower for part in (*_BRACKETS.findall(text), _BRACKETS.sub("", text))]
    for part in map(str.strip, parts):
        if role in FLOWS:
            if match := SPEED_END.search(part):
                return LENGTHS[re.sub(r"illi|enti|eci|et(?:er|re)s?", "", match[1] or "")], match[0].strip(" _")
            continue
        for unit in (part, re.split(r"[\s_,;]", part)[-1]):
            if unit in FACTORS[role]:
                return FACTORS[role][unit], unit
    return None


def stated_north(texts: Mapping[str, Iterable[str]]) -> str | None:
    """Find the north that the texts of columns by role state: of velocities, else of headings; None if none or both."""
    norths: dict[bool, set[str]] = {True: set(), False: set()}
    for role in {"east", "north", "direction", "heading"} & {*texts}:
        words = " ".join(texts[role]).lower()
        norths[role == "heading"] |= {north for north, pattern in _NORTH.items() if pattern.search(words)}
    north = norths[False] or norths[True]
    return north.pop() if len(north) == 1 else None
