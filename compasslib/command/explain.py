"""``compass explain``: the diagnosis of one mooring in words, from its results."""

from __future__ import annotations

import textwrap
from argparse import Namespace
from collections.abc import Iterable
from pathlib import Path

from compasslib.archive import summary
from compasslib.command import folders
from compasslib.report import found, mooring
from compasslib.report.mooring import Results
from compasslib.report.section import Finding

WIDTH, INDENT = 100, "  "


def run(asked: Namespace) -> int:
    """Print what is known of a mooring's compass.

    Args:
        asked: ``cruise`` and ``mooring``, a name in it or a folder of results.

    Raises:
        InputError: there are no results, or not all of them.
    """
    folder = folders.of_mooring(asked.cruise, asked.mooring).resolve()
    folders.refuse_half(folder)
    with folders.of_this_version(folder):
        lines = told(_read(folder))
    print("\n".join(lines))
    return 0


def _read(folder: Path) -> Results:
    for file in (name for name in folders.NEEDED if name in folders.KEYS):
        folders.content(folder / file)
    row = summary.row(folder.name, folder)
    return mooring.read(row["name"], folder.parent, {name: str(value) for name, value in row.items()})


def told(results: Results) -> list[str]:
    """Return the lines."""
    head = results.headings
    facts = [("Method", mooring.made_with(results.fit)), *mooring.counted(head), *mooring.sure(head)]
    warnings = [said for said in results.row["warnings"].split(" | ") if said]
    lines = [f"{results.name}: {results.diagnosis['verdict']}", *_wrapped(mooring.sentences(results))]
    lines += ["", *_wrapped(f"{name}: {value}" for name, value in facts)]
    for finding in found.findings(results.diagnosis, product=True):
        lines += ["", *_finding(finding)]
    for title, sentences in (("What it cannot tell", found.cannot_tell(results.diagnosis)), ("Warnings", warnings)):
        lines += ["", title, *_wrapped(sentences)] if sentences else []
    return lines


def _finding(finding: Finding) -> list[str]:
    facts = [f"{name}: {value}" for name, value in finding.facts]
    numbers = [": ".join(row) for row in finding.parameters.rows] if finding.parameters else []
    return [f"Found: {finding.title}", *_wrapped([finding.text, *facts, *numbers])]


def _wrapped(sentences: Iterable[str]) -> list[str]:
    """Return sentences each with its own indented lines."""
    wrapper = textwrap.TextWrapper(WIDTH, initial_indent=INDENT, subsequent_indent=2 * INDENT)
    return [line for sentence in sentences for line in wrapper.wrap(sentence)]
