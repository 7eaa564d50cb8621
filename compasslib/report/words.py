"""Numbers, dates and names as the report writes them, and the texts of its templates.

The sentences of the page stand in ``templates/*.txt``, a macro for each, in plain text.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from datetime import datetime
from functools import cache
from pathlib import Path
from typing import Any

from compasslib import angles
from compasslib.calibrations import MODELS
from compasslib.inference.finding import is_confirmed

UNKNOWN = "\N{EN DASH}"
MINUS, SPACE = "\N{MINUS SIGN}", "\N{NO-BREAK SPACE}"
TEMPLATES = Path(__file__).resolve().parent / "templates"


def number(value: float | None, digits: int = 1) -> str:
    """Format a number with a fixed count of decimals, a dash where it is NaN or None."""
    if value is None or not math.isfinite(value):
        return UNKNOWN
    if abs(value) >= 1e9:  # nothing on the page is that large in earnest, and 140 digits help nobody
        return f"{value:.1e}".replace("-", MINUS)
    return f"{value:.{digits}f}".replace("-", MINUS)


def degrees(value: float | None, digits: int = 1) -> str:
    """Format an angle with its sign of degree."""
    text = number(value, digits)
    return text if text == UNKNOWN else f"{text}°"


def significant(value: float | None, digits: int = 3) -> str:
    """Format a number of any size to a few significant digits."""
    if value is None or not math.isfinite(value):
        return UNKNOWN
    return f"{value:.{digits}g}".replace("-", MINUS)


def with_sigma(value: float | None, sigma: float | None, unit: str = "") -> str:
    """Format value ± sigma, the value to the place of sigma's second digit, the unit behind both."""
    behind = "°" if unit in ("degrees", "°") else f"{SPACE}{unit}" * (unit not in ("", "1"))
    if value is None or sigma is None or not (math.isfinite(sigma) and sigma > 0.0):
        text = significant(value)
        return text if text == UNKNOWN else text + behind
    digits = min(max(1 - math.floor(math.log10(sigma)), 0), 12)
    return f"{number(value, digits)}{SPACE}±{SPACE}{number(sigma, digits)}{behind}"


def percent(share: float | None) -> str:
    """Format a share from 0 to 1 as percent; 0 and 100 are written only where they are exact."""
    if share is None or not math.isfinite(share):
        return UNKNOWN
    text = number(100.0 * share)
    if text == "100.0" and share < 1.0:
        text = ">99.9"
    if text == "0.0" and share > 0.0:
        text = "<0.1"
    return f"{text}{SPACE}%"


def chance(probability: float) -> str:
    """Format a probability as whole percent, never as certainty."""
    text = f"{100.0 * probability:.0f}"
    return {"100": ">99", "0": "<1"}.get(text, text) + f"{SPACE}%"


def current(velocity: complex) -> str:
    """Format a current, east + i north in m/s, as speed and direction."""
    if not math.isfinite(abs(velocity)):
        return UNKNOWN
    towards = angles.direction(velocity.real, velocity.imag)
    return f"{number(100.0 * abs(velocity))}{SPACE}cm/s towards {degrees(float(towards), 0)}"


def count(value: int | None) -> str:
    """Format a whole number, thousands apart."""
    return UNKNOWN if value is None else f"{value:,}".replace(",", SPACE)


def plural(n: int, noun: str, many: str | None = None) -> str:
    """Format a number with its noun, in the plural ``many`` where an s does not make it."""
    return f"{count(n)}{SPACE}{noun if n == 1 else many or noun + 's'}"


def days(span: Mapping[str, str]) -> str:
    """Format a span of time, ``from`` and ``to`` in ISO 8601, as two dates, or as hours of one day."""
    first, last = (datetime.fromisoformat(span[end].replace("Z", "+00:00")) for end in ("from", "to"))
    begin, end = (f"{at.day}{SPACE}{at:%b}{SPACE}{at.year}" for at in (first, last))
    return f"{begin} to {end}" if begin != end else f"{begin}, {span['from'][11:16]} to {span['to'][11:16]} UTC"


def position(latitude: float, longitude: float) -> str:
    """Format a position, 65.3333° N, 32.9550° W; longitude in degrees east, -180 to 360."""
    east = longitude - 360.0 if longitude > 180.0 else longitude
    return f"{abs(latitude):.4f}° {'N' if latitude >= 0 else 'S'}, {abs(east):.4f}° {'E' if east >= 0 else 'W'}"


def plain(name: str) -> str:
    """Spell out a name with underscores, or that of a composed effect."""
    if name.startswith("composed:"):
        from compasslib.inference import wording  # only where an effect outside the catalogue was identified

        return wording.display_name(name)
    return name.replace("_", " ")


def parameter(name: str, unit: str) -> str:
    """Spell out the name of a parameter without the unit at its end, which stands behind its value."""
    return plain(name.removesuffix(f"_{'deg' if unit in ('degrees', '°') else unit}"))


def listed(names: list[str]) -> str:
    """Join names in a sentence."""
    return "".join(names) if len(names) < 2 else f"{', '.join(names[:-1])} and {names[-1]}"


def sentence(text: str) -> str:
    """Give a text a capital and a full stop."""
    text = text.strip()
    begun = text[:1].upper() + text[1:]
    return begun if not begun or begun.endswith((".", "!", "?")) else begun + "."


def confirmed(finding: Mapping[str, Any]) -> bool:
    """Judge whether held-out days show a finding and chance hardly does; true where they are not asked."""
    proof = finding.get("heldout") or {}
    size, placebo = proof.get("amplitude_deg"), proof.get("placebo")
    return not (size and placebo) or is_confirmed(size["low"], placebo["rank_p"])


def observations(separated_by: str | None) -> list[str]:
    """Split what would separate alternatives; of more than three, those that name an observation."""
    parts = [part for part in (separated_by or "").split("; ") if part]
    named = [part for part in parts if not part.endswith("vary independently")]
    return named if named and len(parts) > 3 else parts


FILTERS = (
    confirmed,
    number, degrees, significant, with_sigma, percent, chance, current, count, plural, days, plain, parameter, listed,
    sentence, observations,
)  # fmt: skip


def standard_error(covariance: Any, k: int) -> float | None:
    """Compute the standard error of the k-th coefficient; None where its covariance is unknown."""
    return math.sqrt(covariance[k][k]) if covariance and covariance[k][k] is not None else None


@cache
def _template(name: str) -> Any:
    import jinja2  # only where a text is made

    made = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=lambda value: re.sub(r"[\n|]+", " ", value) if isinstance(value, str) else value,
    )
    made.filters |= {each.__name__: each for each in FILTERS}
    made.globals |= {"unknown": UNKNOWN, "models": MODELS, "position": position, "sigma": standard_error}
    made.globals["wrap360"] = angles.wrap360
    return made.get_template(f"{name}.txt").module


def _filled(template: str, block: str, given: dict[str, Any]) -> str:
    """Fill a block of a template.

    Raises:
        LookupError: the results lack something that it names.
    """
    import jinja2

    try:
        return str(getattr(_template(template), block)(**given))
    except jinja2.UndefinedError as error:
        raise LookupError(str(error)) from error


def lines(template: str, block: str, **given: Any) -> list[str]:
    """Fill a block of a template; each line is a text."""
    filled = _filled(template, block, given).split("\n")
    return [text for line in filled if (text := re.sub(r"[ ]+", " ", line).strip(" "))]


def paragraphs(template: str, block: str, **given: Any) -> tuple[str, ...]:
    """Fill a block of a template; blank lines separate its texts."""
    filled = re.split(r"\n\s*\n", _filled(template, block, given))
    return tuple(text for part in filled if (text := re.sub(r"[ \n]+", " ", part).strip(" ")))


def caption(template: str, figure: str, **given: Any) -> str:
    """Fill the caption of a figure, ``figure_NAME`` of a template; empty where it has none."""
    block = f"figure_{figure}"
    return " ".join(paragraphs(template, block, **given)) if hasattr(_template(template), block) else ""


def facts(template: str, block: str, **given: Any) -> tuple[tuple[str, str], ...]:
    """Fill a block of a template; each line is a name and, after a colon, its value."""
    parts = (line.partition(": ") for line in lines(template, block, **given))
    return tuple((name, value) for name, _, value in parts)


def cells(template: str, block: str, **given: Any) -> list[tuple[str, ...]]:
    """Fill a block of a template; each line is a row, its cells separated by bars."""
    return [tuple(cell.strip(" ") for cell in line.split("|")) for line in lines(template, block, **given)]
