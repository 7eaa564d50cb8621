"""Sections of the report, of moorings, compasses and calibrations: results read from files and described in words.

Texts are plain and are escaped when the page is rendered.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote

import numpy as np

from compasslib import angles
from compasslib.archive import attributes as archive_attributes
from compasslib.archive import files, netcdf, summary
from compasslib.archive.files import open_netcdf, read_json, read_variable
from compasslib.effects import COMPOSED, meanings
from compasslib.effects.composed import effect_formula
from compasslib.inference import wording
from compasslib.plots.figures import FIGURES, MOORING
from compasslib.product.cells import compare_at_seam, describe_seam
from compasslib.records import PROBABLY_BAD
from compasslib.report import words
from compasslib.types import Floats


@dataclass(frozen=True)
class ReportTable:
    """A small table; the first column names its rows."""

    caption: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class ReportFigure:
    """A figure of the results."""

    title: str
    caption: str
    href: str  # URL of the file, relative to the page
    data: str = ""  # the picture as a data URI
    width: int = 0  # pixels
    height: int = 0


@dataclass(frozen=True)
class ReportedFinding:
    """One identified effect, or what remains unexplained."""

    title: str
    text: str
    facts: tuple[tuple[str, str], ...]
    parameters: ReportTable | None = None


@dataclass(frozen=True)
class ReportSection:
    """One mooring, compass or calibration."""

    name: str
    anchor: str
    verdict: str  # one of ``inference.wording.VERDICTS``, ``stopped``, or empty
    summary: tuple[str, ...]  # paragraphs; the first is the conclusion, which the top of the page repeats
    facts: tuple[tuple[str, str], ...] = ()
    use: str = ""  # whether a mooring can be used: yes, with care, no
    picture: tuple[tuple[str, str], ...] = ()  # lines of the small picture of a mooring: colour, and points of an SVG
    to_do: tuple[str, ...] = ()  # sentences: actions left to the user
    findings: tuple[ReportedFinding, ...] = ()
    limits: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    figures: tuple[ReportFigure, ...] = ()
    tables: tuple[ReportTable, ...] = ()
    links: tuple[tuple[str, str], ...] = ()  # text, URL relative to the page
    cells: tuple[str, ...] = ()  # its row in the overview


QUESTION = "Can it be used?"


def table(template: str, block: str, **given: Any) -> tuple[ReportTable, ...]:
    """Render a table of a template as caption, header and rows; the result is empty if it has no rows."""
    filled = words.cells(template, block, **given)
    return (ReportTable(" ".join(filled[0]), filled[1], tuple(filled[2:])),) if filled[2:] else ()


def stopped_section(part: str, name: str, why: str, header: Sequence[str]) -> ReportSection:
    """Compose the section of a mooring or calibration that has no results."""
    known = {"Verdict": "stopped", QUESTION: "no", "Warnings": "1"}
    answer, to_do = words.paragraphs("mooring", "stopped", why=why)
    logs = f"{'calibrations/' * (part == 'calibration')}{name}/logs"
    return ReportSection(
        name, f"{part}-{name}", "stopped", (answer,), use="no" * (part == "mooring"), to_do=(to_do,),
        links=(("logs", logs),), cells=(name, *(known.get(column, "") for column in header[1:])),
    )  # fmt: skip


@dataclass(frozen=True)
class Overview:
    """All sections of moorings, compasses or calibrations, and the caption and header of the table of their cells."""

    caption: str
    header: tuple[str, ...] = ()
    sections: Sequence[ReportSection] = ()


@dataclass(frozen=True)
class MooringResults:
    """Results of one mooring that the report uses."""

    name: str
    folder: Path
    row: Mapping[str, str]  # of summary.csv
    fit: Mapping[str, Any]  # deviation.json
    diagnosis: Mapping[str, Any]
    assessment: Mapping[str, Any]
    headings: Mapping[str, Any]  # statistics of the corrected record
    currents: summary.BinCurrents  # of the bin shown in figures
    seam: str  # affected minus reference velocities, in a sentence

    @property
    def other_compass(self) -> bool:
        """Whether the product uses a compass other than that of the configured fit."""
        applied = self.fit["applied"]
        changed = self.fit["method"] != self.fit["fitted"]["method"]
        return bool(applied["effects"] or applied["accounted_for"] or changed)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings of all stages."""
        return tuple(warning for warning in self.row["warnings"].split(" | ") if warning)


def read_summary(table: str | Path) -> dict[str, dict[str, str]]:
    """Read the rows of summary.csv by mooring."""
    with Path(table).open(newline="", encoding="utf-8") as stream:
        return {row["name"]: row for row in csv.DictReader(stream)}


def read_mooring(name: str, root: Path, row: Mapping[str, str]) -> MooringResults:
    """Read the files of one mooring."""
    folder = root / name
    names = ("deviation", "diagnosis", "assessment")
    fit, diagnosis, assessment = (read_json(folder / f"{each}.json") for each in names)
    shown = summary.read_bin_currents(folder / "corrected.nc")
    seam = describe_seam(compare_at_seam(netcdf.read_pairs(folder / "overlap.nc"), assessment))
    headings = _summarize_headings(folder / "corrected.nc")
    return MooringResults(name, folder, row, fit, diagnosis, assessment, headings, shown, seam)


@dataclass(frozen=True)
class CalibrationResults:
    """Results of one calibration that the report uses."""

    name: str
    folder: Path
    content: Mapping[str, Any]  # calibration.json
    table: tuple[tuple[str, ...], ...]  # rows of table.csv
    diagnosis: Mapping[str, Any]  # empty without one


def read_calibration(name: str, root: Path) -> CalibrationResults:
    """Read the files of one calibration."""
    folder = root / "calibrations" / name
    with (folder / "table.csv").open(newline="", encoding="utf-8") as stream:
        rows = tuple(tuple(row) for row in csv.reader(stream))[1:]
    diagnosis = read_json(path) if (path := folder / "diagnosis.json").exists() else {}
    return CalibrationResults(name, folder, read_json(folder / "calibration.json"), rows, diagnosis)


def _summarize_headings(path: Path) -> dict[str, Any]:
    """Summarize the headings of a corrected.nc; its profiles are not read."""
    with open_netcdf(path) as nc:
        corrected, flags, sigma = (read_variable(nc, f"HEADING_CORRECTED{end}") for end in ("", "_QC", "_UNCERTAINTY"))
        days, recorded, common, deviation, declination = (
            read_variable(nc, name)
            for name in ("TIME", "HEADING", "HEADING_COMMON_UNCERTAINTY", "DEVIATION", "DECLINATION")
        )
        attributes = {name: nc.getncattr(name) for name in ("instrument", "serial_number") if name in nc.ncattrs()}
        missing = archive_attributes.missing(nc.ncattrs())
    there = np.isfinite(corrected)
    steps = np.diff(days) if len(days) > 1 else np.ones(1)
    return {
        "n": len(recorded),
        # Missing samples between the first and the last, by the median interval.
        "absent": int(np.sum(np.maximum(np.round(steps / np.median(steps)) - 1.0, 0.0))),
        "corrected": int(there.sum()),
        "doubtful": int(np.sum(there & (flags == PROBABLY_BAD))),
        "sigma_deg": _percentiles(sigma[there], (50.0, 95.0)),
        "removed_deg": error_removed(deviation[there], common[there]),
        "largest_deviation_deg": float(np.max(np.abs(deviation[there]))) if there.any() else float("nan"),
        "declination_deg": _percentiles(declination[np.isfinite(declination)], (0.0, 100.0)),
        "attributes": attributes,
        "missing": missing,  # global attributes required by the conventions
    }


def error_removed(deviation_deg: Floats, common_deg: Floats) -> tuple[float, float]:
    """Compute the rms of the deviations and its standard uncertainty, degrees, if their common errors agree in sign.

    The error of √(Σδ²/n) is Σδε/√(nΣδ²) for errors ε of the deviations δ, at most Σ|δ|σ/√(nΣδ²) where all of them have
    one source; errors that are independent from sample to sample cancel.
    """
    known = np.isfinite(deviation_deg + common_deg)
    rms = angles.rms(deviation_deg[known])
    if not known.any() or rms == 0.0:
        return rms, float("nan")
    return rms, float(np.mean(np.abs(deviation_deg[known]) * common_deg[known])) / rms


def draw_differences(assessment: Mapping[str, Any]) -> tuple[tuple[str, str], ...]:
    """Compose the lines of a small picture: frequency of the differences from the reference, before and after."""
    counts = np.array([assessment["difference_counts"][when] for when in ("before", "after")], dtype=float)
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1.0)
    heights = 24.0 * (1.0 - shares / max(1e-9, shares.max()))
    return tuple(
        (kind, " ".join(f"{k - 35.5:g},{height:.1f}" for k, height in enumerate(each)))
        for kind, each in zip(("recorded", "corrected"), heights, strict=True)
        if np.any(each < 24.0)
    )


def _percentiles(values: Floats, at: tuple[float, float]) -> tuple[float, float]:
    low, high = np.percentile(values, at).tolist() if values.size else (np.nan, np.nan)
    return low, high


# Figures, embedded in the page with a colour palette.


def collect_figures(folder: Path, root: Path, subjects: Sequence[str], **given: Any) -> dict[str, ReportFigure]:
    """Collect the figures of a mooring or calibration that were drawn, by name, in the order of the table."""
    drawn = {row: folder / f"figures/{row.name}.png" for subject in subjects for row in FIGURES[subject]}
    return {
        row.name: ReportFigure(row.title, words.caption(row.caption, **given), relative_link(path, root))
        for row, path in drawn.items()
        if path.exists()
    }


def embed(figures: Iterable[ReportFigure], root: Path) -> tuple[ReportFigure, ...]:
    """Return the figures with their pictures, as the stages stored them or encoded from the PNG files.

    Raises:
        InputError: a PNG file is damaged.
    """
    stored, embedded = dict[Path, Mapping[str, files.Picture]](), []
    for figure in figures:
        path = root / unquote(figure.href)
        folder = path.parents[1]
        if folder not in stored:
            stored[folder] = files.read_pictures(folder)
        picture, size = stored[folder].get(path.stem) or files.embed_png(path)
        embedded.append(replace(figure, data=picture, width=size[0], height=size[1]))
    return tuple(embedded)


def relative_link(path: Path, root: Path) -> str:
    """Compose the URL of a result file relative to the page."""
    return quote(path.relative_to(root).as_posix())


def links(folders: Sequence[Path], root: Path, names: Iterable[str]) -> tuple[tuple[str, str], ...]:
    """Compose the links to those files that exist, each in the first of the folders that has it."""
    there = {name: [folder / name for folder in folders if (folder / name).exists()] for name in names}
    return tuple((name, relative_link(paths[0], root)) for name, paths in there.items() if paths)


# Diagnoses in words: findings, conclusion, limits.

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
    closed: dict[str, list[str]] = {}
    for effect, whys in reasons.items():
        closed.setdefault(", ".join(whys), []).append(words.plain(effect))
    untested = [(effects, why) for why, effects in closed.items()]
    return words.paragraphs("diagnosis", "limits", d=diagnosis, untested=untested)


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
        for row in MOORING:
            if row.of_pairs:
                pictures.pop(row.name, None)
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


def calibration_section(results: CalibrationResults, root: Path) -> ReportSection:
    """Compose one calibration's section."""
    content, diagnosis = results.content, results.diagnosis
    said, texts = describe_findings(diagnosis) if diagnosis else "", list(_nested_texts(content))
    tables = [each for name in TABLES for each in table("calibration", name, c=content)]
    limits = words.paragraphs("calibration", "limits", c=content)
    if diagnosis:
        tables += table("diagnosis", "detectable", d=diagnosis)
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
