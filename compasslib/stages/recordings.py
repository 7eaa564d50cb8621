"""Diagnose recordings of real compasses that come with the project, with a correction withheld and without.

The numbers are in ``demo/recordings/``, with their sources and licences. What a logger added to the raw axes is known
from its log: without it the heading is wrong by the difference, and the logged heading is the truth.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import calibrations, earthfield
from compasslib.archive.calibrations import StoredCalibration
from compasslib.archive.files import embed_png, write_json
from compasslib.calibrations import result
from compasslib.calibrations.magnetometer import log as magnetometer_log
from compasslib.calibrations.magnetometer.log import Log
from compasslib.calibrations.result import DeviationTable
from compasslib.inference import kinds, wording
from compasslib.inference.comparison import Options
from compasslib.inference.diagnosis import Diagnosis
from compasslib.inference.kinds import magnetometer
from compasslib.plots.calibrations import draw_deviation
from compasslib.plots.diagnosis import count_outside, draw_diagnosis
from compasslib.report import words

FOLDER = Path(__file__).parents[1] / "demo/recordings"
OPTIONS = Options(surrogates=99)  # the fewest for a rank of 0.01
RECORDED, CORRECTED = "as recorded", "corrected by the instrument, with its gyroscopes"
WITHHELD, COMPLETE, SHIFTED = "tilt correction withheld", "nothing withheld", "withheld, and the tilts shifted in time"


def recordings(*, made: str, say: Callable[[str], None]) -> None:
    """Write what was found in each recording, as recorded or by what was withheld, beside what is known."""
    content = [describe(recording) for recording in RECORDINGS]
    write_json(Path(made), {"recordings": content})
    say(f"{made}: {len(content)} real recordings")


@dataclass(frozen=True)
class Recording:
    """A recording of a real compass, and what is known of it."""

    name: str
    title: str
    concealed: str  # what is withheld, in words
    truth: str  # how it is known; {} is the rms difference of logged heading and levelled axes
    effects: tuple[str, ...]  # that should be named; without any, the recording should be refused
    kind: str = "magnetometer"
    settings: Mapping[str, Any] = field(default_factory=dict)
    remaining: tuple[str, ...] = ()  # effects that act on it even if nothing is withheld
    control: str = ""  # column of headings that the instrument corrected itself

    @property
    def file(self) -> Path:
        """Its numbers."""
        return FOLDER / f"{self.name}.csv"

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
        if what == SHIFTED:
            return not {finding.driver for finding in diagnosis.findings} & {"pitch", "roll", "tilt"}
        if what == COMPLETE:
            return named <= {*self.remaining}
        return not named & {*self.effects} if what == CORRECTED else named >= {*self.effects}


def _levelled(log: Log) -> Log:
    """Level the axes as the logger does, so that nothing is withheld."""
    axes, *_ = magnetometer_log.search_axes(log)
    return replace(log, raw=np.einsum("nij,nj->ni", log.levelling(), log.raw @ axes.T))


def _shifted(log: Log) -> Log:
    """Shift the tilts by half the log, so that they are no longer those that turned the heading.

    The axes become direction cosines, whose heading is the same: their horizontal modulus, which is levelled with the
    tilts, would follow the shifted ones.
    """
    assert log.pitch_deg is not None and log.roll_deg is not None
    half, cosines = len(log.raw) // 2, log.raw / np.linalg.norm(log.raw, axis=1, keepdims=True)
    return replace(log, raw=cosines, pitch_deg=np.roll(log.pitch_deg, half), roll_deg=np.roll(log.roll_deg, half))


def describe(recording: Recording) -> dict[str, Any]:
    """Diagnose a recording and describe each case; of the first one, deviation or residual is drawn."""
    diagnoses, figures, truth = recording.diagnose(), [], recording.truth
    if recording.kind == "magnetometer":
        truth = truth.format(f"{magnetometer_log.search_axes(recording.read_log())[1]:.2f}°")
    first = next(iter(diagnoses.values())).to_json()
    if first["curves"]:
        what = "deviation" if recording.kind == "platform" else "residual"
        with tempfile.TemporaryDirectory() as folder:
            if what == "deviation":
                draw_deviation(file := Path(folder) / f"{what}.png", stored(recording))
            else:
                draw_diagnosis(file := Path(folder) / f"{what}.png", first, dated=False)
            picture, (width, height) = embed_png(file)
        figures.append({"what": what, "picture": picture, "width": width, "height": height})
    return {
        "name": recording.name,
        "title": recording.title,
        "concealed": recording.concealed,
        "truth": truth,
        "effects": recording.effects,
        "cases": [_describe_case(recording, what, diagnosis) for what, diagnosis in diagnoses.items()],
        "figures": figures,
        "outside": count_outside(first) if figures else None,
    }


def stored(recording: Recording) -> StoredCalibration:
    """Calibrate a recording, in the form in which figures read it."""
    made = calibrations.calibrate(recording.kind, [recording.file], recording.resolved)
    table = made.table or DeviationTable(*np.zeros((3, 0)))
    return StoredCalibration(result.to_json(recording.name, made, recording.resolved), table, made.points)


def _describe_case(recording: Recording, what: str, diagnosis: Diagnosis) -> dict[str, Any]:
    proof = diagnosis.findings[0].held_out if diagnosis.findings else None
    return {
        "what": what,
        "verdict": diagnosis.verdict,
        "conclusion": conclude(diagnosis),
        "expected": recording.as_expected(what, diagnosis),
        "heldout_deg": None if proof is None else [proof.rms_before_deg, proof.rms_after_deg],
    }


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


PATHS = ("path_ab", "path_cd", "path_ef", "path_gh")
OTHERS = ("ax", "ay", "az", "pressure_dbar")
LOGGED = "the logged heading, from which the levelled axes differ by {} rms about a constant"
LEVELLING = "the levelling of the axes by the tilts"


def _acm(name: str, day: str, *, effects: tuple[str, ...] = ("tilt_uncompensated",)) -> Recording:
    title = f"Falmouth 3D-ACM on a moored profiler, {day}"
    settings = {"axis_by_axis": True, "covariates": PATHS}
    return Recording(name, title, LEVELLING, LOGGED, effects, settings=settings)


RECORDINGS = (
    Recording(
        "car_circles",
        "Compass in a car that drives circles, iron stronger than the earth's horizontal field",
        "the exact compass: the simulation is the five-term series",
        "the course over ground by GNSS, which a car's heading follows: that of its gyroscopes differs by 1.3° rms",
        ("large_deviation",),
        "platform",
        {"latitude": 42.34, "longitude": -71.09, "date": "2025-11-19"},
        control="own_deg",
    ),
    _acm("acm_2018_06_10", "10 June 2018"),
    Recording(
        "signature500",
        "Nortek Signature500 turned by hand",
        LEVELLING,
        LOGGED,
        ("tilt_uncompensated", "hard_iron"),
        settings={"covariates": OTHERS},
        remaining=("hard_iron", "soft_iron"),
    ),
    _acm("acm_2013_07_24", "24 July 2013"),
    _acm("acm_2018_06_11", "11 June 2018"),
    _acm("acm_2014_06_06", "6 June 2014, tilts stuck", effects=()),
    Recording(
        "taiohae",
        "Swing of a sailing boat under way (OlivierLD/ROB)",
        "nothing",
        "none: the course over ground is not the heading, and differs by the drift",
        ("water_drift",),
        "swing",
        {"latitude": -8.92, "longitude": -140.1, "date": "2010-11-03"},
    ),
    Recording(
        "eight_headings",
        "Eight headings of a buoy (Moncunill Marimón 2023, section 5.3)",
        "nothing",
        "none: eight headings determine no more than the coefficients",
        (),
        "platform",
        {"latitude": 41.4, "longitude": 2.2, "date": "2021-06-01"},
    ),
)
