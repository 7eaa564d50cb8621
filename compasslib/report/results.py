"""Results of a cruise as the report reads them from files, and the parts of which its sections are made."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote

import numpy as np

from compasslib import angles
from compasslib.archive import attributes as archive_attributes
from compasslib.archive import files, netcdf, summary
from compasslib.archive.files import open_netcdf, read_json, read_variable
from compasslib.plots.figures import FIGURES
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
    data: str = ""  # the picture as a data URI; empty if it is only linked
    width: int = 0  # pixels
    height: int = 0
    linked: bool = False  # whether it is not embedded


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
    return ReportSection(
        name=name,
        anchor=f"{part}-{name}",
        verdict="stopped",
        summary=(answer,),
        use="no" * (part == "mooring"),
        to_do=(to_do,),
        links=(("logs", f"{'calibrations/' * (part == 'calibration')}{name}/logs"),),
        cells=(name, *(known.get(column, "") for column in header[1:])),
    )


@dataclass(frozen=True)
class Overview:
    """All sections of moorings, compasses or calibrations, and the caption and header of the table of their cells."""

    caption: str
    header: tuple[str, ...] = ()
    sections: Sequence[ReportSection] = ()


# Results of one mooring or calibration that its section shows.


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
    fit, diagnosis, assessment = (
        read_json(folder / f"{file}.json") for file in ("deviation", "diagnosis", "assessment")
    )
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
        days, recorded, corrected, flags, sigma, common, deviation, declination = (
            read_variable(nc, name)
            for name in (
                *("TIME", "HEADING", "HEADING_CORRECTED", "HEADING_CORRECTED_QC", "HEADING_CORRECTED_UNCERTAINTY"),
                *("HEADING_COMMON_UNCERTAINTY", "DEVIATION", "DECLINATION"),
            )
        )
        names = [name for name in ("instrument", "serial_number") if name in nc.ncattrs()]
        attributes = {name: nc.getncattr(name) for name in names}
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
        "recorded_span_deg": heading_span(recorded),
        "corrected_span_deg": heading_span(corrected),
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
    shares = {}
    for kind, when in (("recorded", "before"), ("corrected", "after")):
        counts = np.asarray(assessment["difference_counts"][when], dtype=float)
        shares[kind] = counts / max(float(counts.sum()), 1.0)
    most = max(1e-9, *(float(share.max()) for share in shares.values()))
    return tuple(
        (kind, " ".join(f"{k - 35.5:g},{24.0 * (1.0 - share / most):.1f}" for k, share in enumerate(each)))
        for kind, each in shares.items()
        if each.any()
    )


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


# Figures, embedded in the page with a colour palette.


def collect_figures(folder: Path, root: Path, subjects: Sequence[str], **given: Any) -> dict[str, ReportFigure]:
    """Collect the figures of one mooring or calibration that were drawn, by name, in the order of the table.

    Args:
        folder: folder of its results, with the PNG files in ``figures``.
        subjects: in ``plots.figures.FIGURES``.
        **given: results that the captions describe.
    """
    collected = {}
    for row in (row for subject in subjects for row in FIGURES[subject]):
        if (path := folder / f"figures/{row.name}.png").exists():
            caption = words.caption(row.caption, **given)
            collected[row.name] = ReportFigure(row.title, caption, relative_link(path, root), linked=row.linked)
    return collected


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
        picture, size = ("", (0, 0)) if figure.linked else stored[folder].get(path.stem) or files.embed_png(path)
        embedded.append(replace(figure, data=picture, width=size[0], height=size[1]))
    return tuple(embedded)


def relative_link(path: Path, root: Path) -> str:
    """Compose the URL of a result file relative to the page."""
    return quote(path.relative_to(root).as_posix())


def links(folders: Sequence[Path], root: Path, names: Iterable[str]) -> tuple[tuple[str, str], ...]:
    """Compose the links to those files that exist, each in the first of the folders that has it."""
    there = {name: [folder / name for folder in folders if (folder / name).exists()] for name in names}
    return tuple((name, relative_link(paths[0], root)) for name, paths in there.items() if paths)
