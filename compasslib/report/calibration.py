"""One calibration's results -> its section of the report; the section of a compass that several records share."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from compasslib.archive.files import read_json
from compasslib.report import explanation, sections, words
from compasslib.report.sections import CalibrationResults, ReportSection

FILES = ("calibration.json", "table.csv", "points.csv", "diagnosis.json", "figures", "logs")
TABLES = ("coefficients", "forms", "tilts", "iron", "cardinal", "storms", "budget")
COMPASS_FILES = ("compass.json", "diagnosis.json", "figures", "logs")


def calibration_section(results: CalibrationResults, root: Path, *, small: bool) -> ReportSection:
    """Compose one calibration's section.

    Args:
        small: whether the page has too many sections for whole pictures.
    """
    content, diagnosis = results.content, results.diagnosis

    def caption(figure: str) -> str:
        if figure == "diagnosis" and diagnosis:
            return explanation.diagnosis_caption(diagnosis)
        return words.caption("calibration", figure, c=content)

    figures = sections.collect_figures(results.folder, root, caption, small=small)
    findings = explanation.report_findings(diagnosis, product=False) if diagnosis else ()
    answer = {
        "diagnosis": diagnosis,
        "findings": explanation.describe_findings(diagnosis) if diagnosis else "",
        "texts": list(_nested_texts(content)),
    }
    return ReportSection(
        name=results.name,
        anchor=f"calibration-{results.name}",
        verdict=diagnosis["verdict"] if diagnosis else "",
        summary=words.paragraphs("calibration", "summary", c=content, **answer),
        facts=words.facts("calibration", "facts", c=content),
        finding_figures=(figures.pop("diagnosis"),) if findings and "diagnosis" in figures else (),
        findings=findings,
        limits=(
            *words.paragraphs("calibration", "limits", c=content),
            *(explanation.describe_limits(diagnosis) if diagnosis else ()),
        ),
        warnings=tuple(content["warnings"]),
        first=tuple(figures.values()),
        tables=(
            *(table for name in TABLES for table in sections.table("calibration", name, c=content)),
            *(explanation.hypotheses_table(diagnosis) if diagnosis else ()),
            *sections.table("calibration", "deviations", table=results.table),
        ),
        links=sections.links(results.folder, root, FILES),
        cells=words.cells("calibration", "row", name=results.name, c=content, diagnosis=diagnosis)[0],
    )


def _nested_texts(content: Mapping[str, Any]) -> Iterator[str]:
    """Give the sentences that a kind says about itself, wherever they stand in the file."""
    for key, value in content.items():
        if key == "text" and isinstance(value, str) and value:
            yield value
        elif isinstance(value, Mapping):
            yield from _nested_texts(value)


def compass_section(name: str, root: Path, *, small: bool) -> ReportSection:
    """Compose the section of a compass that several records share.

    Args:
        small: whether the page has too many sections for whole pictures.

    Raises:
        InputError: a file of its results is absent or damaged.
    """
    folder = root / "compasses" / name
    content, diagnosis = read_json(folder / "compass.json"), read_json(folder / "diagnosis.json")
    figures = sections.collect_figures(
        folder, root, lambda figure: words.caption("compass", figure, c=content), small=small
    )
    findings = explanation.describe_findings(diagnosis)
    return ReportSection(
        name=name,
        anchor=f"compass-{name}",
        verdict=diagnosis["verdict"],
        summary=words.paragraphs("compass", "summary", c=content, d=diagnosis, findings=findings),
        facts=words.facts("compass", "facts", c=content),
        findings=explanation.report_findings(diagnosis, product=False),
        limits=explanation.describe_limits(diagnosis),
        warnings=words.paragraphs("compass", "warnings", c=content),
        tables=(*sections.table("compass", "records", c=content), *sections.table("compass", "iron", c=content)),
        first=tuple(figures.values()),
        links=sections.links(folder, root, COMPASS_FILES),
        cells=words.cells("compass", "row", name=name, c=content, d=diagnosis)[0],
    )
