"""``compass explain``: the diagnosis of one mooring in words, from its results."""

from __future__ import annotations

import textwrap
from argparse import Namespace
from collections.abc import Iterable
from pathlib import Path

from compasslib.archive import summary
from compasslib.cli import folders
from compasslib.report import found, mooring, results
from compasslib.report.captions import of_diagnosis
from compasslib.report.results import MooringResults
from compasslib.report.section import ReportedFinding

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
        lines = lines_of(_read(folder))
    print("\n".join(lines))
    return 0


def _read(folder: Path) -> MooringResults:
    for file in (name for name in folders.NEEDED if name in folders.KEYS):
        folders.content(folder / file)
    row = summary.row(folder.name, folder)
    return results.of_mooring(row["name"], folder.parent, {name: str(value) for name, value in row.items()})


def lines_of(read: MooringResults) -> list[str]:
    """Return the lines."""
    head = read.headings
    facts = [("Method", mooring.made_with(read.fit)), *mooring.counted(head), *mooring.sure(head)]
    warnings = [warning for warning in read.row["warnings"].split(" | ") if warning]
    lines = [f"{read.name}: {read.diagnosis['verdict']}", *_wrapped(mooring.sentences(read))]
    lines += ["", *_wrapped(f"{name}: {value}" for name, value in facts)]
    for finding in found.findings(read.diagnosis, product=True):
        lines += ["", *_finding(finding)]
    if (figure := read.folder / "figures/diagnosis.png").exists():
        lines += ["", f"Drawn in {figure}", *_wrapped([of_diagnosis(read.diagnosis)])]
    for title, sentences in (("Limits of this record", found.cannot_tell(read.diagnosis)), ("Warnings", warnings)):
        lines += ["", title, *_wrapped(sentences)] if sentences else []
    return lines


def _finding(finding: ReportedFinding) -> list[str]:
    facts = [f"{name}: {value}" for name, value in finding.facts]
    numbers = [": ".join(row) for row in finding.parameters.rows] if finding.parameters else []
    return [f"Found: {finding.title}", *_wrapped([finding.text, *facts, *numbers])]


def _wrapped(sentences: Iterable[str]) -> list[str]:
    """Return sentences each with its own indented lines."""
    wrapper = textwrap.TextWrapper(WIDTH, initial_indent=INDENT, subsequent_indent=2 * INDENT)
    return [line for sentence in sentences for line in wrapper.wrap(sentence)]
