"""What the report says, before it is HTML: the same parts for a mooring and for a calibration.

Texts are plain; whatever stands in them is escaped when the page is made.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Cell:
    """One cell of the overview: what is read, and what it is sorted by."""

    text: str
    key: float | str | None = None  # None sorts last, whichever way


@dataclass(frozen=True)
class ReportTable:
    """A small table; the first column names its rows."""

    caption: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    folded: str = ""  # the line that opens it; open from the start where there is none


@dataclass(frozen=True)
class Figure:
    """A figure of the results."""

    title: str
    alternative: str  # what it shows, in words and numbers
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
    """One mooring or one calibration."""

    name: str
    anchor: str
    verdict: str  # a word of search.wording.VERDICTS, or empty
    summary: tuple[str, ...]  # sentences: the verdict and what else comes first
    facts: tuple[tuple[str, str], ...]
    findings: tuple[ReportedFinding, ...] = ()
    cannot_tell: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    tables: tuple[ReportTable, ...] = ()
    figures: tuple[Figure, ...] = ()
    links: tuple[tuple[str, str], ...] = ()  # text, address relative to the page
    cells: tuple[Cell, ...] = ()  # its row in the overview


def stopped(part: str, name: str, why: str, header: Sequence[str]) -> ReportSection:
    """Return the section of a mooring or calibration that has no results."""
    known = {"Verdict": Cell("stopped", "stopped"), "Warnings": Cell("1", 1)}
    why_stopped = f"It was stopped, as a file of it cannot be used, and has no results: {why}."
    return ReportSection(
        name=name,
        anchor=f"{part}-{name}",
        verdict="stopped",
        summary=(why_stopped,),
        facts=(("Results", "none"),),
        warnings=(why,),
        links=(("logs", f"{'calibrations/' * (part == 'calibration')}{name}/logs"),),
        cells=(Cell(name, name), *(known.get(column, Cell("", None)) for column in header[1:])),
    )


@dataclass(frozen=True)
class Overview:
    """The sortable table of all moorings or of all calibrations."""

    caption: str
    header: tuple[str, ...]
    sections: Sequence[ReportSection]
