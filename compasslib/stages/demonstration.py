"""Diagnose recordings of real compasses, and compare results of simulated moorings with the truth.

The recordings are in ``demo/recordings/``, with their sources and licences; results of data that must not be passed on
are stored there. What a logger added to the raw axes is known from its log: without it the heading is wrong by the
difference, and the logged heading is the truth.
"""

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import angles, calibrations, earthfield
from compasslib.archive import netcdf, provenance
from compasslib.archive.calibrations import StoredCalibration
from compasslib.archive.files import embed_png, read_json, read_pictures, write_json
from compasslib.calibrations import result
from compasslib.calibrations.magnetometer import log as magnetometer_log
from compasslib.calibrations.magnetometer.log import Log
from compasslib.calibrations.result import DeviationTable
from compasslib.deviation.correction import correct_headings, record_readings
from compasslib.deviation.model import fit_from_json
from compasslib.inference import kinds, wording
from compasslib.inference.comparison import Options
from compasslib.inference.diagnosis import Diagnosis
from compasslib.inference.kinds import magnetometer
from compasslib.plots.calibrations import draw_figure
from compasslib.plots.diagnosis import count_outside, draw_diagnosis, draw_errors, error_reach
from compasslib.preparation.references import combine_references
from compasslib.records import BAD
from compasslib.report import sections, words, write_page
from compasslib.report.sections import ReportFigure
from compasslib.stages import Files, Say
from compasslib.statistics.resampling import NORMAL_95, block_sums, blocks_by_span
from compasslib.types import DAY_S, Floats

FOLDER = Path(__file__).parents[1] / "demo/recordings"
OPTIONS = Options(surrogates=99)  # the fewest for a rank of 0.01
RECORDED, CORRECTED = "as recorded", "corrected by the instrument, with its gyroscopes"
WITHHELD, COMPLETE, SHIFTED = "tilt correction withheld", "nothing withheld", "withheld, and the tilts shifted in time"


def recordings(files: Files, say: Say) -> None:
    """Write what was found in each recording, as recorded or by what was withheld, beside what is known."""
    content = [describe(recording, recording.diagnose()) for recording in RECORDINGS]
    write_json(files.made, {"recordings": content})
    say(f"{files.made}: {len(content)} real recordings")


@dataclass(frozen=True)
class Recording:
    """A recording of a real compass, and what is known of it."""

    name: str
    title: str
    concealed: str  # what is withheld, in words
    truth: str  # how it is known; {} is the rms difference of logged heading and levelled axes
    effects: Sequence[str]  # that should be named; without any, the recording should be refused
    kind: str = "magnetometer"
    settings: Mapping[str, Any] = field(default_factory=dict)
    remaining: Sequence[str] = ()  # effects that act on it even if nothing is withheld
    control: str = ""  # column of headings that the instrument corrected itself
    path: str = ""  # of its numbers, NAME.csv by default

    @property
    def file(self) -> Path:
        """Its numbers."""
        return FOLDER / (self.path or f"{self.name}.csv")

    @property
    def resolved(self) -> dict[str, Any]:
        """Settings of its calibration."""
        return earthfield.resolve_settings({"kind": self.kind, **self.settings})

    def read_log(self) -> Log:
        """Read the log of a magnetometer."""
        log = magnetometer_log.read([self.file], self.settings)
        return replace(log, axis_by_axis=bool(self.settings.get("axis_by_axis")))

    def diagnose(self) -> dict[str, Diagnosis]:
        """Diagnose the recording with a correction withheld, and its controls, by what was done to it."""
        if self.kind != "magnetometer":
            cases: dict[str, Any] = {RECORDED: {}}
            if self.control:
                cases[CORRECTED] = {"columns": {"recorded_deg": self.control}}
            return {
                what: kinds.diagnose(self.kind, [self.file], {**self.resolved, **columns}, OPTIONS)
                for what, columns in cases.items()
            }
        log, diagnoses = self.read_log(), dict[str, Diagnosis]()
        for what, variant in ((WITHHELD, lambda log: log), (COMPLETE, _levelled), (SHIFTED, _shifted)):
            diagnoses[what] = magnetometer.diagnose_log(variant(log), field=None, options=OPTIONS)
            if diagnoses[what].verdict == "insufficient":
                break
        return diagnoses

    def as_expected(self, what: str, diagnosis: Diagnosis) -> bool:
        """Return whether a case, named by what was done to the recording, ended as it should."""
        named = {name for finding in diagnosis.findings for name in (finding.effect, *finding.alternatives)}
        if not self.effects:
            return diagnosis.verdict == "insufficient"
        if what in (RECORDED, WITHHELD):
            return named >= {*self.effects}
        if what == SHIFTED:
            return not {finding.driver for finding in diagnosis.findings} & {"pitch", "roll", "tilt"}
        if what == COMPLETE:
            return named <= {*self.remaining}
        return not {finding.effect for finding in diagnosis.findings if finding.level == "effect"} & {*self.effects}


def _levelled(log: Log) -> Log:
    """Level the axes as the logger does, so that nothing is withheld."""
    axes, *_ = magnetometer_log.search_axes(log)
    return replace(log, raw=np.einsum("nij,nj->ni", log.levelling(), log.raw @ axes.T))


def _shifted(log: Log) -> Log:
    """Shift the tilts by half the log, so that they are no longer those that turned the heading."""
    # Of the axes only the directions are kept, as their levelled modulus would follow the shifted tilts.
    assert log.pitch_deg is not None and log.roll_deg is not None
    half, cosines = len(log.raw) // 2, log.raw / np.linalg.norm(log.raw, axis=1, keepdims=True)
    return replace(log, raw=cosines, pitch_deg=np.roll(log.pitch_deg, half), roll_deg=np.roll(log.roll_deg, half))


FIGURES = {"platform": "deviation", "declination": "series"}  # of the other kinds the residual is drawn


def describe(recording: Recording, diagnoses: Mapping[str, Diagnosis]) -> dict[str, Any]:
    """Describe the diagnoses of a recording, and draw the first one."""
    figures, truth = [], recording.truth
    if recording.kind == "magnetometer":
        truth = truth.format(f"{magnetometer_log.search_axes(recording.read_log())[1]:.2f}°")
    first = next(iter(diagnoses.values())).to_json()
    if first["verdict"] != "insufficient":
        what = FIGURES.get(recording.kind, "residual")
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / f"{what}.png"
            if what == "residual":
                draw_diagnosis(file, first, dated=False)
            else:
                settings = recording.resolved
                made = calibrations.calibrate(recording.kind, [recording.file], settings)
                table, page = made.table or DeviationTable(*np.zeros((3, 0))), result.to_json("", made, settings)
                draw_figure(what, file, StoredCalibration(page, table, made.points))
            picture, (width, height) = embed_png(file)
        figures.append({"what": what, "picture": picture, "width": width, "height": height})
    proofs = {what: x.findings[0].held_out if x.findings else None for what, x in diagnoses.items()}
    cases = [
        {
            "what": what,
            "verdict": diagnosis.verdict,
            "conclusion": conclude(diagnosis),
            "expected": recording.as_expected(what, diagnosis),
            "heldout_deg": None if (proof := proofs[what]) is None else [proof.rms_before_deg, proof.rms_after_deg],
        }
        for what, diagnosis in diagnoses.items()
    ]
    known = {"name": recording.name, "title": recording.title, "concealed": recording.concealed, "truth": truth}
    found = {"cases": cases, "figures": figures, "outside": count_outside(first) if first["curves"] else None}
    return known | {"effects": recording.effects} | found


def conclude(diagnosis: Diagnosis) -> str:
    """Say in a line what was named, with the probabilities, or why nothing was."""
    if diagnosis.verdict == "insufficient":
        return diagnosis.why
    names = [
        " or ".join(
            f"{wording.display_name(name)} ({words.chance(probability)})"
            for name, probability in {finding.named: finding.probability, **finding.alternatives_probability}.items()
        )
        for finding in diagnosis.findings
    ]
    if (left := diagnosis.unexplained) is not None:
        along = " and ".join(name.replace("_", " ") for name in left.covariates)
        names.append(f"a mismatch of {left.rms_effect_deg:.1f}° rms along {along} that no listed effect explains")
    return "; ".join(names) or "no mismatch was noticed"


RECORDINGS = tuple(Recording(**known) for known in read_json(FOLDER / "recordings.json"))


def concealed(files: Files, say: Say) -> None:
    """Write the ``page`` of the comparison; this is the only stage that reads the truth.

    Moorings without a corrected record are left out.
    """
    there = {Path(path).parent.name for path in files.corrected}
    root, shown = Path(files.page).parent, [path for path in files.truths if Path(path).stem in there]
    known = {Path(path).stem: read_json(path) for path in shown}
    errors = {name: heading_errors(truth, root / name) for name, truth in known.items()}
    reach = error_reach([error for x in errors.values() for error in (x.fit_deg, x.corrected_deg)])
    moorings = [reveal(name, root, truth, errors[name], reach) for name, truth in known.items()]
    real, stored = read_json(files.recordings)["recordings"], read_json(FOLDER / "moored.json")
    real.append(read_json(FOLDER / "storm.json"))
    rows = count_named(real, stored["moorings"], moorings)
    content = {"rows": rows, "real": real, "stored": stored, "moorings": moorings}
    content |= {"software": provenance.software(), "definitions": words.definitions()}
    write_page(files.page, "concealed.html", **content)
    say(f"{files.page}: {len(moorings)} moorings beside the truth")


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


def heading_errors(truth: Mapping[str, Any], folder: Path) -> HeadingErrors:
    """Compare the headings of a mooring's results with the truth at the same times."""
    product = netcdf.read_corrected(folder / "corrected.nc", velocities=False)
    near = combine_references(netcdf.read_pairs(folder / "overlap.nc"))
    fit = fit_from_json(read_json(folder / "deviation.json")["fitted"])
    alone = correct_headings(record_readings(product.record), fit, near, None).heading_deg
    good = np.where(product.heading_corrected_quality < BAD, product.heading_corrected_deg, np.nan)
    time_s, known_s = product.record.time_s, np.array(truth["time_s"], dtype=float)
    at = np.clip(np.searchsorted(known_s, time_s), 0, len(known_s) - 1)
    right = np.where(np.abs(known_s[at] - time_s) < 1.0, np.array(truth["heading_deg"], dtype=float)[at], np.nan)
    recorded, fitted, corrected = (angles.difference(x, right) for x in (product.record.heading_deg, alone, good))
    return HeadingErrors(time_s, recorded, fitted, corrected, product.heading_uncertainty_deg)


def reveal(name: str, root: Path, truth: Mapping[str, Any], errors: HeadingErrors, reach_deg: float) -> dict[str, Any]:
    """Compare the results of a mooring with the truth, as content of its section; errors are drawn up to the reach.

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
        "unsettled": diagnosis["verdict"] == "ambiguous" and any(x["applied"] for x in stated),
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
        ("Real recordings, the cause withheld", *withheld),
        ("Real water, simulated iron", len(with_cause), *moored, len(none), sum(x["detected"] for x in none)),
        ("Simulated moorings", *known),
    ]
