"""Format numbers, dates and names for the report, and render its text templates.

The sentences of the page are macros in ``templates/*.txt``, in plain text.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from datetime import datetime
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from compasslib import angles
from compasslib.archive import provenance
from compasslib.calibrations import MODELS
from compasslib.inference.finding import is_confirmed

if TYPE_CHECKING:
    import jinja2
    from markupsafe import Markup

UNKNOWN = "\N{EN DASH}"
MINUS, SPACE = "\N{MINUS SIGN}", "\N{NO-BREAK SPACE}"
TEMPLATES = Path(__file__).resolve().parent / "templates"


def number(value: float | None, digits: int = 1) -> str:
    """Format a number with a fixed number of decimals, or as a dash if it is NaN or None."""
    if value is None or not math.isfinite(value):
        return UNKNOWN
    if abs(value) >= 1e9:  # only results of a failed fit are that large, and could have 140 digits
        return f"{value:.1e}".replace("-", MINUS)
    return f"{value:z.{digits}f}".replace("-", MINUS)  # z: no minus before zero


def degrees(value: float | None, digits: int = 1) -> str:
    """Format an angle with a degree sign."""
    text = number(value, digits)
    return text if text == UNKNOWN else f"{text}°"


def significant(value: float | None, digits: int = 3) -> str:
    """Format a number of any size to a few significant digits."""
    if value is None or not math.isfinite(value):
        return UNKNOWN
    return f"{value:.{digits}g}".replace("-", MINUS)


def with_sigma(value: float | None, sigma: float | None, unit: str = "") -> str:
    """Format value ± sigma with a unit, both rounded to the second significant digit of sigma."""
    behind = "°" if unit in ("degrees", "°") else f"{SPACE}{unit}" * (unit not in ("", "1"))
    if value is None or sigma is None or not (math.isfinite(sigma) and sigma > 0.0):
        text = significant(value)
        return text if text == UNKNOWN else text + behind
    digits = min(max(1 - math.floor(math.log10(sigma)), 0), 12)
    return f"{number(value, digits)}{SPACE}±{SPACE}{number(sigma, digits)}{behind}"


def percent(share: float | None) -> str:
    """Format a share from 0 to 1 as percent; 0 and 100 are used only if they are exact."""
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
    """Format a whole number with spaces between thousands."""
    return UNKNOWN if value is None else f"{value:,}".replace(",", SPACE)


def plural(n: int, noun: str, many: str | None = None) -> str:
    """Format a number with its noun; ``many`` is a plural that is not formed by adding an s."""
    return f"{count(n)}{SPACE}{noun if n == 1 else many or noun + 's'}"


def days(span: Mapping[str, str]) -> str:
    """Format a time span, ``from`` and ``to`` in ISO 8601, as two dates, or as one date with hours."""
    first, last = (datetime.fromisoformat(span[end].replace("Z", "+00:00")) for end in ("from", "to"))
    begin, end = (f"{at.day}{SPACE}{at:%b}{SPACE}{at.year}" for at in (first, last))
    return f"{begin} to {end}" if begin != end else f"{begin}, {span['from'][11:16]} to {span['to'][11:16]} UTC"


def plain(name: str) -> str:
    """Convert a name with underscores, or that of a composed effect, to plain words."""
    if name.startswith("composed:"):
        from compasslib.inference import wording  # only where an effect outside the catalogue was identified

        return wording.display_name(name)
    return name.replace("_", " ")


def effect_title(finding: Mapping[str, Any]) -> str:
    """Name the effect of a finding, or the driver of one outside the catalogue."""
    composed = finding.get("composition")
    return f"unlisted, driven by {plain(composed['driver'])}" if composed else plain(finding["effect"])


def parameter(name: str, unit: str) -> str:
    """Convert the name of a parameter to plain words, without the suffix of its unit."""
    return plain(name.removesuffix(f"_{'deg' if unit in ('degrees', '°') else unit}"))


def listed(names: list[str]) -> str:
    """Join names by commas and a final "and"."""
    return "".join(names) if len(names) < 2 else f"{', '.join(names[:-1])} and {names[-1]}"


def sentence(text: str) -> str:
    """Capitalize a text and end it with a full stop."""
    text = text.strip()
    begun = text[:1].upper() + text[1:]
    return begun if not begun or begun.endswith((".", "!", "?")) else begun + "."


def confirmed(finding: Mapping[str, Any]) -> bool:
    """Return whether held-out days confirm a finding beyond chance; true if it was not tested on them."""
    proof = finding.get("heldout") or {}
    size, placebo = proof.get("amplitude_deg"), proof.get("placebo")
    return not (size and placebo) or is_confirmed(size["low"], placebo["rank_p"])


def limits(diagnosis: Mapping[str, Any]) -> list[tuple[str, float | None]]:
    """List effects with their detection limits, smallest first, last those without; not alternatives of a finding."""
    found = {name for entry in diagnosis.get("findings") or [] for name in entry["alternatives"]}
    each = [(name, size) for name, size in (diagnosis.get("detectable_deg") or {}).items() if name not in found]
    return sorted(each, key=lambda item: math.inf if item[1] is None else item[1])


def observations(separated_by: str | None) -> list[str]:
    """Split the observations that would separate alternatives; of more than three, select the specific ones."""
    parts = [part for part in (separated_by or "").split("; ") if part]
    named = [part for part in parts if not part.endswith("vary independently")]
    return named if named and len(parts) > 3 else parts


FILTERS = (
    confirmed, number, degrees, significant, with_sigma, percent, chance, current, count, plural, days, plain,
    effect_title, parameter, limits, listed, sentence, observations,
)  # fmt: skip


def standard_error(covariance: Any, k: int) -> float | None:
    """Compute the standard error of the k-th coefficient; None if its covariance is unknown."""
    return math.sqrt(covariance[k][k]) if covariance and covariance[k][k] is not None else None


def environment(**options: Any) -> jinja2.Environment:
    """Create the jinja2 environment of the templates."""
    import jinja2  # deferred until a template is rendered

    loader, undefined = jinja2.FileSystemLoader(TEMPLATES), jinja2.StrictUndefined
    return jinja2.Environment(loader=loader, undefined=undefined, trim_blocks=True, lstrip_blocks=True, **options)


@cache
def _environment() -> jinja2.Environment:
    made = environment(finalize=lambda value: re.sub(r"[\n|]+", " ", value) if isinstance(value, str) else value)
    made.filters |= {each.__name__: each for each in FILTERS}
    made.globals |= {"unknown": UNKNOWN, "models": MODELS, "position": angles.position, "sigma": standard_error}
    made.globals["wrap360"] = angles.wrap360
    return made


def _filled(template: str, block: str, given: dict[str, Any]) -> str:
    """Render a block of a template.

    Raises:
        LookupError: if the results lack a value that the block uses.
    """
    import jinja2

    try:
        return str(getattr(_environment().get_template(f"{template}.txt").module, block)(**given))
    except jinja2.UndefinedError as error:
        raise LookupError(str(error)) from error


def lines(template: str, block: str, **given: Any) -> list[str]:
    """Render a block of a template and split it into lines, without empty ones."""
    filled = _filled(template, block, given).split("\n")
    return [text for line in filled if (text := re.sub(r"[ ]+", " ", line).strip(" "))]


def paragraphs(template: str, block: str, **given: Any) -> tuple[str, ...]:
    """Render a block of a template and split it into paragraphs at blank lines."""
    filled = re.split(r"\n\s*\n", _filled(template, block, given))
    return tuple(text for part in filled if (text := re.sub(r"[ \n]+", " ", part).strip(" ")))


HELPERS = '{% from "mooring.txt" import methods %}'


def caption(text: str, **given: Any) -> str:
    """Render the caption of a figure from its template."""
    return re.sub(r"[ \n]+", " ", _environment().from_string(HELPERS + text).render(**given)).strip(" ")


def facts(template: str, block: str, **given: Any) -> tuple[tuple[str, str], ...]:
    """Render a block of a template and split each line into a name and its value at the first colon."""
    parts = (line.partition(": ") for line in lines(template, block, **given))
    return tuple((name, value) for name, _, value in parts)


def cells(template: str, block: str, **given: Any) -> list[tuple[str, ...]]:
    """Render a block of a template and split each line into the cells of a row at vertical bars."""
    return [tuple(cell.strip(" ") for cell in line.split("|")) for line in lines(template, block, **given)]


# Terms of docs/glossary.md, each with its first sentence: one text for report, ``compass explain`` and documentation.

CONCEALED = "concealed mooring"


@cache
def definitions() -> Mapping[str, str]:
    """Read the first sentence about each term, links removed; empty where the documentation is not installed."""
    path = provenance.RELEASE_FILES / "docs/glossary.md"
    text = path.read_text(encoding="utf-8") if path.is_file() else ""
    entries = re.sub(r"\[([^]]+)\]\([^)]+\)|`", r"\1", text).split("\n## ")[1:]
    parts = (entry.partition("\n") for entry in entries)
    return MappingProxyType({term: re.split(r"(?<=\.)\s", " ".join(what.split()))[0] for term, _, what in parts})


def occurring(texts: Iterable[str]) -> dict[str, str]:
    """Select the terms that occur in texts, with their definitions."""
    terms = {_names()[match[0].lower()] for text in texts for match in _pattern().finditer(text)}
    return {term: what for term, what in definitions().items() if term in terms}


@cache
def _names() -> Mapping[str, str]:
    """Return each term by its names, in the singular and with an s."""
    return {name.lower() + s: term for s in ("s", "") for term in definitions() for name in term.split(", ")}


@cache
def _pattern() -> re.Pattern[str]:
    """Match any term as a word of its own, the longest first; nothing without a glossary."""
    names = sorted(map(re.escape, _names()), key=len, reverse=True)
    return re.compile(rf"(?<![\w-])(?:{'|'.join(names)})(?![\w-])" if names else r"(?!)", re.IGNORECASE)


class Links:
    """Links of the terms of a page: the first occurrence in a section leads to the definition, which is its title."""

    def __init__(self) -> None:
        self.used: set[str] = set()
        self._linked: set[str] = set()

    def restart(self) -> str:
        """Begin a section, in which each term is linked again."""
        self._linked = set()
        return ""

    def definition(self, term: str) -> str:
        """Give the definition of a term, which needs no link where it stands, and list the term."""
        self.used.add(term)
        return definitions().get(term, "")

    def listed(self) -> list[tuple[str, str, str]]:
        """List the terms that were linked: term, anchor and definition."""
        return [(term, f"term-{anchor(term)}", what) for term, what in definitions().items() if term in self.used]

    def __call__(self, text: str) -> Markup:
        """Escape a text and link its terms."""
        from markupsafe import Markup, escape  # deferred with jinja2

        def link(match: re.Match[str]) -> str:
            term = _names()[match[0].lower()]
            if term in self._linked:
                return match[0]
            self._linked.add(term)
            return f'<a class="term" href="#term-{anchor(term)}" title="{escape(self.definition(term))}">{match[0]}</a>'

        return Markup(_pattern().sub(link, str(escape(text))))


def anchor(term: str) -> str:
    """Compose the anchor of a term on a page."""
    return re.sub(r"\W+", "-", term)
