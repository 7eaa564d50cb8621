"""Effects on the sensor and its readout: large deviation, harmonics, drifts, lags, levelling with wrong tilts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from compasslib import angles, compass
from compasslib.effects.effect import (
    READINGS,
    SHORT_RECORDINGS,
    Effect,
    OfReading,
    Proportional,
    Scene,
    TurningScene,
    date_parameter,
    elapsed_share,
    parameter,
)
from compasslib.types import Floats


@dataclass(frozen=True)
class LargeDeviation(Proportional):
    """The reading is that of the exact compass, not that of the series."""

    name, driver = "large_deviation", "heading"
    words = "the deviation is too large for the small-angle series; the exact compass fits"
    shows_along = ("heading",)
    recordings = ("mooring", "platform", "swing")
    detector = "exact compass and series, each fitted"
    acts_on = "reading"
    literature = "Le Menn et al. 2023, eq. (4), against von Appen 2015, eq. (1), its first order"
    needs = ("exact_minus_series",)

    share: float = parameter("1", "share of the difference; 1 is the exact compass", 0.2)


# Harmonics of the recorded heading, as of a periodic error of the readout or of a calibration table.


@dataclass(frozen=True)
class Harmonic(OfReading):
    """The reading is shifted by a harmonic of the undisturbed reading."""

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

    name, driver = "sextantal", "heading"
    words = "the reading has a third harmonic of the recorded heading (sextantal deviation)"
    shows_along = ("heading",)
    separated_by: ClassVar[Mapping[str, str]] = {
        "octantal": "wider headings, or a swing of 16 to 24 headings all round"
    }
    recordings = READINGS
    order: ClassVar[float] = 3.0
    instrument = True
    literature = "Moncunill et al. 2023, section 5.3 (sextantal); clockwise positive"


@dataclass(frozen=True)
class Octantal(Harmonic):
    """The reading is shifted by a fourth harmonic of the undisturbed reading."""

    name, driver = "octantal", "heading"
    words = "the reading has a fourth harmonic of the recorded heading (octantal deviation)"
    shows_along = ("heading",)
    recordings = READINGS
    order: ClassVar[float] = 4.0
    instrument = True
    literature = "Moncunill et al. 2023, section 5.3 (octantal); clockwise positive"


@dataclass(frozen=True)
class CompassDrift(OfReading):
    """The reading drifts with time."""

    name = "compass_drift"
    words = "the compass drifts with time"
    literature = "A of von Appen 2015, eq. (1), linear in time; reading clockwise positive"

    deg_year: float = parameter("degrees/year", "drift of the reading", 1.0, usual=10.0)

    def apply(self, x: Floats, scene: Scene) -> Floats:
        return x + self.deg_year * scene.years


# A slipping mount: the compass is mounted at another angle from a date on.
@dataclass(frozen=True)
class HeadingSlip(OfReading):
    """The reading is shifted by a constant from a date on: a step in A."""

    name = "heading_slip"
    words = "the mount turned: all headings are off by a constant from then on"
    separated_by: ClassVar[Mapping[str, str]] = {
        "compass_drift": "more readings around the date, or the same headings read again in another order",
        "tilt_uncompensated": "logged tilts",
    }
    recordings = (*READINGS, "declination")
    literature = "a step of A in von Appen 2015, eq. (1); reading clockwise positive"

    offset_deg: float = parameter("degrees", "turn of the reading after the date", 1.0, usual=10.0)
    date_s: float = date_parameter()

    def apply(self, x: Floats, scene: Scene) -> Floats:
        return x + self.offset_deg * scene.since(self.date_s)


# Lag of the compass: a damped needle or a filter shows an earlier heading.
@dataclass(frozen=True)
class CompassLag(OfReading):
    """The reading lags behind the heading by a constant time, to first order."""

    name, driver = "compass_lag", "turn_rate"
    words = "the compass lags when the instrument turns"
    shows_along = ("turn_rate",)
    separated_by: ClassVar[Mapping[str, str]] = {
        "clock_offset": "tilts of both heads that change with time: they have no compass in them"
    }
    instrument = True
    literature = "first order: reading minus lag times its rate of turn, clockwise positive"
    needs = ("turn_rate",)

    lag_s: float = parameter("s", "time by which the reading is late", 300.0)

    def apply(self, x: Floats, scene: Scene) -> Floats:
        return x - self.lag_s * scene.departures["turn_rate"]


# Missing tilt compensation: the compass measures the angle in its own plane instead of the horizontal one.
@dataclass(frozen=True)
class TiltUncompensated(Effect):
    """A share of the tilt compensation is missing."""

    name, driver = "tilt_uncompensated", "tilt"
    words = "the reading is not compensated for tilt"
    shows_along = ("pitch", "roll")
    separated_by: ClassVar[Mapping[str, str]] = {"moving_iron": "the magnetometer's three axes with tilt"}
    stage = "sensor"
    instrument = True
    literature = "physics page, section 4: n = m instead of T m; 1 means no compensation at all"

    share: float = parameter("1", "share of the levelling that is left out", 0.05, usual=1.0)

    def apply(self, x: Floats, scene: Scene) -> Floats:
        """Rotate the field so that full levelling yields the partly levelled field."""
        level = scene.levelling
        return (1.0 - self.share) * x + self.share * np.einsum("nji,nj->ni", level, x)


# A tilt sensor with a zero offset, constant or with temperature, mixes the vertical into the horizontal field.

OFF_DEG_K = 0.1  # typical of a tilt sensor


def _levelled_off(x: Floats, scene: Scene, pitch_deg: Floats | float, roll_deg: Floats | float) -> Floats:
    """Rotate the field so that levelling by the recorded tilts has the effect of tilt errors, recorded minus true."""
    right = compass.levelling(scene.pitch_deg - pitch_deg, scene.roll_deg - roll_deg)
    return np.einsum("nji,njk,nk->ni", right, scene.levelling, x)


@dataclass(frozen=True)
class TemperatureOfTilt(Effect):
    """The zero of the tilt sensor shifts with temperature, which affects the levelling of the compass."""

    name, driver = "temperature", "temperature"
    stage = "sensor"
    literature = "Z k (T - T0)/H, nearly a field forward and to starboard; tilts given minus true"
    needs = ("temperature",)

    pitch_deg_K: float = parameter("degrees/K", "change of the pitch", 0.2, usual=OFF_DEG_K)
    roll_deg_K: float = parameter("degrees/K", "change of the roll", 0.2, usual=OFF_DEG_K)

    def apply(self, x: Floats, scene: Scene) -> Floats:
        warm = scene.departures["temperature"]
        return _levelled_off(x, scene, self.pitch_deg_K * warm, self.roll_deg_K * warm)


@dataclass(frozen=True)
class TiltOffset(Effect):
    """The tilts used for levelling the compass have constant errors."""

    name, driver = "tilt_offset", "tilt"
    words = "the tilts by which the compass is compensated have constant errors"
    stage = "sensor"
    literature = "Z (offset)/H, in B and C of von Appen 2015, eq. (1), but for what the lean changes"
    detector = "vertical velocities that follow the flow in the body, or a level deck"

    pitch_deg: float = parameter("degrees", "pitch given minus true", 0.2)
    roll_deg: float = parameter("degrees", "roll given minus true", 0.2)

    def apply(self, x: Floats, scene: Scene) -> Floats:
        return _levelled_off(x, scene, self.pitch_deg, self.roll_deg)


# A stuck tilt sensor: the compass is levelled with a wrong tilt.
@dataclass(frozen=True)
class StuckTilt(Effect):
    """While the tilts are stuck, the compass is levelled without the tilt that the flow predicts for the instrument."""

    name, driver = "stuck_tilt", "tilt"
    words = "the tilt sensors are stuck, and the compass is compensated with their last values"
    stage = "sensor"
    literature = "physics page, section 4: n = T(stuck) m; 1: all of the lean that the flow foretells"
    needs = ("lean_pitch", "lean_roll")
    always_present = True  # it is tested only for a sensor that shows one value for weeks

    share: float = parameter("1", "share of the predicted lean", 0.05, usual=1.0)

    def apply(self, x: Floats, scene: Scene) -> Floats:
        """Replace the field at the recorded tilt by that at the tilt predicted from the flow."""
        pitch, roll = (scene.departures[name] for name in self.needs)
        right = compass.levelling(scene.pitch_deg + self.share * pitch, scene.roll_deg + self.share * roll)
        return np.einsum("nji,njk,nk->ni", right, scene.levelling, x)


@dataclass(frozen=True)
class CompassDelay(OfReading):
    """The reading is delayed exactly, not to first order, as the instrument may swing quickly."""

    name, driver = "compass_lag", "turn_rate"
    recordings = ("magnetometer", "two_heads")
    literature = "a delay; for slow turns its first order, reading minus lag times the rate of turn"

    lag_s: float = parameter("s", "time by which the reading is late", 0.1)

    def apply(self, x: Floats, scene: Scene) -> Floats:
        assert isinstance(scene, TurningScene) and scene.turned is not None
        return x + scene.turned(-self.lag_s)


@dataclass(frozen=True)
class CompassTrend(OfReading):
    """The reading drifts linearly along the record."""

    name = "compass_drift"
    recordings = SHORT_RECORDINGS
    literature = "a trend of A in von Appen 2015, eq. (1); reading clockwise positive"

    deg_record: float = parameter("degrees over the record", "drift of the reading", 1.0)

    def apply(self, x: Floats, scene: Scene) -> Floats:
        return x + self.deg_record * elapsed_share(scene)


@dataclass(frozen=True)
class MountingOffset(OfReading):
    """The recorded heading is rotated by a constant from that of the magnetometer's axes."""

    name, driver = "mounting_offset", ""
    words = "the heading is turned by a constant from the magnetometer's axes"
    shows_along = ("heading",)
    separated_by: ClassVar[Mapping[str, str]] = {
        "tilt_uncompensated": "logged tilts",
        "declination_error": "the declination that the instrument was set to",
    }
    recordings = ("magnetometer",)
    literature = "A of von Appen 2015, eq. (1); clockwise positive"

    offset_deg: float = parameter("degrees", "recorded heading minus that of the axes", 1.0)

    def apply(self, x: Floats, scene: Scene) -> Floats:
        return x + self.offset_deg


@dataclass(frozen=True)
class ReadingLevelled(Effect):
    """The recorded heading is compensated for tilt, the simulated one is not."""

    name, driver = "tilt_uncompensated", "tilt"
    recordings = ("magnetometer",)
    stage = "sensor"
    words = "the recorded heading is compensated for tilt, the simulated one is not"
    literature = "physics page, section 4: n = T m instead of m; 1 means that all levelling was left out"

    share: float = parameter("1", "share of the levelling that the simulation lacks", 0.05, usual=1.0)

    def apply(self, x: Floats, scene: Scene) -> Floats:
        """Level a share of the field."""
        return (1.0 - self.share) * x + self.share * np.einsum("nij,nj->ni", scene.levelling, x)
