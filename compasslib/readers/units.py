"""Units of netCDF variables, and of tables as headers and unit rows state them, as factors to those of records."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping

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
TEMPERATURE = dict.fromkeys((*CELSIUS, "k", "kelvin", "degrees c", "degree c"), 1.0)
KELVIN, ZERO_CELSIUS = ("k", "kelvin"), 273.15
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
