"""Which entries of the changelog may be the reason for what changed between results of two versions."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from compasslib.archive.provenance import RELEASE_FILES
from compasslib.report import words

CHANGELOG = RELEASE_FILES / "CHANGELOG.md"
KINDS_OF_CHANGE = (
    "headings",
    "flags",
    "uncertainty",
    "coefficients",
    "verdict",
    "calibration",
)  # what an entry can change
WIDTH = 100

_SECTION = re.compile(r"^## (\S+).*$", re.MULTILINE)
_ENTRY = re.compile(r"^\* (.*(?:\n  .*)*)", re.MULTILINE)
_TAGS = re.compile(r"\s*\*\(([^()]*)\)\*$")
_SOFTWARE = re.compile(r"compasslib (\d+(?:\.\d+)+) \((.*)\)")


@dataclass(frozen=True)
class ChangelogEntry:
    """One entry of the changelog."""

    version: str
    text: str
    changes: frozenset[str]  # of KINDS, or calibration:KIND; none where it changes no result


def parse_changelog(text: str) -> list[ChangelogEntry]:
    """Parse the entries of a changelog, newest first.

    Args:
        text: in Markdown: a section a version, an entry a point, at its end what it can change.
    """
    _, *parts = _SECTION.split(text)
    parsed = []
    for version, section in zip(parts[::2], parts[1::2], strict=True):
        for point in _ENTRY.findall(section):
            joined = " ".join(point.split())
            tags = _TAGS.search(joined)
            changes = frozenset(tag.strip() for tag in tags[1].split(",")) if tags else frozenset()
            parsed.append(ChangelogEntry(version, _TAGS.sub("", joined), changes))
    return parsed


def changelog_reasons(old: str, new: str, changed: Iterable[str], changelog: Path | None = None) -> list[str]:
    """Name the software behind two results, and the entries of the changelog that may explain the change.

    Args:
        old: the software of the earlier results, as the products name it; empty where they do not.
        new: that of the later ones.
        changed: what did, of ``KINDS`` or calibration:KIND.
        changelog: the file that is looked into.
    """
    if old == new:
        return []
    sides = [f"OLD by {old or 'software that is not named'}", f"NEW by {new or 'software that is not named'}"]
    why = _matching_entries(old, new, frozenset(changed), changelog or CHANGELOG)
    wrapper = textwrap.TextWrapper(WIDTH, initial_indent="  ", subsequent_indent="    ")
    return [*sides, why[0], *(line for entry in why[1:] for line in wrapper.wrap(entry))]


def _matching_entries(old: str, new: str, changed: frozenset[str], changelog: Path) -> list[str]:
    known = [match for side in (old, new) if (match := _SOFTWARE.fullmatch(side))]
    if len(known) < 2:
        return ["the versions are not known, so that no entry of the changelog can be named"]
    if not changelog.is_file():
        return ["this installation has no changelog; the checkout of the newer version has it"]
    low, high = sorted(_number(match[1]) for match in known)
    matching = []
    for entry in parse_changelog(changelog.read_text(encoding="utf-8")):
        at = _number(entry.version)  # between commits of one version any entry of it may be the reason
        between = low < at <= high or low == at == high
        if between and any(x in entry.changes or x.partition(":")[0] in entry.changes for x in changed):
            matching.append(entry)
    what = words.listed(sorted(changed))
    if not matching:
        return [f"no entry of the changelog between them can change {what}: look at the YAML and raw files"]
    first = f"{what} changed; where YAML and raw files are the same, by one of these entries, or by several:"
    return [first, *(f"{entry.version}: {entry.text}" for entry in matching)]


def _number(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in version.split("."))
