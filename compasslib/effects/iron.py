"""Effects of iron in the body frame: hard and soft iron, steps, drifts, batteries, temperature, heeling."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from compasslib.effects.effect import (
    READINGS,
    SHORT_RECORDINGS,
    Effect,
    OfReading,
    Proportional,
    Scene,
    date_parameter,
    elapsed_share,
    horizontal_field,
    parameter,
)
from compasslib.types import Floats


@dataclass(frozen=True)
class HardIron(Effect):
    """A constant field in the body frame is added."""

    name, driver = "hard_iron", "heading"
    words = "a magnetised part that turns with the instrument adds a constant field (hard iron)"
    shows_along = ("heading",)
    separated_by: ClassVar[Mapping[str, str]] = {
        "tilt_uncompensated": "logged tilts: a mean tilt in the vertical field looks like hard iron"
    }
    literature = "Poisson's P, Q, R; Le Menn et al. 2023, eq. (1); forward, starboard, down positive"
    recordings = ("magnetometer",)  # elsewhere B and C of the fitted curve hold it

    b_x_nT: float = parameter("nT", "field forward", 200.0)
    b_y_nT: float = parameter("nT", "field to starboard", 200.0)
    b_z_nT: float = parameter("nT", "field down", 2000.0)

    def apply(self, x: Floats, scene: Scene) -> Floats:
        return x + np.array([self.b_x_nT, self.b_y_nT, self.b_z_nT])


# Step of the hard iron: a knock, a shackle that shifts, gear that comes or goes.

USUAL_NT = 2000.0  # prior of a step, and of a year's drift: some degrees where the horizontal field is weak


@dataclass(frozen=True)
class HardIronStep(Effect):
    """A horizontal field in the body frame is added from a date on."""

    name = "hard_iron_step"
    words = "the hard iron near the compass changed in a step"
    separated_by: ClassVar[Mapping[str, str]] = {
        "heading_slip": "headings all round on both sides of the date, or the field modulus of the magnetometer",
        "compass_drift": "wider headings, or the field modulus of the magnetometer",
        "hard_iron_drift": "more records around the date",
    }
    recordings = READINGS
    literature = "Poisson's P and Q, a step in time; forward and starboard positive"

    b_x_nT: float = parameter("nT", "step forward", 200.0, usual=USUAL_NT)
    b_y_nT: float = parameter("nT", "step to starboard", 200.0, usual=USUAL_NT)
    date_s: float = date_parameter()

    def apply(self, x: Floats, scene: Scene) -> Floats:
        return x + horizontal_field(self.b_x_nT * scene.since(self.date_s), self.b_y_nT * scene.since(self.date_s))


# Drift of the hard iron: steel that loses or gains magnetisation over the deployment.
@dataclass(frozen=True)
class HardIronDrift(Effect):
    """A horizontal field in the body frame grows with time."""

    name = "hard_iron_drift"
    words = "the hard iron near the compass drifts with time"
    separated_by: ClassVar[Mapping[str, str]] = {
        "compass_drift": "wider headings, or the field modulus of the magnetometer",
        "heading_slip": "wider headings, or the field modulus of the magnetometer",
    }
    literature = "Poisson's P and Q, linear in time; forward and starboard positive"

    b_x_nT_year: float = parameter("nT/year", "rate forward", 200.0, usual=USUAL_NT)
    b_y_nT_year: float = parameter("nT/year", "rate to starboard", 200.0, usual=USUAL_NT)

    def apply(self, x: Floats, scene: Scene) -> Floats:
        return x + horizontal_field(self.b_x_nT_year * scene.years, self.b_y_nT_year * scene.years)


# A battery change: each battery has its own magnetization.
@dataclass(frozen=True)
class BatteryChange(Effect):
    """A horizontal field in the body frame is added from each jump of the supply voltage on, a different one each."""

    name = "battery_change"
    words = "a battery was changed, and with it the iron near the compass"
    literature = "Poisson's P and Q, a step with each battery; forward and starboard positive"
    needs = ("battery_number",)

    b_x_nT: float = parameter("nT", "step forward", 200.0)
    b_y_nT: float = parameter("nT", "step to starboard", 200.0)
    second_x_nT: float = parameter("nT", "step forward at the second change", 200.0)
    second_y_nT: float = parameter("nT", "step to starboard at the second change", 200.0)
    third_x_nT: float = parameter("nT", "step forward at the third change and each later one", 200.0)
    third_y_nT: float = parameter("nT", "step to starboard at the third change and each later one", 200.0)

    def apply(self, x: Floats, scene: Scene) -> Floats:
        """Add the field of the new batteries, which the departure counts."""
        number = scene.departures["battery_number"]
        first, second, third = number.clip(0.0, 1.0), (number - 1.0).clip(0.0, 1.0), (number - 2.0).clip(0.0)
        forward = self.b_x_nT * first + self.second_x_nT * second + self.third_x_nT * third
        return x + horizontal_field(forward, self.b_y_nT * first + self.second_y_nT * second + self.third_y_nT * third)


# Supply voltage: the battery's current and its stray field change as it discharges.
@dataclass(frozen=True)
class SupplyVoltageOfField(Effect):
    """A horizontal field in the body frame is proportional to the change of the supply voltage."""

    name, driver = "supply_voltage", "voltage"
    words = "the compass depends on its supply voltage"
    shows_along = ("supply_voltage",)
    separated_by: ClassVar[Mapping[str, str]] = {
        "hard_iron_drift": "a battery change, or the end of its discharge",
        "compass_drift": "a battery change, or the end of its discharge",
        "hard_iron_step": "more records around the date",
        "heading_slip": "more records around the date",
    }
    stage = "sensor"
    instrument = True
    literature = "stray field of the supply current; forward and starboard positive"
    needs = ("supply_voltage",)

    b_x_nT_V: float = parameter("nT/V", "field forward; V or counts as logged", 100.0)
    b_y_nT_V: float = parameter("nT/V", "field to starboard; V or counts as logged", 100.0)

    def apply(self, x: Floats, scene: Scene) -> Floats:
        volt = scene.departures["supply_voltage"]
        return x + horizontal_field(self.b_x_nT_V * volt, self.b_y_nT_V * volt)


@dataclass(frozen=True)
class SupplyVoltageOfReading(OfReading, Proportional):
    """The reading changes in proportion to the supply voltage."""

    name, driver = "supply_voltage", "voltage"
    instrument = True
    literature = "reference voltage of the readout; clockwise positive"
    needs = ("supply_voltage",)

    deg_V: float = parameter("degrees/V", "change of the reading; V or counts as logged", 0.5)


# Temperature: it changes the magnetometer's zero, the iron near it, or the reading.
@dataclass(frozen=True)
class TemperatureOfField(Effect):
    """A horizontal field in the body frame is proportional to the change of temperature."""

    name, driver = "temperature", "temperature"
    words = "the compass, its iron or the zero of its tilts depends on temperature"
    shows_along = ("temperature",)
    separated_by: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("compass_drift", "hard_iron_drift", "hard_iron_step", "heading_slip", "supply_voltage"),
        "a year more, with another course of the temperature",
    )
    recordings = ("mooring", "magnetometer")
    stage = "sensor"
    instrument = True
    literature = "zero shift of the magnetometer's axes; forward and starboard positive"
    needs = ("temperature",)

    b_x_nT_K: float = parameter("nT/K", "field forward", 200.0)
    b_y_nT_K: float = parameter("nT/K", "field to starboard", 200.0)

    def apply(self, x: Floats, scene: Scene) -> Floats:
        warm = scene.departures["temperature"]
        return x + horizontal_field(self.b_x_nT_K * warm, self.b_y_nT_K * warm)


@dataclass(frozen=True)
class TemperatureOfReading(OfReading, Proportional):
    """The reading changes in proportion to temperature."""

    name, driver = "temperature", "temperature"
    recordings = ("mooring", "magnetometer")
    instrument = True
    literature = "thermal drift of the readout; clockwise positive"
    needs = ("temperature",)

    deg_K: float = parameter("degrees/K", "change of the reading", 1.0)


# Heeling error: the field along the instrument's own vertical gains a horizontal component when it tilts.
@dataclass(frozen=True)
class Heeling(Effect):
    """A constant field along the body's vertical is added; with tilt it affects the heading."""

    name, driver = "heeling", "tilt"
    words = "the compass tilts over iron along its own vertical (heeling error)"
    shows_along = ("pitch", "roll")
    separated_by: ClassVar[Mapping[str, str]] = {
        "tilt_uncompensated": "the magnetometer's three axes with tilt",
        "moving_iron": "the magnetometer's three axes with tilt",
    }
    recordings = ("mooring", "magnetometer", "two_heads")
    instrument = True
    literature = "physics page, section 4: n = T m, so tilt turns b_z into q; left out by von Appen 2015"

    b_z_nT: float = parameter("nT", "field down, induced part (S33 - S11) Z included", 1000.0)

    def apply(self, x: Floats, scene: Scene) -> Floats:
        return x + np.array([0.0, 0.0, self.b_z_nT])


@dataclass(frozen=True)
class HardIronTrend(Effect):
    """A horizontal field in the body frame grows along the record."""

    name = "hard_iron_drift"
    recordings = SHORT_RECORDINGS
    literature = "Poisson's P and Q, a trend in time; forward and starboard positive"

    b_x_nT: float = parameter("nT over the record", "change forward", 200.0)
    b_y_nT: float = parameter("nT over the record", "change to starboard", 200.0)

    def apply(self, x: Floats, scene: Scene) -> Floats:
        return x + horizontal_field(self.b_x_nT * elapsed_share(scene), self.b_y_nT * elapsed_share(scene))


@dataclass(frozen=True)
class LevelHardIron(Effect):
    """Hard iron as seen in a level turn: two components."""

    name, driver = "hard_iron", "heading"
    recordings = ("magnetometer", "two_heads")
    literature = "Poisson's P and Q; Le Menn et al. 2023, eq. (1); forward, starboard positive"

    b_x_nT: float = parameter("nT", "field forward", 200.0)
    b_y_nT: float = parameter("nT", "field to starboard", 200.0)

    def apply(self, x: Floats, scene: Scene) -> Floats:
        return x + np.array([self.b_x_nT, self.b_y_nT, 0.0])


USUAL_SHARE = 0.3  # prior of soft iron, as of a magnetometer next to a battery


@dataclass(frozen=True)
class LevelSoftIron(Effect):
    """Soft iron as seen in the modulus of a level turn, which deforms the circle to an ellipse."""

    name, driver = "soft_iron", "heading"
    words = "a part that the earth's field magnetises distorts it (soft iron)"
    shows_along = ("heading",)
    separated_by: ClassVar[Mapping[str, str]] = {
        "tilt_uncompensated": "logged tilts: a tilt that goes with the heading stretches the circle"
    }
    recordings = ("magnetometer", "two_heads")
    literature = "(a - e)/2 and (d + b)/2 of Poisson; Le Menn et al. 2023, eq. (1)"

    stretch: float = parameter("1", "stretch, (a - e)/2, forward against starboard", 0.02, usual=USUAL_SHARE)
    shear: float = parameter("1", "shear, (d + b)/2", 0.02, usual=USUAL_SHARE)

    def apply(self, x: Floats, scene: Scene) -> Floats:
        rows = [[self.stretch, self.shear, 0.0], [self.shear, -self.stretch, 0.0], [0.0, 0.0, 0.0]]
        return x + x @ np.array(rows)

    @property
    def possible(self) -> bool:
        """Whether no field is reversed, i.e. the ellipse keeps its sense of rotation."""
        return float(np.hypot(self.stretch, self.shear)) < 1.0


@dataclass(frozen=True)
class SoftIronInSpace(Effect):
    """Soft iron as seen in the modulus over all orientations: a symmetric matrix, trace-free as the scale is fitted."""

    name, driver = "soft_iron", "heading"
    recordings = ("magnetometer",)
    literature = "Le Menn et al. 2023, eqs. (1), (2): an ellipsoid shows the symmetric part alone"

    stretch: float = parameter("1", "stretch, (xx - yy)/2, forward against starboard", 0.02, usual=USUAL_SHARE)
    vertical: float = parameter(
        "1", "vertical stretch, zz minus the mean of xx and yy, over 1.5", 0.02, usual=USUAL_SHARE
    )
    xy: float = parameter("1", "shear between forward and starboard", 0.02, usual=USUAL_SHARE)
    xz: float = parameter("1", "shear between forward and down", 0.02, usual=USUAL_SHARE)
    yz: float = parameter("1", "shear between starboard and down", 0.02, usual=USUAL_SHARE)

    def apply(self, x: Floats, scene: Scene) -> Floats:
        return x + x @ self._induced

    @property
    def _induced(self) -> Floats:
        a, v = self.stretch, self.vertical
        return np.array([[a - v / 2.0, self.xy, self.xz], [self.xy, -a - v / 2.0, self.yz], [self.xz, self.yz, v]])

    @property
    def possible(self) -> bool:
        """Whether no field is reversed."""
        return bool(np.linalg.eigvalsh(np.eye(3) + self._induced).min() > 0.0)
