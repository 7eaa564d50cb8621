"""Numbers, dates and names as the report writes them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import datetime

from compasslib import angles

UNKNOWN = "\N{EN DASH}"
MINUS, SPACE = "\N{MINUS SIGN}", "\N{NO-BREAK SPACE}"
METHODS = {
    "exact": "exact compass",
    "von_appen": "series of von Appen 2015",
    "calibration": "calibration made elsewhere",
}


def number(value: float | None, digits: int = 1) -> str:
    """Return a number with a fixed count of decimals, a dash where there is none.

    Args:
        value: any number, NaN or None.
    """
    if value is None or not math.isfinite(value):
        return UNKNOWN
    if abs(value) >= 1e9:  # nothing on the page is that large in earnest, and 140 digits help nobody
        return f"{value:.1e}".replace("-", MINUS)
    return f"{value:.{digits}f}".replace("-", MINUS)


def degrees(value: float | None, digits: int = 1) -> str:
    """Return an angle with its sign of degree.

    Args:
        value: degrees, NaN or None.
    """
    text = number(value, digits)
    return text if text == UNKNOWN else f"{text}°"


def significant(value: float | None, digits: int = 3) -> str:
    """Return a number of any size to a few significant digits.

    Args:
        value: any number, NaN or None.
        digits: significant ones.
    """
    if value is None or not math.isfinite(value):
        return UNKNOWN
    return f"{value:.{digits}g}".replace("-", MINUS)


def with_sigma(value: float | None, sigma: float | None, unit: str = "") -> str:
    """Return value ± sigma, the value to the place of sigma's second digit.

    Args:
        value: any number, NaN or None.
        unit: written after both.
    """
    behind = "°" if unit in ("degrees", "°") else f"{SPACE}{unit}" * (unit not in ("", "1"))
    if value is None or sigma is None or not (math.isfinite(sigma) and sigma > 0.0):
        text = significant(value)
        return text if text == UNKNOWN else text + behind
    digits = min(max(1 - math.floor(math.log10(sigma)), 0), 12)
    return f"{number(value, digits)}{SPACE}±{SPACE}{number(sigma, digits)}{behind}"


def percent(share: float | None) -> str:
    """Return a share as percent; all and none are said only where they are true.

    Args:
        share: from 0 to 1, NaN or None.
    """
    if share is None or not math.isfinite(share):
        return UNKNOWN
    text = number(100.0 * share)
    if text == "100.0" and share < 1.0:
        text = ">99.9"
    if text == "0.0" and share > 0.0:
        text = "<0.1"
    return f"{text}{SPACE}%"


def chance(probability: float) -> str:
    """Return a probability as whole percent; certainty is never said.

    Args:
        probability: from 0 to 1.
    """
    text = f"{100.0 * probability:.0f}"
    return {"100": ">99", "0": "<1"}.get(text, text) + f"{SPACE}%"


def current(velocity: complex) -> str:
    """Return a current as its speed and where it goes.

    Args:
        velocity: east + i north, m/s.
    """
    if not math.isfinite(abs(velocity)):
        return UNKNOWN
    towards = angles.direction(velocity.real, velocity.imag)
    return f"{number(100.0 * abs(velocity))}{SPACE}cm/s towards {degrees(float(towards), 0)}"


def count(value: int | None) -> str:
    """Return a whole number, thousands apart."""
    return UNKNOWN if value is None else f"{value:,}".replace(",", SPACE)


def plural(n: int, noun: str, many: str | None = None) -> str:
    """Return a number with its noun.

    Args:
        many: its plural where an s does not make it.
    """
    return f"{count(n)}{SPACE}{noun if n == 1 else many or noun + 's'}"


def day(stamp: str) -> str:
    """Return the date of an ISO 8601 instant, 4 Sep 2007."""
    at = datetime.fromisoformat(stamp.replace("Z", "+00:00"))
    return f"{at.day}{SPACE}{at:%b}{SPACE}{at.year}"


def days(span: Mapping[str, str]) -> str:
    """Return a span of time as two dates, or as hours of one day.

    Args:
        span: ``from`` and ``to``, ISO 8601, UTC.
    """
    begin, end = day(span["from"]), day(span["to"])
    return f"{begin} to {end}" if begin != end else f"{begin}, {span['from'][11:16]} to {span['to'][11:16]} UTC"


def position(latitude: float, longitude: float) -> str:
    """Return a position, 65.3333° N, 32.9550° W.

    Args:
        longitude: degrees east, -180 to 360.
    """
    east = longitude - 360.0 if longitude > 180.0 else longitude
    return f"{abs(latitude):.4f}° {'N' if latitude >= 0 else 'S'}, {abs(east):.4f}° {'E' if east >= 0 else 'W'}"


def plain(name: str) -> str:
    """Return a name of the catalogue or of a count in words.

    Args:
        name: with underscores.
    """
    if name.startswith("composed:"):
        from compasslib.inference import wording  # only where nobody listed what was found

        return wording.display_name(name)
    return name.replace("_", " ")


def parameter(name: str, unit: str) -> str:
    """Return the name of a parameter without the unit at its end, which stands behind its value.

    Args:
        name: with underscores.
    """
    return plain(name.removesuffix(f"_{'deg' if unit in ('degrees', '°') else unit}"))


def listed(names: list[str]) -> str:
    """Return names in a sentence."""
    return "".join(names) if len(names) < 2 else f"{', '.join(names[:-1])} and {names[-1]}"


def sentence(text: str) -> str:
    """Return a text with a capital and a full stop.

    Args:
        text: what may be a fragment.
    """
    text = text.strip()
    begun = text[:1].upper() + text[1:]
    return begun if not begun or begun.endswith((".", "!", "?")) else begun + "."
