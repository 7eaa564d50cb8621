"""Terms of docs/glossary.md, each with its first sentence, in the report, ``compass explain`` and the documentation."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from functools import cache
from types import MappingProxyType

from markupsafe import Markup, escape

from compasslib.archive import provenance

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
    found = {_term(match[0]) for text in texts for match in _pattern().finditer(text)}
    return {term: what for term, what in definitions().items() if term in found}


@cache
def _names() -> Mapping[str, str]:
    return {name.lower(): term for term in definitions() for name in term.split(", ")}


def _term(word: str) -> str:
    names = _names()
    return names.get(word.lower()) or names[word.lower().removesuffix("s")]


@cache
def _pattern() -> re.Pattern[str]:
    """Match any term as a word of its own, the longest first; nothing without a glossary."""
    names = sorted(map(re.escape, _names()), key=len, reverse=True)
    return re.compile(rf"(?<![\w-])(?:{'|'.join(names)})s?(?![\w-])" if names else r"(?!)", re.IGNORECASE)


class Links:
    """Links of the terms of a page: the first occurrence in a section leads to the definition, which is its title."""

    def __init__(self) -> None:
        self.used: set[str] = set()
        self._seen: set[str] = set()

    def restart(self) -> str:
        """Begin a section, in which each term is linked again."""
        self._seen = set()
        return ""

    def definition(self, term: str) -> str:
        """Give the definition of a term, which needs no link where it stands."""
        return definitions().get(term, "")

    def listed(self) -> list[tuple[str, str, str]]:
        """List the terms that were linked: term, anchor and definition."""
        return [(term, f"term-{anchor(term)}", what) for term, what in definitions().items() if term in self.used]

    def __call__(self, text: str) -> Markup:
        """Escape a text and link its terms."""
        parts, at = [], 0
        for match in _pattern().finditer(text):
            term = _term(match[0])
            if term not in self._seen:
                link = Markup('<a class="term" href="#term-{}" title="{}">{}</a>')
                parts += [escape(text[at : match.start()]), link.format(anchor(term), definitions()[term], match[0])]
                at = match.end()
                self._seen.add(term)
        self.used |= self._seen
        return Markup("").join([*parts, escape(text[at:])])


def anchor(term: str) -> str:
    """Compose the anchor of a term on a page."""
    return re.sub(r"\W+", "-", term)
