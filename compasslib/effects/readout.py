"""Effects on the sensor and its readout: large deviation, harmonics, drifts, lags, levelling with wrong tilts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np

from compasslib import angles, compass
from compasslib.effects import effect
from compasslib.effects.effect import READINGS, SHORT_RECORDINGS, Effect, Scene, additive, parameter
from compasslib.types import Floats

_reading = partial(additive, stage="readout", acts_on="reading")

LargeDeviation = additive(
    "LargeDeviation", "The reading is that of the exact compass, not that of the series.",
    name="large_deviation", driver="heading", shows_along=("heading",), recordings=("mooring", "platform", "swing"),
    detector="exact compass and series, each fitted", acts_on="reading", needs=("exact_minus_series",),
    words="the deviation is too large for the small-angle series; the exact compass fits",
    literature="Le Menn et al. 2023, eq. (4), against von Appen 2015, eq. (1), its first order",
    share=parameter("1", "share of the difference; 1 is the exact compass", 0.2),
)  # fmt: skip


# Harmonics of the recorded heading, as of a periodic error of the readout or of a calibration table.
@dataclass(frozen=True)
class Harmonic(Effect):
    """The reading is shifted by a harmonic of the undisturbed reading."""

    driver = "heading"
    shows_along = ("heading",)
    recordings = READINGS
    stage, acts_on, instrument = "readout", "reading", True
    order: ClassVar[float]

    sine_deg: float = parameter("degrees", "sine part", 1.0)
    cosine_deg: float = parameter("degrees", "cosine part", 1.0)

    @property
    def possible(self) -> bool:
        """Whether the reading always increases with the angle of the field: order times amplitude below a radian."""
        return 1.0 - self.order * angles.DEGREE * float(np.hypot(self.sine_deg, self.cosine_deg)) > 0.0

    def apply(self, x: Floats, scene: Scene) -> Floats:
        sine, cosine = angles.sin_cos(self.order * x)
        return x + self.sine_deg * sine + self.cosine_deg * cosine

    def invert(self, reading_deg: Floats, scene: Scene) -> Floats:
        """Remove the harmonic from a reading; NaN everywhere if some readings have three solutions."""
        if not self.possible:
            return np.full_like(reading_deg, np.nan)
        period = 360.0 / self.order
        whole = np.linspace(0.0, period, int(period) + 1)
        begins = self.apply(whole[:1], scene)
        turns = np.floor((reading_deg - begins) / period)
        x = period * turns + np.interp(reading_deg - period * turns, self.apply(whole, scene), whole)
        for _ in range(4):
            sine, cosine = angles.sin_cos(self.order * x)
            slope = 1.0 + self.order * angles.DEGREE * (self.sine_deg * cosine - self.cosine_deg * sine)
            x = x + (reading_deg - self.apply(x, scene)) / slope
        return np.asarray(x)


@dataclass(frozen=True)
class Sextantal(Harmonic):
    """The reading is shifted by a third harmonic of the undisturbed reading."""

    name, order = "sextantal", 3.0
    words = "the reading has a third harmonic of the recorded heading (sextantal deviation)"
    separated_by: ClassVar[Mapping[str, str]] = {
        "octantal": "wider headings, or a swing of 16 to 24 headings all round"
    }
    literature = "Moncunill et al. 2023, section 5.3 (sextantal); clockwise positive"


@dataclass(frozen=True)
class Octantal(Harmonic):
    """The reading is shifted by a fourth harmonic of the undisturbed reading."""

    name, order = "octantal", 4.0
    words = "the reading has a fourth harmonic of the recorded heading (octantal deviation)"
    literature = "Moncunill et al. 2023, section 5.3 (octantal); clockwise positive"


CompassDrift = _reading(
    "CompassDrift", "The reading drifts with time.", lambda term, scene: term.deg_year * scene.years,
    name="compass_drift",
    words="the compass drifts with time",
    literature="A of von Appen 2015, eq. (1), linear in time; reading clockwise positive",
    deg_year=parameter("degrees/year", "drift of the reading", 1.0, usual=10.0),
)  # fmt: skip
CompassTrend = _reading(
    "CompassTrend", "The reading drifts linearly along the record.",
    lambda term, scene: term.deg_record * scene.elapsed_share,
    name="compass_drift", recordings=SHORT_RECORDINGS,
    literature="a trend of A in von Appen 2015, eq. (1); reading clockwise positive",
    deg_record=parameter("degrees over the record", "drift of the reading", 1.0),
)  # fmt: skip

# A slipping mount: the compass is mounted at another angle from a date on.
HeadingSlip = _reading(
    "HeadingSlip", "The reading is shifted by a constant from a date on: a step in A.",
    lambda term, scene: term.offset_deg * scene.since(term.date_s),
    name="heading_slip", recordings=(*READINGS, "declination"),
    words="the mount turned: all headings are off by a constant from then on",
    separated_by={
        "compass_drift": "more readings around the date, or the same headings read again in another order",
        "tilt_uncompensated": "logged tilts",
    },
    literature="a step of A in von Appen 2015, eq. (1); reading clockwise positive",
    offset_deg=parameter("degrees", "turn of the reading after the date", 1.0, usual=10.0),
    date_s=effect.date_parameter(),
)  # fmt: skip
MountingOffset = _reading(
    "MountingOffset", "The recorded heading is rotated by a constant from that of the magnetometer's axes.",
    lambda term, _: term.offset_deg,
    name="mounting_offset", driver="", shows_along=("heading",), recordings=("magnetometer",),
    words="the heading is turned by a constant from the magnetometer's axes",
    separated_by={
        "tilt_uncompensated": "logged tilts",
        "declination_error": "the declination that the instrument was set to",
    },
    literature="A of von Appen 2015, eq. (1); clockwise positive",
    offset_deg=parameter("degrees", "recorded heading minus that of the axes", 1.0),
)  # fmt: skip

# Lag of the compass: a damped needle or a filter shows an earlier heading.
CompassLag = _reading(
    "CompassLag", "The reading lags behind the heading by a constant time, to first order.",
    lambda term, scene: -term.lag_s * scene.departures["turn_rate"],
    name="compass_lag", driver="turn_rate", shows_along=("turn_rate",), instrument=True, needs=("turn_rate",),
    words="the compass lags when the instrument turns",
    separated_by={"clock_offset": "tilts of both heads that change with time: they have no compass in them"},
    literature="first order: reading minus lag times its rate of turn, clockwise positive",
    lag_s=parameter("s", "time by which the reading is late", 300.0),
)  # fmt: skip
CompassDelay = _reading(
    "CompassDelay", "The reading is delayed exactly, not to first order, as the instrument may swing quickly.",
    lambda term, scene: scene.turned(-term.lag_s),
    name="compass_lag", driver="turn_rate", recordings=("magnetometer", "two_heads"),
    literature="a delay; for slow turns its first order, reading minus lag times the rate of turn",
    lag_s=parameter("s", "time by which the reading is late", 0.1),
)  # fmt: skip


# Levelling by wrong tilts mixes the vertical into the horizontal field.
_tilt = partial(effect.make_effect, driver="tilt", stage="sensor")


def _levelled(x: Floats, scene: Scene, pitch_deg: Floats | float, roll_deg: Floats | float) -> Floats:
    """Rotate the field so that levelling by the recorded tilts has the effect of errors, recorded minus true."""
    right = compass.levelling(scene.pitch_deg - pitch_deg, scene.roll_deg - roll_deg)
    return np.einsum("nji,njk,nk->ni", right, scene.levelling, x)


TiltUncompensated = _tilt(
    "TiltUncompensated", "A share of the tilt compensation is missing.",
    lambda term, x, scene: (1.0 - term.share) * x + term.share * np.einsum("nji,nj->ni", scene.levelling, x),
    name="tilt_uncompensated", shows_along=("pitch", "roll"), instrument=True,
    words="part of the tilt compensation is missing",
    separated_by={"moving_iron": "the magnetometer's three axes with tilt"},
    literature="Poisson's equations with tilt: n = m instead of T m; 1 means no compensation at all",
    share=parameter("1", "share of the levelling that is left out", 0.05, usual=1.0),
)  # fmt: skip
ReadingLevelled = _tilt(
    "ReadingLevelled", "The recorded heading is compensated for tilt, the simulated one is not.",
    lambda term, x, scene: (1.0 - term.share) * x + term.share * np.einsum("nij,nj->ni", scene.levelling, x),
    name="tilt_uncompensated", recordings=("magnetometer",),
    words="the recorded heading is compensated for tilt, the simulated one is not",
    literature="Poisson's equations with tilt: n = T m instead of m; 1 means that all levelling was left out",
    share=parameter("1", "share of the levelling that the simulation lacks", 0.05, usual=1.0),
)  # fmt: skip
TemperatureOfTilt = _tilt(
    "TemperatureOfTilt",
    "The zero of the tilt sensor shifts with temperature, which affects the levelling of the compass.",
    lambda term, x, scene: _levelled(x, scene, *(term.values[:, None] * scene.departures["temperature"])),
    name="temperature", driver="temperature", needs=("temperature",),
    literature="Z k (T - T0)/H, nearly a field forward and to starboard; tilts given minus true",
    pitch_deg_K=parameter("degrees/K", "change of the pitch", 0.2, usual=0.1),  # typical of a tilt sensor
    roll_deg_K=parameter("degrees/K", "change of the roll", 0.2, usual=0.1),
)  # fmt: skip
TiltOffset = _tilt(
    "TiltOffset", "The tilts used for levelling the compass have constant errors.",
    lambda term, x, scene: _levelled(x, scene, term.pitch_deg, term.roll_deg),
    name="tilt_offset",
    words="the tilts by which the compass is compensated have constant errors",
    literature="Z (offset)/H, in B and C of von Appen 2015, eq. (1), but for what the tilt changes",
    detector="vertical velocities that follow the flow in the body, or a level deck",
    pitch_deg=parameter("degrees", "pitch given minus true", 0.2),
    roll_deg=parameter("degrees", "roll given minus true", 0.2),
)  # fmt: skip
StuckTilt = _tilt(
    "StuckTilt",
    "While the tilts are stuck, the compass is levelled without the tilt that the flow predicts for the instrument.",
    lambda term, x, scene: _levelled(x, scene, *(-term.share * scene.departures[name] for name in term.needs)),
    name="stuck_tilt", needs=("lean_pitch", "lean_roll"),
    words="the tilt sensors are stuck, and the compass is compensated with their last values",
    literature="Poisson's equations with tilt: n = T(stuck) m; 1: all of the tilt that the flow predicts",
    share=parameter("1", "share of the predicted tilt", 0.05, usual=1.0),
)  # fmt: skip
