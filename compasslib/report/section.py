"""What the report says, before it is HTML: the same parts for a mooring, a compass and a calibration.

Texts are plain; whatever stands in them is escaped when the page is made.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class ReportTable:
    """A small table; the first column names its rows."""

    caption: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Figure:
    """A figure of the results."""

    title: str
    caption: str  # what it shows, in words and numbers
    href: str  # the file, relative to the page
    data: str = ""  # the picture itself as a data URI; empty where it is only linked
    width: int = 0  # pixels of the data
    height: int = 0


@dataclass(frozen=True)
class ReportedFinding:
    """One effect that was found, or what stays unexplained."""

    title: str
    text: str
    facts: tuple[tuple[str, str], ...]
    parameters: ReportTable | None = None


@dataclass(frozen=True)
class ReportSection:
    """One mooring, compass or calibration."""

    name: str
    anchor: str
    verdict: str  # a word of search.wording.VERDICTS, or empty
    summary: tuple[str, ...]  # sentences; the first is the answer, and stands on the top of the page too
    facts: tuple[tuple[str, str], ...]
    to_do: tuple[str, ...] = ()  # sentences: what is left to the reader
    first: tuple[Figure, ...] = ()  # what is looked for first: currents before and after
    found: tuple[Figure, ...] = ()  # beside the findings
    findings: tuple[ReportedFinding, ...] = ()
    cannot_tell: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    figures: tuple[Figure, ...] = ()  # all others
    tables: tuple[ReportTable, ...] = ()
    links: tuple[tuple[str, str], ...] = ()  # text, address relative to the page
    cells: tuple[str, ...] = ()  # its row in the overview


def stopped(part: str, name: str, why: str, header: Sequence[str]) -> ReportSection:
    """Return the section of a mooring or calibration that has no results."""
    known = {"Verdict": "stopped", "Warnings": "1"}
    return ReportSection(
        name=name,
        anchor=f"{part}-{name}",
        verdict="stopped",
        summary=(f"There are no results, as a file cannot be used: {why.rstrip('.')}.",),
        facts=(),
        to_do=("Mend or replace that file and run again; what is done already is not done twice.",),
        links=(("logs", f"{'calibrations/' * (part == 'calibration')}{name}/logs"),),
        cells=(name, *(known.get(column, "") for column in header[1:])),
    )


@dataclass(frozen=True)
class Overview:
    """All moorings, compasses or calibrations, and the table that holds them against each other."""

    caption: str
    header: tuple[str, ...]
    sections: Sequence[ReportSection]

    @property
    def table(self) -> ReportTable:
        """Return one row each."""
        return ReportTable(self.caption, self.header, tuple(one.cells for one in self.sections))
