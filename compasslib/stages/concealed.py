"""Compare the results of the demonstration moorings whose errors are concealed with the truth."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
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
from compasslib.report.sections import ReportFigure
from compasslib.stages.recordings import FOLDER
from compasslib.statistics.resampling import NORMAL_95, block_sums, blocks_by_span
from compasslib.types import DAY_S, Floats


def concealed(
    *, page: str, truths: Sequence[str], corrected: Sequence[str], recordings: str, say: Callable[[str], None]
) -> None:
    """Write the page of the comparison; this is the only stage that reads the truth.

    Args:
        truths: file of the truth of each mooring; those without a corrected record are left out.
    """
    there = {Path(path).parent.name for path in corrected}
    root, shown = Path(page).parent, [path for path in truths if Path(path).stem in there]
    known = {Path(path).stem: read_json(path) for path in shown}
    errors = {name: heading_errors(truth, read_headings(root / name)) for name, truth in known.items()}
    reach = error_reach([error for x in errors.values() for error in (x.fit_deg, x.corrected_deg)])
    moorings = [reveal(name, root, truth, errors[name], reach) for name, truth in known.items()]
    real, stored = read_json(recordings)["recordings"], read_json(FOLDER / "moored.json")
    rows = count_named(real, stored["moorings"], moorings)
    content = {"rows": rows, "real": real, "stored": stored, "moorings": moorings}
    write_page(page, "concealed.html", **content, software=provenance.software())
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
        mean = self._mean(error_deg**2)
        return "–" if mean is None else "{:.1f}° ({:.1f}–{:.1f})".format(*np.sqrt(mean))

    @property
    def coverage(self) -> tuple[float, float, float] | None:
        """Share of corrected headings whose stated 95 % interval contains the truth, with its own 95 % interval."""
        within = np.abs(self.corrected_deg) <= NORMAL_95 * self.sigma_deg
        return self._mean(np.where(np.isfinite(self.corrected_deg + self.sigma_deg), within, np.nan))

    @property
    def understated(self) -> bool:
        """Whether the stated uncertainty is too small, by the intervals: of the coverage, or of the rms error."""
        if self.coverage is None or (mean := self._mean(self.corrected_deg**2)) is None:
            return False
        return bool(self.coverage[2] < 0.95 or np.sqrt(mean[1]) > self.sigma_rms_deg)

    @property
    def worsened(self) -> bool:
        """Whether the final correction is worse than that by the coefficients alone, beyond both intervals."""
        final, alone = self._mean(self.corrected_deg**2), self._mean(self.fit_deg**2)
        return final is not None and alone is not None and final[1] > alone[2]

    @property
    def mean_deg(self) -> float:
        """Mean error of the corrected headings."""
        return float(np.nanmean(self.corrected_deg))

    @property
    def sigma_rms_deg(self) -> float:
        """Rms of the stated standard deviation over the corrected headings."""
        return angles.rms(self.sigma_deg[np.isfinite(self.corrected_deg + self.sigma_deg)])

    def _mean(self, values: Floats) -> tuple[float, float, float] | None:
        """Average over the finite values, with the 95 % interval by resampling blocks of five days."""
        known = np.isfinite(values)
        if not known.any():
            return None
        both = np.stack([values[known], np.ones(known.sum())], axis=1)
        sums = block_sums(both, blocks_by_span(self.time_s[known], 5.0 * DAY_S))
        drawn = np.random.default_rng(0).choice(sums, (1000, len(sums))).sum(axis=1)
        low, high = np.quantile(drawn[:, 0] / drawn[:, 1], [0.025, 0.975])
        return float(np.mean(values[known])), float(low), float(high)


def heading_errors(truth: Mapping[str, Any], headings: Mapping[str, Floats]) -> HeadingErrors:
    """Compare headings, as of ``read_headings``, with the truth at the same times."""
    known_s = np.array(truth["time_s"], dtype=float)
    known_deg = np.array(truth["heading_deg"], dtype=float)
    at = np.clip(np.searchsorted(known_s, headings["time_s"]), 0, len(known_s) - 1)
    right = np.where(np.abs(known_s[at] - headings["time_s"]) < 1.0, known_deg[at], np.nan)
    recorded, fit, corrected = (
        angles.difference(headings[f"{key}_deg"], right) for key in ("recorded", "fit", "corrected")
    )
    corrected = np.where(headings["flag"] < BAD, corrected, np.nan)
    return HeadingErrors(headings["time_s"], recorded, fit, corrected, headings["sigma_deg"])


def reveal(name: str, root: Path, truth: Mapping[str, Any], errors: HeadingErrors, reach_deg: float) -> dict[str, Any]:
    """Compare the results of a mooring with the truth, as content of its section.

    Args:
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
    stated = diagnosis["findings"]
    of_compass = [x for x in stated if x["side"] in ("compass", "clock")]
    return {
        "name": name,
        "truth": {**truth, "planted": [cause | {"level": named_level(cause, stated)} for cause in truth["planted"]]},
        "verdict": diagnosis["verdict"],
        "answer": sections.describe_findings(diagnosis),
        "false": [x for x in of_compass if driver_of(x) not in {cause["driver"] for cause in truth["planted"]}],
        "use": read_json(root / name / "assessment.json")["use"],
        "sensitivity": " ".join(words.paragraphs("diagnosis", "sensitivity", d=diagnosis)),
        "findings": sections.report_findings(diagnosis, product=True),
        "errors": errors,
        "figures": figures,
        "href": f"report.html#mooring-{name}",
    }


def driver_of(finding: Mapping[str, Any]) -> str:
    """Return the driver of a finding, one for both axes of the tilt."""
    driver = finding.get("driver") or ""
    return "tilt" if driver in ("pitch", "roll") else driver


def named_level(cause: Mapping[str, Any], findings: Sequence[Mapping[str, Any]]) -> str:
    """Grade what findings state of a cause with 0.95: its effect, its driver, or nothing (an empty text)."""
    levels = {
        "effect" if x["level"] == "effect" and x["effect"] == (cause["effect"] or "composed") else "driver"
        for x in findings
        if x["level"] in ("driver", "effect") and driver_of(x) == cause["driver"]
    }
    return min(levels, key=("effect", "driver").index, default="")


def count_named(
    real: Sequence[Mapping[str, Any]], stored: Sequence[Mapping[str, Any]], simulated: Sequence[Mapping[str, Any]]
) -> list[tuple[str, int, int, int, int, int]]:
    """Count causes, those whose driver and whose effect was named, cases without a cause, and those accused."""
    logs = [item["cases"] for item in real if item["effects"] and item["figures"] and len(item["cases"]) > 1]
    named, controls = [cases[0]["expected"] for cases in logs], [x["expected"] for cases in logs for x in cases[1:]]
    with_cause, none = [x for x in stored if x["planted"]], [x for x in stored if not x["planted"]]
    moored = (sum(x["driver"] for x in with_cause), sum(x["effect"] for x in with_cause))
    levels = [cause["level"] for item in simulated for cause in item["truth"]["planted"]]
    accused = [bool(item["false"]) for item in simulated if not item["truth"]["planted"]]
    known = (len(levels), sum(map(bool, levels)), levels.count("effect"), len(accused), sum(accused))
    withheld = (len(logs), sum(named), sum(named), len(controls), controls.count(False))
    return [
        ("Real compasses, a correction withheld", *withheld),
        ("Real water, simulated iron", len(with_cause), *moored, len(none), sum(x["detected"] for x in none)),
        ("Simulated moorings", *known),
    ]
