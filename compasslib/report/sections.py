"""Diagnoses in words (conclusion, findings, limits), and sections of moorings, compasses and calibrations.

Texts are plain and are escaped when the page is rendered.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from compasslib.archive.files import read_json
from compasslib.effects import COMPOSED, meanings
from compasslib.effects.composed import effect_formula
from compasslib.inference import wording
from compasslib.plots.figures import MOORING
from compasslib.report import words
from compasslib.report.results import (
    CalibrationResults,
    MooringResults,
    ReportedFinding,
    ReportFigure,
    ReportSection,
    ReportTable,
    collect_figures,
    draw_differences,
    links,
    table,
)

LARGE = "large_deviation"  # not a limit: it is not tested because the exact compass, which includes it, was fitted
CLAUSES = {
    **wording.PHYSICS,
    "hard_iron": "iron near by adds a constant field",
    "mounting_offset": "the mount turns all headings by a constant",
    "field_disturbance": "magnetic north moved with storms or the daily variation",  # shown by a series, or an index
}


def report_findings(diagnosis: Mapping[str, Any], *, product: bool, most: int = 5) -> tuple[ReportedFinding, ...]:
    """Describe the findings, strongest first, and then what remains unexplained.

    Args:
        diagnosis: content of diagnosis.json.
        product: whether there is a corrected record to which a finding may be applied.
        most: number of other candidates that are named if there are many.
    """
    findings = []
    for entry in diagnosis["findings"]:
        parts = entry.get("composition")
        title = words.effect_title(entry)
        others = candidate_names(entry)[1:]
        if rest := others[most + 1 :]:
            others = [*others[:most], f"{len(rest) + 1} others, listed in diagnosis.json"]
        given = {"alternatives": others, "formula": effect_formula(**parts) if parts else ""}
        facts = words.facts("diagnosis", "facts", e=entry, product=product, **given)
        fitted = table("diagnosis", "parameters", e=entry, known=meanings(entry["effect"]))
        text = re.sub(r"(?<=[ (])-(?=\d)", words.MINUS, entry["text"])
        findings.append(ReportedFinding(title[0].upper() + title[1:], text, facts, next(iter(fitted), None)))
    findings += [ReportedFinding("Current", entry["text"], ()) for entry in diagnosis.get("current") or ()]
    if left := diagnosis["unexplained"]:
        facts = words.facts("diagnosis", "facts", e=left, product=product, alternatives=(), formula="")
        findings.append(ReportedFinding("Unexplained", left["text"], facts))
    return tuple(findings)


def candidate_names(finding: Mapping[str, Any]) -> list[str]:
    """Describe the candidates of a finding, best first: the physics, with name and probability in parentheses."""
    chances = {finding["effect"]: finding.get("probability"), **(finding.get("alternatives_probability") or {})}
    if composed := finding.get("composition"):
        chances = {f"{COMPOSED}{'/'.join(composed.values())}": chances.pop(finding["effect"]), **chances}
    texts = []
    for name in dict.fromkeys([*chances, *finding["alternatives"]]):
        chance = chances.get(name)
        sure = [] if chance is None else [f"probability {words.chance(chance)}"]
        if name.startswith(COMPOSED):
            texts.append(" ".join([words.plain(name), *(f"({each})" for each in sure)]))
        else:
            clause = re.split(r" \(|[;:]", CLAUSES.get(name, words.plain(name)))[0]
            texts.append(f"{clause} ({', '.join([words.plain(name), *sure])})")
    return texts


def describe_findings(diagnosis: Mapping[str, Any], *, most: int = 3) -> str:
    """Summarize the findings beyond the fitted deviation in a clause, with up to ``most`` candidates of each."""
    clauses = []
    for entry in diagnosis["findings"]:
        names = candidate_names(entry)
        more = len(names) - most
        clause = " or ".join([*names[:most], *([f"one of {more} others"] if more > 1 else names[most:])])
        clauses.append(clause + ("" if words.confirmed(entry) else ", not confirmed on held-out days"))
    return words.paragraphs("diagnosis", "findings", d=diagnosis, clauses=clauses)[0]


def describe_limits(diagnosis: Mapping[str, Any]) -> tuple[str, ...]:
    """List what the recording cannot show, and which observations would show it."""
    reasons: dict[str, dict[str, None]] = {}
    for entry in diagnosis["not_testable"]:
        if entry["effect"] != LARGE:
            reasons.setdefault(entry["effect"], {})[entry["why"].rstrip(".")] = None
    tested = {entry["effect"] for entry in diagnosis.get("hypotheses") or []}  # tested in another form
    closed: dict[tuple[bool, str], list[str]] = {}
    for effect, whys in reasons.items():
        closed.setdefault((effect in tested, ", ".join(whys)), []).append(words.plain(effect))
    untested = [(partly, effects, why) for (partly, why), effects in closed.items()]
    return words.paragraphs("diagnosis", "limits", d=diagnosis, untested=untested)


def limits_table(diagnosis: Mapping[str, Any]) -> tuple[ReportTable, ...]:
    """Tabulate the detection limits, smallest first; without limits there is no table."""
    return table("diagnosis", "detectable", d=diagnosis)


def diagnosis_caption(diagnosis: Mapping[str, Any]) -> str:
    """Compose the caption of the figure of a diagnosis."""
    from compasslib.plots.diagnosis import count_outside  # only here: it takes the plotting library along

    outside = count_outside(diagnosis) if wording.displayed_residuals(diagnosis) else ()
    parts = [entry["composition"] for entry in diagnosis["findings"] if entry.get("composition")]
    composed = [(entry["acts_on"], effect_formula(**entry)) for entry in parts]
    return " ".join(words.paragraphs("diagnosis", "figure", d=diagnosis, outside=outside, composed=composed))


# Sections of moorings, calibrations and compasses, with links to their figures.

FILES = ("corrected.nc", "gridded.nc", "deviation.json", "diagnosis.json", "table.csv", "figures", "logs")
CALIBRATION_FILES = ("calibration.json", "table.csv", "points.csv", "diagnosis.json", "figures", "logs")
COMPASS_FILES = ("compass.json", "diagnosis.json", "figures", "logs")
TABLES = ("coefficients", "forms", "tilts", "iron", "cardinal", "storms", "budget")


def mooring_section(results: MooringResults, root: Path) -> ReportSection:
    """Compose one mooring's section."""
    folders = [results.folder, *([results.folder.parent] if "/" in results.name else [])]  # also of the whole mooring
    pictures = dict[str, ReportFigure]()
    for folder in folders:
        pictures |= collect_figures(folder, root, ("mooring", "sections"), r=results, about=diagnosis_caption)
    if not (results.fit["n_pairs"] or results.fit["coefficients"]):
        of_pairs = {row.name for row in MOORING if row.of_pairs}
        pictures = {name: figure for name, figure in pictures.items() if name not in of_pairs}
    return ReportSection(
        name=results.name,
        anchor=f"mooring-{results.name}",
        verdict=results.diagnosis["verdict"],
        summary=summary_sentences(results),
        use=results.assessment["use"]["answer"],
        picture=draw_differences(results.assessment),
        to_do=words.paragraphs("mooring", "actions", r=results),
        findings=report_findings(results.diagnosis, product=True),
        warnings=results.warnings,
        figures=tuple(pictures.values()),
        links=links(folders, root, FILES),
        cells=words.cells("mooring", "row", r=results)[0],
    )


def summary_sentences(results: MooringResults) -> tuple[str, ...]:
    """Summarize a mooring: conclusion, agreement with the reference, and reasons for what was not achieved."""
    findings = describe_findings(results.diagnosis)
    return words.paragraphs("mooring", "summary", r=results, findings=findings)


def measures(results: MooringResults) -> tuple[tuple[str, str], ...]:
    """List method, number of corrected samples, uncertainty, possible readings and agreement with the reference."""
    return words.facts("mooring", "measures", r=results)


def calibration_section(results: CalibrationResults, root: Path) -> ReportSection:
    """Compose one calibration's section."""
    content, diagnosis = results.content, results.diagnosis
    said, texts = describe_findings(diagnosis) if diagnosis else "", list(_nested_texts(content))
    tables = [each for name in TABLES for each in table("calibration", name, c=content)]
    limits = words.paragraphs("calibration", "limits", c=content)
    if diagnosis:
        tables += [*limits_table(diagnosis), *table("diagnosis", "hypotheses", d=diagnosis)]
        limits += describe_limits(diagnosis)
    figures = collect_figures(results.folder, root, ["calibration"], c=content, d=diagnosis, about=diagnosis_caption)
    return ReportSection(
        name=results.name,
        anchor=f"calibration-{results.name}",
        verdict=diagnosis.get("verdict", ""),
        summary=words.paragraphs("calibration", "summary", c=content, diagnosis=diagnosis, findings=said, texts=texts),
        facts=words.facts("calibration", "facts", c=content),
        findings=report_findings(diagnosis, product=False) if diagnosis else (),
        limits=limits,
        warnings=tuple(content["warnings"]),
        figures=tuple(figures.values()),
        tables=(*tables, *table("calibration", "deviations", table=results.table)),
        links=links([results.folder], root, CALIBRATION_FILES),
        cells=words.cells("calibration", "row", name=results.name, c=content, diagnosis=diagnosis)[0],
    )


def _nested_texts(content: Mapping[str, Any]) -> Iterator[str]:
    """Yield the sentences (values of the key ``text``) of a calibration at any level of nesting."""
    for key, value in content.items():
        if key == "text" and isinstance(value, str) and value:
            yield value
        elif isinstance(value, Mapping):
            yield from _nested_texts(value)


def compass_section(name: str, root: Path) -> ReportSection:
    """Compose the section of a compass that several records share.

    Raises:
        InputError: if a result file is missing or damaged.
    """
    folder = root / "compasses" / name
    content, diagnosis = read_json(folder / "compass.json"), read_json(folder / "diagnosis.json")
    said = describe_findings(diagnosis)
    return ReportSection(
        name=name,
        anchor=f"compass-{name}",
        verdict=diagnosis["verdict"],
        summary=words.paragraphs("compass", "summary", c=content, d=diagnosis, findings=said),
        facts=words.facts("compass", "facts", c=content),
        findings=report_findings(diagnosis, product=False),
        limits=describe_limits(diagnosis),
        warnings=words.paragraphs("compass", "warnings", c=content),
        tables=(*table("compass", "records", c=content), *table("compass", "iron", c=content)),
        figures=tuple(collect_figures(folder, root, ["compass"], c=content).values()),
        links=links([folder], root, COMPASS_FILES),
        cells=words.cells("compass", "row", name=name, c=content, d=diagnosis)[0],
    )
