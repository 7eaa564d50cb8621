"""One mooring's results -> its section of the report."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from compasslib.report import explanation, sections, words
from compasslib.report.sections import MooringResults, ReportSection

CURRENTS = ("sticks", "progressive", "roses")
OF_PAIRS = ("diagnosis", "deviation", "histograms", "scatter")  # empty where there is neither a pair nor a curve
FILES = (
    *("corrected.nc", "gridded.nc", "overlap.nc", "deviation.json", "diagnosis.json", "assessment.json"),
    *("table.csv", "histograms.csv", "figures", "logs"),
)


def mooring_section(results: MooringResults, root: Path, site: Mapping[str, Any], *, small: bool) -> ReportSection:
    """Compose one mooring's section.

    Args:
        site: latitude, longitude, water_depth_m, instruments (role and what it is).
        small: whether the page has too many sections for whole pictures.
    """

    def caption(figure: str) -> str:
        if figure == "diagnosis":
            return explanation.diagnosis_caption(results.diagnosis)
        return words.caption("mooring", figure, r=results)

    folders = [results.folder, *([results.folder.parent] if "/" in results.name else [])]  # the whole mooring's besides
    collected = [sections.collect_figures(folder, root, caption, small=small) for folder in folders]
    pictures = {name: figure for figures in collected for name, figure in figures.items()}
    if not (results.fit["n_pairs"] or results.product["coefficients"]):
        pictures = {name: entry for name, entry in pictures.items() if name not in OF_PAIRS}
    findings = explanation.report_findings(results.diagnosis, product=True)
    extra = ("diagnosis",) if findings else ()  # else it stands with the other figures
    counts = dict.fromkeys(name for of_role in results.inputs.values() for name in of_role)
    nonzero = [name for name in counts if any(of_role.get(name) for of_role in results.inputs.values())]
    zero = [words.plain(name) for name in counts if name not in nonzero]
    return ReportSection(
        name=results.name,
        anchor=f"mooring-{results.name}",
        verdict=results.diagnosis["verdict"],
        summary=summary_sentences(results),
        to_do=words.paragraphs("mooring", "actions", r=results)
        or ("Nothing: UCUR and VCUR of corrected.nc are the currents to use.",),
        facts=(
            *words.facts("mooring", "place", r=results, site=site),
            *measures(results),
            *words.facts("mooring", "more", r=results),
        ),
        first=tuple(pictures.pop(name) for name in CURRENTS if name in pictures),
        finding_figures=tuple(pictures.pop(name) for name in extra if name in pictures),
        findings=findings,
        limits=explanation.describe_limits(results.diagnosis),
        warnings=results.warnings,
        figures=tuple(pictures.values()),
        tables=(
            *sections.table("mooring", "agreement", r=results),
            *sections.table("mooring", "coefficients", r=results),
            *explanation.hypotheses_table(results.diagnosis),
            *sections.table("mooring", "inputs", inputs=results.inputs, names=nonzero, zero=zero),
        ),
        links=tuple(
            (file, sections.relative_link(there, root))
            for file in FILES
            for there in [folder / file for folder in folders if (folder / file).exists()][:1]
        ),
        cells=words.cells("mooring", "row", r=results)[0],
    )


def summary_sentences(results: MooringResults) -> tuple[str, ...]:
    """Summarize a mooring: the answer, agreement with the reference, and reasons why not more."""
    findings = explanation.describe_findings(results.diagnosis)
    return words.paragraphs("mooring", "summary", r=results, findings=findings)


def measures(results: MooringResults) -> tuple[tuple[str, str], ...]:
    """State method, samples corrected, uncertainty and largest deviation."""
    return words.facts("mooring", "measures", r=results)
