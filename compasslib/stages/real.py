"""Recordings of real compasses that come with the project, each with a correction that can be withheld.

The numbers are in ``demo/recordings/``, with their sources and licences. What a logger added to the raw axes is known
from its log: without it the heading is wrong by the difference, and the logged heading is the truth.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from compasslib.calibrations.magnetometer import log as magnetometer_log
from compasslib.calibrations.magnetometer.log import Log
from compasslib.earthfield import resolve_settings
from compasslib.inference import kinds
from compasslib.inference.comparison import Options
from compasslib.inference.diagnosis import Diagnosis
from compasslib.inference.kinds import magnetometer

SURROGATES = 99  # the fewest for a rank of 0.01
FOLDER = Path(__file__).parents[1] / "demo/recordings"


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

    def as_expected(self, what: str, named: set[str], followed: set[str], verdict: str) -> bool:
        """Return whether a case ended as it should.

        Args:
            what: was done to the recording.
            named: effects, and ``followed``: their drivers.
        """
        if not self.effects:
            return verdict == "insufficient"
        if what == SHIFTED:
            return not followed & {"pitch", "roll", "tilt"}
        if what == COMPLETE:
            return named <= {*self.remaining}
        if what == CORRECTED:
            return not named & {*self.effects}
        return set(self.effects) <= named

    @property
    def file(self) -> Path:
        """Its numbers."""
        return FOLDER / f"{self.name}.csv"

    def read_log(self) -> Log:
        """Read the log of a magnetometer."""
        log = magnetometer_log.read([self.file], self.settings)
        return replace(log, axis_by_axis=bool(self.settings.get("axis_by_axis")))

    @property
    def known_by(self) -> str:
        """How the truth is known, with its accuracy."""
        if self.kind != "magnetometer":
            return self.truth
        _, scatter_deg, _ = magnetometer_log.search_axes(self.read_log())
        return self.truth.format(f"{scatter_deg:.2f}°")

    def diagnose(self) -> dict[str, Diagnosis]:
        """Diagnose the recording with a correction withheld, and its controls, by what was done to it."""
        options, settings = Options(surrogates=SURROGATES), resolve_settings({"kind": self.kind} | dict(self.settings))
        found = dict[str, Diagnosis]()
        if self.kind != "magnetometer":
            cases: dict[str, Any] = {RECORDED: {}} | (
                {CORRECTED: {"columns": {"recorded_deg": self.control}}} if self.control else {}
            )
            return {
                what: kinds.diagnose(self.kind, [self.file], {**settings, **columns}, options)
                for what, columns in cases.items()
            }
        log = self.read_log()
        for what, made in VARIANTS.items():
            found[what] = magnetometer.diagnose_log(made(log), field=None, options=options)
            if found[what].verdict == "insufficient":
                break
        return found


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


RECORDED, CORRECTED = "as recorded", "corrected by the instrument, with its gyroscopes"
WITHHELD, COMPLETE, SHIFTED = "tilt correction withheld", "nothing withheld", "withheld, and the tilts shifted in time"
VARIANTS: Mapping[str, Callable[[Log], Log]] = {
    WITHHELD: lambda log: log,
    COMPLETE: _levelled,
    SHIFTED: _shifted,
}


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
