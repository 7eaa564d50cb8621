"""Content of the report before its conversion to HTML: results read from files, their description, and sections.

Texts are plain and are escaped when the page is rendered.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from compasslib import angles
from compasslib.archive import attributes as archive_attributes
from compasslib.archive import files, netcdf, summary
from compasslib.archive.files import open_netcdf, read_json, read_variable
from compasslib.effects import COMPOSED, meanings
from compasslib.effects.composed import effect_formula
from compasslib.inference import wording
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
class Figure:
    """A figure of the results."""

    title: str
    caption: str
    href: str  # URL of the file, relative to the page
    data: str = ""  # the picture as a data URI; empty if it is only linked
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
    summary: tuple[str, ...]  # sentences; the first is the conclusion, which the top of the page repeats
    facts: tuple[tuple[str, str], ...]
    to_do: tuple[str, ...] = ()  # sentences: actions left to the user
    first: tuple[Figure, ...] = ()  # figures shown first, such as currents before and after
    finding_figures: tuple[Figure, ...] = ()  # figures shown with the findings
    findings: tuple[ReportedFinding, ...] = ()
    limits: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    figures: tuple[Figure, ...] = ()  # all others
    tables: tuple[ReportTable, ...] = ()
    links: tuple[tuple[str, str], ...] = ()  # text, URL relative to the page
    cells: tuple[str, ...] = ()  # its row in the overview


def table(template: str, block: str, **given: Any) -> tuple[ReportTable, ...]:
    """Render a table of a template as caption, header and rows; the result is empty if it has no rows."""
    filled = words.cells(template, block, **given)
    return (ReportTable(" ".join(filled[0]), filled[1], tuple(filled[2:])),) if filled[2:] else ()


def stopped_section(part: str, name: str, why: str, header: Sequence[str]) -> ReportSection:
    """Compose the section of a mooring or calibration that has no results."""
    known = {"Verdict": "stopped", "Warnings": "1"}
    answer, to_do = words.paragraphs("mooring", "stopped", why=why)
    return ReportSection(
        name=name,
        anchor=f"{part}-{name}",
        verdict="stopped",
        summary=(answer,),
        facts=(),
        to_do=(to_do,),
        links=(("logs", f"{'calibrations/' * (part == 'calibration')}{name}/logs"),),
        cells=(name, *(known.get(column, "") for column in header[1:])),
    )


@dataclass(frozen=True)
class Overview:
    """All sections of moorings, compasses or calibrations, and the table that compares them."""

    caption: str
    header: tuple[str, ...]
    sections: Sequence[ReportSection]

    @property
    def table(self) -> ReportTable:
        """One row for each section."""
        return ReportTable(self.caption, self.header, tuple(section.cells for section in self.sections))


# Results of one mooring or calibration that its section shows.

SHOWN_ATTRIBUTES = (
    "instrument",
    "serial_number",
    "software_version",
    "date_created",
    "time_coverage_start",
    "time_coverage_end",
)


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
    inputs: Mapping[str, Mapping[str, int]]  # counts of the samples of each instrument, by kind

    @property
    def product(self) -> Mapping[str, Any]:
        """The fit used for the product and shown in the figures."""
        fit: Mapping[str, Any] = self.fit["applied"]["fit"] or self.fit
        return fit

    @property
    def other_compass(self) -> bool:
        """Whether the product uses a compass other than that of the configured fit."""
        applied = self.fit["applied"]
        changed = applied["effects"] or applied["accounted_for"] or applied["method"] != self.fit["method"]
        return bool(applied["fit"] and changed)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings of all stages."""
        return tuple(warning for warning in self.row["warnings"].split(" | ") if warning)

    @property
    def depth(self) -> str:
        """Depth of the currents shown in figures, with its unit."""
        return f"{words.number(self.currents.depth_m, 0)}{words.SPACE}m"

    def averaging(self, *, sticks: bool = False) -> str:
        """Format the time over which the currents in figures are averaged."""
        most = summary.MAX_STICKS if sticks else summary.MAX_MEANS
        hours = summary.averaging_hours(self.currents.recorded.time_s, most)
        return words.plural(int(hours), "hour") if hours <= 24.0 else words.plural(int(hours / 24.0), "day")


def read_summary(table: str | Path) -> dict[str, dict[str, str]]:
    """Read the rows of summary.csv by mooring."""
    with Path(table).open(newline="", encoding="utf-8") as stream:
        return {row["name"]: row for row in csv.DictReader(stream)}


def read_mooring(name: str, root: Path, row: Mapping[str, str], roles: Iterable[str] | None = None) -> MooringResults:
    """Read the files of one mooring; ``roles`` are the names of its instruments, see ``summary.record_paths``."""
    folder = root / name
    fit, diagnosis, assessment = (
        read_json(folder / f"{file}.json") for file in ("deviation", "diagnosis", "assessment")
    )
    inputs = {path.stem: netcdf.read_notes(path, "counts") for path in summary.record_paths(folder, roles)}
    product = folder / "corrected.nc"
    shown = summary.read_bin_currents(product)
    return MooringResults(name, folder, row, fit, diagnosis, assessment, _summarize_headings(product), shown, inputs)


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


def _summarize_headings(path: str | Path) -> dict[str, Any]:
    """Summarize the headings of a corrected.nc; its profiles are not read."""
    with open_netcdf(path) as nc:
        recorded, corrected, sigma, deviation, declination = (
            read_variable(nc, name)
            for name in ("HEADING", "HEADING_CORRECTED", "HEADING_CORRECTED_UNCERTAINTY", "DEVIATION", "DECLINATION")
        )
        flags = read_variable(nc, "HEADING_CORRECTED_QC")
        attributes = {name: nc.getncattr(name) for name in SHOWN_ATTRIBUTES if name in nc.ncattrs()}
        missing = archive_attributes.missing(nc.ncattrs())
        days = read_variable(nc, "TIME")
    there = np.isfinite(corrected)
    steps = np.diff(days) if len(days) > 1 else np.ones(1)
    return {
        "n": len(recorded),
        # Missing samples between the first and the last, by the median interval.
        "absent": int(np.sum(np.maximum(np.round(steps / np.median(steps)) - 1.0, 0.0))),
        "corrected": int(there.sum()),
        "doubtful": int(np.sum(there & (flags == PROBABLY_BAD))),
        "sigma_deg": _percentiles(sigma[there], (50.0, 95.0)),
        "largest_deviation_deg": float(np.max(np.abs(deviation[there]))) if there.any() else float("nan"),
        "recorded_span_deg": heading_span(recorded),
        "corrected_span_deg": heading_span(corrected),
        "declination_deg": _percentiles(declination[np.isfinite(declination)], (0.0, 100.0)),
        "attributes": attributes,
        "missing": missing,  # global attributes required by the conventions
    }


def heading_span(heading_deg: Floats) -> tuple[float, float]:
    """Compute the 5th and 95th percentile of finite headings about their circular mean, degrees; NaN without any."""
    finite = heading_deg[np.isfinite(heading_deg)]
    middle = angles.mean(finite)
    low, high = _percentiles(angles.difference(finite, middle), (5.0, 95.0))
    return float(angles.wrap360(middle + low)), float(angles.wrap360(middle + high))


def _percentiles(values: Floats, at: tuple[float, float]) -> tuple[float, float]:
    if not values.size:
        return float("nan"), float("nan")
    low, high = np.percentile(values, at)
    return float(low), float(high)


# Figures embedded in the page: with a colour palette; on a page of many sections small and few.

MAX_SECTIONS = 50  # above which figures are not embedded at full size; a thousand moorings would need 400 MB
TITLES = {
    "sticks": "Currents along time",
    "progressive": "Progressive vector diagram",
    "roses": "Direction frequencies before and after",
    "section": "Sections before and after",
    "profile": "Mean profiles",
    "diagnosis": "Residual of the fit",
    "deviation": "Deviation of the compass",
    "histograms": "Histograms before and after",
    "scatter": "Direction compared with the reference",
    "timeline": "Headings along time",
    "residuals": "Residuals of the curve",
    "certificate": "Certificate",
    "magnetometer": "Magnetometer readings before and after",
    "swing": "The swing",
    "difference": "Difference of the two compasses",
    "tilt_check": "Tilts of the two instruments",
    "along_time": "Both compasses along time",
    "series": "Declination of the observatory",
    "disturbance": "Disturbances of the field",
    "array": "The array",
    "curves": "Deviations",
    "differences": "Differences from the reference",
    "currents": "Mean currents and variance ellipses",
}
LINKED = ("certificate",)  # not embedded, as the tables contain the same numbers


def collect_figures(folder: Path, root: Path, caption: Callable[[str], str], *, small: bool) -> dict[str, Figure]:
    """Collect the figures of one mooring or calibration by name, in the order of ``TITLES``, then all others.

    Args:
        folder: folder of its results, with the PNG files in ``figures``.
        caption: composes the caption of a figure from its name.
        small: whether the page has too many sections for figures of full size, here and below.
    """
    order = {name: k for k, name in enumerate(TITLES)}
    paths = sorted(folder.glob("figures/*.png"), key=lambda p: (order.get(p.stem, len(order)), p.stem))
    made = files.read_pictures(folder, small=small)
    figures = {}
    for path in paths:
        name = path.stem
        picture, size = made.get(name, ("", (0, 0)))
        if name not in made and name not in LINKED and not small:
            picture, size = files.embed_png(path)
        title = TITLES.get(name, name.replace("_", " ").capitalize())
        figures[name] = Figure(title, caption(name), relative_link(path, root), picture, *size)
    return figures


def relative_link(path: Path, root: Path) -> str:
    """Compose the URL of a result file relative to the page."""
    return quote(path.relative_to(root).as_posix())


def links(folder: Path, root: Path, names: Iterable[str]) -> tuple[tuple[str, str], ...]:
    """Compose the links to those files of a folder that exist."""
    return tuple((name, relative_link(folder / name, root)) for name in names if (folder / name).exists())


# Diagnoses in words: conclusion, findings, limits.

LARGE = "large_deviation"  # not a limit: it is not tested because the exact compass, which includes it, was fitted
MAX_NAMES, MOST_ALTERNATIVES = 3, 5  # candidates of a finding that are named in the summary, and in its section
CLAUSES = {
    **wording.PHYSICS,
    "hard_iron": "iron near by adds a constant field",
    "mounting_offset": "the mount turns all headings by a constant",
    "field_disturbance": "magnetic north moved with storms or the daily variation",  # shown by a series, or an index
}


def report_findings(diagnosis: Mapping[str, Any], *, product: bool) -> tuple[ReportedFinding, ...]:
    """Describe the findings, strongest first, and then what remains unexplained.

    Args:
        diagnosis: content of diagnosis.json.
        product: whether there is a corrected record to which a finding may be applied.
    """
    findings = []
    for entry in diagnosis["findings"]:
        parts = entry.get("composition")
        title = words.plain(f"{COMPOSED}{'/'.join(parts.values())}" if parts else entry["effect"])
        others = candidate_names(entry)[1:]
        if rest := others[MOST_ALTERNATIVES + 1 :]:
            others = [*others[:MOST_ALTERNATIVES], f"{len(rest) + 1} others, listed in diagnosis.json"]
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


def describe_findings(diagnosis: Mapping[str, Any]) -> str:
    """Summarize the findings beyond the fitted deviation in a clause, with their probabilities."""
    clauses = []
    for entry in diagnosis["findings"]:
        names = candidate_names(entry)
        more = len(names) - MAX_NAMES
        clause = " or ".join([*names[:MAX_NAMES], *([f"one of {more} others"] if more > 1 else names[MAX_NAMES:])])
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

    curves = [curve["covariate"] for curve in wording.displayed_residuals(diagnosis)]
    parts = [entry["composition"] for entry in diagnosis["findings"] if entry.get("composition")]
    shown = {"heading", "time", *((entry.get("where") or {}).get("covariate") for entry in diagnosis["findings"])}
    others = [] if diagnosis["unexplained"] else [name for name in curves[-1:] if name not in shown]
    return words.caption(
        "diagnosis", "diagnosis", d=diagnosis, outside=count_outside(diagnosis) if curves else (),
        turns=[name for name in curves if name.startswith(wording.TURN_PREFIX)],
        slopes=[entry for entry in diagnosis["findings"] if (entry.get("heldout") or {}).get("slope")],
        candidate="".join(name for name in others if not name.startswith((wording.TURN_PREFIX, wording.SIZE_PREFIX))),
        composed=[(entry["acts_on"], effect_formula(**entry)) for entry in parts],
    )  # fmt: skip


# Sections of moorings, calibrations and compasses.

CURRENTS = ("sticks", "progressive", "roses")
OF_PAIRS = ("diagnosis", "deviation", "histograms", "scatter")  # left out if there are neither pairs nor a curve
FILES = (
    *("corrected.nc", "gridded.nc", "overlap.nc", "deviation.json", "diagnosis.json", "assessment.json"),
    *("table.csv", "histograms.csv", "figures", "logs"),
)


def mooring_section(results: MooringResults, root: Path, site: Mapping[str, Any], *, small: bool) -> ReportSection:
    """Compose one mooring's section.

    Args:
        site: latitude, longitude, water_depth_m, instruments (role and description).
    """

    def caption(figure: str) -> str:
        if figure == "diagnosis":
            return diagnosis_caption(results.diagnosis)
        return words.caption("mooring", figure, r=results)

    folders = [results.folder, *([results.folder.parent] if "/" in results.name else [])]  # also of the whole mooring
    collected = [collect_figures(folder, root, caption, small=small) for folder in folders]
    pictures = {name: figure for figures in collected for name, figure in figures.items()}
    if not (results.fit["n_pairs"] or results.product["coefficients"]):
        pictures = {name: entry for name, entry in pictures.items() if name not in OF_PAIRS}
    findings = report_findings(results.diagnosis, product=True)
    counts = dict.fromkeys(name for of_role in results.inputs.values() for name in of_role)
    nonzero = [name for name in counts if any(of_role.get(name) for of_role in results.inputs.values())]
    zero = [words.plain(name) for name in counts if name not in nonzero]
    return ReportSection(
        name=results.name,
        anchor=f"mooring-{results.name}",
        verdict=results.diagnosis["verdict"],
        summary=summary_sentences(results),
        to_do=words.paragraphs("mooring", "actions", r=results),
        facts=(
            *words.facts("mooring", "place", r=results, site=site),
            *measures(results),
            *words.facts("mooring", "more", r=results),
        ),
        first=tuple(pictures.pop(name) for name in CURRENTS if name in pictures),
        finding_figures=(pictures.pop("diagnosis"),) if findings and "diagnosis" in pictures else (),
        findings=findings,
        limits=describe_limits(results.diagnosis),
        warnings=results.warnings,
        figures=tuple(pictures.values()),
        tables=(
            *table("mooring", "agreement", r=results),
            *table("mooring", "coefficients", r=results),
            *limits_table(results.diagnosis),
            *table("diagnosis", "hypotheses", d=results.diagnosis),
            *table("mooring", "inputs", inputs=results.inputs, names=nonzero, zero=zero),
        ),
        links=tuple(
            (file, relative_link(there, root))
            for file in FILES
            for there in [folder / file for folder in folders if (folder / file).exists()][:1]
        ),
        cells=words.cells("mooring", "row", r=results)[0],
    )


def summary_sentences(results: MooringResults) -> tuple[str, ...]:
    """Summarize a mooring: conclusion, agreement with the reference, and reasons for what was not achieved."""
    findings = describe_findings(results.diagnosis)
    return words.paragraphs("mooring", "summary", r=results, findings=findings)


def measures(results: MooringResults) -> tuple[tuple[str, str], ...]:
    """List method, number of corrected samples, uncertainty and largest deviation."""
    return words.facts("mooring", "measures", r=results)


CALIBRATION_FILES = ("calibration.json", "table.csv", "points.csv", "diagnosis.json", "figures", "logs")
TABLES = ("coefficients", "forms", "tilts", "iron", "cardinal", "storms", "budget")
COMPASS_FILES = ("compass.json", "diagnosis.json", "figures", "logs")


def calibration_section(results: CalibrationResults, root: Path, *, small: bool) -> ReportSection:
    """Compose one calibration's section."""
    content, diagnosis = results.content, results.diagnosis

    def caption(figure: str) -> str:
        if figure == "diagnosis" and diagnosis:
            return diagnosis_caption(diagnosis)
        return words.caption("calibration", figure, c=content)

    figures = collect_figures(results.folder, root, caption, small=small)
    findings = report_findings(diagnosis, product=False) if diagnosis else ()
    said, texts = describe_findings(diagnosis) if diagnosis else "", list(_nested_texts(content))
    return ReportSection(
        name=results.name,
        anchor=f"calibration-{results.name}",
        verdict=diagnosis.get("verdict", ""),
        summary=words.paragraphs("calibration", "summary", c=content, diagnosis=diagnosis, findings=said, texts=texts),
        facts=words.facts("calibration", "facts", c=content),
        finding_figures=(figures.pop("diagnosis"),) if findings and "diagnosis" in figures else (),
        findings=findings,
        limits=(
            *words.paragraphs("calibration", "limits", c=content),
            *(describe_limits(diagnosis) if diagnosis else ()),
        ),
        warnings=tuple(content["warnings"]),
        first=tuple(figures.values()),
        tables=(
            *(each for name in TABLES for each in table("calibration", name, c=content)),
            *((*limits_table(diagnosis), *table("diagnosis", "hypotheses", d=diagnosis)) if diagnosis else ()),
            *table("calibration", "deviations", table=results.table),
        ),
        links=links(results.folder, root, CALIBRATION_FILES),
        cells=words.cells("calibration", "row", name=results.name, c=content, diagnosis=diagnosis)[0],
    )


def _nested_texts(content: Mapping[str, Any]) -> Iterator[str]:
    """Yield the sentences (values of the key ``text``) of a calibration at any level of nesting."""
    for key, value in content.items():
        if key == "text" and isinstance(value, str) and value:
            yield value
        elif isinstance(value, Mapping):
            yield from _nested_texts(value)


def compass_section(name: str, root: Path, *, small: bool) -> ReportSection:
    """Compose the section of a compass that several records share.

    Raises:
        InputError: if a result file is missing or damaged.
    """
    folder = root / "compasses" / name
    content, diagnosis = read_json(folder / "compass.json"), read_json(folder / "diagnosis.json")
    figures = collect_figures(folder, root, lambda figure: words.caption("compass", figure, c=content), small=small)
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
        first=tuple(figures.values()),
        links=links(folder, root, COMPASS_FILES),
        cells=words.cells("compass", "row", name=name, c=content, d=diagnosis)[0],
    )
