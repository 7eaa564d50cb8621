"""Compare the results of the demonstration moorings whose errors are concealed with the truth."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import angles
from compasslib.archive import netcdf, provenance
from compasslib.archive.files import embed_png, read_json, read_pictures
from compasslib.deviation.correction import correct_headings, record_readings
from compasslib.deviation.model import fit_from_json
from compasslib.plots.diagnosis import draw_errors, error_reach
from compasslib.preparation.references import combine_references
from compasslib.records import BAD
from compasslib.report import sections, words, write_page
from compasslib.report.results import ReportedFinding, ReportFigure
from compasslib.statistics.resampling import NORMAL_95, block_sums, blocks_by_span
from compasslib.types import DAY_S, Floats


def concealed(
    *, page: str, truths: Sequence[str], corrected: Sequence[str], recordings: str, say: Callable[[str], None]
) -> None:
    """Write the page of the comparison; this is the only stage that reads the truth.

    Args:
        recordings: recordings.json.
        truths: file of the truth of each mooring; those without a corrected record are left out.
        corrected: corrected.nc of the moorings that were not stopped.
    """
    there = {Path(path).parent.name for path in corrected}
    root, shown = Path(page).parent, [path for path in truths if Path(path).stem in there]
    known = {Path(path).stem: read_json(path) for path in shown}
    errors = {name: heading_errors(truth, read_headings(root / name)) for name, truth in known.items()}
    reach = error_reach([error for x in errors.values() for error in (x.fit_deg, x.corrected_deg)])
    moorings = [reveal(name, root, truth, errors[name], reach) for name, truth in known.items()]
    real = read_json(recordings)["recordings"]
    write_page(page, "concealed.html", real=real, moorings=moorings, software=provenance.software())
    say(f"{page}: {len(moorings)} moorings beside the truth")


def read_headings(folder: Path) -> dict[str, Floats]:
    """Read the headings of a mooring's results: as recorded, by the fitted coefficients alone, and as corrected."""
    product = netcdf.read_corrected(folder / "corrected.nc", velocities=False)
    near = combine_references(netcdf.read_pairs(folder / "overlap.nc"))
    fit = fit_from_json(read_json(folder / "deviation.json")["fitted"])
    alone = correct_headings(record_readings(product.record), fit, near, None).heading_deg
    return {
        "time_s": product.record.time_s,
        "recorded_deg": product.record.heading_deg,
        "fit_deg": alone,
        "corrected_deg": product.heading_corrected_deg,
        "sigma_deg": product.heading_uncertainty_deg,
        "flag": np.asarray(product.heading_corrected_quality, dtype=float),
    }


@dataclass(frozen=True)
class HeadingErrors:
    """Heading errors at n samples, degrees, NaN if missing."""

    time_s: Floats
    recorded_deg: Floats
    fit_deg: Floats  # by the fitted coefficients alone
    corrected_deg: Floats
    sigma_deg: Floats  # stated standard deviation of the corrected headings

    def rms(self, error_deg: Floats) -> str:
        """Format the rms with its 95 % interval by block resampling."""
        if (mean := self._mean(error_deg**2)) is None:
            return "–"
        return "{:.1f}° ({:.1f}–{:.1f})".format(*np.sqrt(mean))

    @property
    def coverage(self) -> tuple[float, float, float] | None:
        """Share of corrected headings whose stated 95 % interval contains the truth, with its own 95 % interval."""
        within = np.abs(self.corrected_deg) <= NORMAL_95 * self.sigma_deg
        return self._mean(np.where(np.isfinite(self.corrected_deg + self.sigma_deg), within, np.nan))

    @property
    def understated(self) -> bool:
        """Whether the stated uncertainty is too small: the coverage is significantly below 95 %."""
        return self.coverage is not None and self.coverage[2] < 0.95

    @property
    def sigma_rms_deg(self) -> float:
        """Rms of the stated standard deviation over the corrected headings."""
        return angles.rms(self.sigma_deg[np.isfinite(self.corrected_deg + self.sigma_deg)])

    def _mean(self, values: Floats, *, days: float = 5.0, draws: int = 1000) -> tuple[float, float, float] | None:
        """Average over the finite values, with the 95 % interval by resampling blocks of some days."""
        known = np.isfinite(values)
        if not known.any():
            return None
        sums = block_sums(
            np.stack([values[known], np.ones(known.sum())], axis=1), blocks_by_span(self.time_s[known], days * DAY_S)
        )
        drawn = np.random.default_rng(0).choice(sums, (draws, len(sums))).sum(axis=1)
        low, high = np.quantile(drawn[:, 0] / drawn[:, 1], [0.025, 0.975])
        return float(np.mean(values[known])), float(low), float(high)


def heading_errors(truth: Mapping[str, Any], headings: Mapping[str, Floats]) -> HeadingErrors:
    """Compare headings with the truth at the same times.

    Args:
        headings: time_s, recorded_deg, fit_deg, corrected_deg, sigma_deg and flag of each sample.
    """
    known_s = np.array(truth["time_s"], dtype=float)
    known_deg = np.array([np.nan if x is None else x for x in truth["heading_deg"]], dtype=float)
    at = np.clip(np.searchsorted(known_s, headings["time_s"]), 0, len(known_s) - 1)
    right = np.where(np.abs(known_s[at] - headings["time_s"]) < 1.0, known_deg[at], np.nan)
    off = {key: angles.difference(headings[f"{key}_deg"], right) for key in ("recorded", "fit", "corrected")}
    usable = headings["flag"] < BAD
    return HeadingErrors(
        headings["time_s"], off["recorded"], off["fit"], np.where(usable, off["corrected"], np.nan),
        headings["sigma_deg"],
    )  # fmt: skip


def reveal(name: str, root: Path, truth: Mapping[str, Any], errors: HeadingErrors, reach_deg: float) -> dict[str, Any]:
    """Compare the results of a mooring with the truth, as content of its section.

    Args:
        root: folder of the results, to which links on the page are relative.
        reach_deg: limit of the axis of heading errors, common to all moorings of the page.
    """
    diagnosis = read_json(root / name / "diagnosis.json")
    with tempfile.TemporaryDirectory() as folder:
        series = errors.time_s, errors.fit_deg, errors.corrected_deg, errors.sigma_deg
        draw_errors(file := Path(folder) / "errors.png", *series, [x["date"] for x in truth["planted"]], reach_deg)
        drawn = embed_png(file)
    caption = " ".join(words.paragraphs("concealed", "figure", planted=truth["planted"], reach=reach_deg))
    figures = [ReportFigure("Heading errors along time", caption, "", drawn[0], *drawn[1])]
    if "diagnosis" in (pictures := read_pictures(root / name)):
        picture, size = pictures["diagnosis"]
        caption = sections.diagnosis_caption(diagnosis)
        figures.append(ReportFigure("Diagnosis", caption, f"{name}/figures/diagnosis.png", picture, *size))
    drivers = [entry.get("driver") or "" for entry in diagnosis["findings"]]
    fields = {cause["driver"]: cause.get("field") or {} for cause in truth["planted"]}
    findings = sections.report_findings(diagnosis, product=True)
    known = [_with_truth(said, fields.get(driver, {})) for said, driver in zip(findings, drivers, strict=False)]
    return {
        "name": name,
        "truth": truth,
        "verdict": diagnosis["verdict"],
        "answer": sections.describe_findings(diagnosis),
        "drivers": drivers,
        "findings": (*known, *findings[len(known) :]),
        "errors": errors,
        "figures": figures,
        "href": f"report.html#mooring-{name}",
    }


def _with_truth(said: ReportedFinding, field: Mapping[str, Any]) -> ReportedFinding:
    """Add the true field to the parameters of a finding if iron with the same driver was planted."""
    if said.parameters is None or not field:
        return said
    known = {row: next((field[way] for way in field if row[0].endswith(way)), None) for row in said.parameters.rows}
    unit = f"{words.SPACE}{field['unit']}"
    rows = tuple((*row, words.number(x, 0) + unit * (x is not None)) for row, x in known.items())
    return replace(said, parameters=replace(said.parameters, header=(*said.parameters.header, "Truth"), rows=rows))
