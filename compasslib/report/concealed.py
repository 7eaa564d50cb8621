"""Moorings with known truth: what was planted beside what was said, as one page."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import angles
from compasslib.archive.files import embed_png, read_json, read_pictures
from compasslib.plots.truth import draw_errors
from compasslib.records import BAD
from compasslib.report import explanation, words
from compasslib.report.sections import Figure, ReportedFinding
from compasslib.statistics.resampling import NORMAL_95, block_sums, blocks_by_span
from compasslib.types import DAY_S, Floats

BLOCK_S, DRAWS = 5 * DAY_S, 1000  # of the errors that are resampled together


@dataclass(frozen=True)
class HeadingErrors:
    """Errors of headings at n samples, degrees, NaN where there is none."""

    time_s: Floats
    recorded_deg: Floats
    fit_deg: Floats  # by the fitted coefficients alone
    corrected_deg: Floats
    sigma_deg: Floats  # as stated, of the corrected ones

    def rms(self, error_deg: Floats) -> str:
        """Format the rms with its 95 % interval by resampled blocks."""
        known = np.isfinite(error_deg)
        if not known.any():
            return "–"
        squares = np.stack([error_deg[known] ** 2, np.ones(known.sum())], axis=1)
        sums = block_sums(squares, blocks_by_span(self.time_s[known], BLOCK_S))
        drawn = np.random.default_rng(0).choice(sums, (DRAWS, len(sums))).sum(axis=1)
        low, high = np.sqrt(np.quantile(drawn[:, 0] / drawn[:, 1], [0.025, 0.975]))
        middle = np.sqrt(np.mean(squares[:, 0]))
        return f"{middle:.1f}° ({low:.1f}–{high:.1f})"

    @property
    def coverage(self) -> float | None:
        """The share of corrected headings within 1.96 stated standard deviations of the truth."""
        known = np.isfinite(self.corrected_deg) & np.isfinite(self.sigma_deg)
        within = np.abs(self.corrected_deg[known]) <= NORMAL_95 * self.sigma_deg[known]
        return float(within.mean()) if known.any() else None


@dataclass(frozen=True)
class Revealed:
    """One mooring: what was planted, what was said, and the headings beside the truth."""

    name: str
    truth: Mapping[str, Any]
    verdict: str
    answer: str
    drivers: frozenset[str]  # of the findings
    findings: Sequence[ReportedFinding]
    errors: HeadingErrors
    figures: Sequence[Figure]
    href: str


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


def reveal(name: str, root: Path, truth: Mapping[str, Any], headings: Mapping[str, Floats]) -> Revealed:
    """Set the results of a mooring beside the truth.

    Args:
        root: folder of the results, in which the page will stand.
    """
    diagnosis = read_json(root / name / "diagnosis.json")
    errors = heading_errors(truth, headings)
    with tempfile.TemporaryDirectory() as folder:
        series = errors.time_s, errors.fit_deg, errors.corrected_deg, errors.sigma_deg
        draw_errors(file := Path(folder) / "errors.png", *series, [cause["date"] for cause in truth["planted"]])
        drawn = embed_png(file)
    caption = words.caption("concealed", "errors", planted=truth["planted"])
    figures = [Figure("Heading errors along time", caption, "", drawn[0], *drawn[1])]
    picture, size = read_pictures(root / name)["diagnosis"]
    caption = explanation.diagnosis_caption(diagnosis)
    figures.append(Figure("Diagnosis", caption, f"{name}/figures/diagnosis.png", picture, *size))
    return Revealed(
        name, truth, diagnosis["verdict"], explanation.describe_findings(diagnosis),
        frozenset(entry.get("driver") or "" for entry in diagnosis["findings"]),
        explanation.report_findings(diagnosis, product=True), errors, figures, f"report.html#mooring-{name}",
    )  # fmt: skip
