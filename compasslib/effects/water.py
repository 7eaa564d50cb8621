"""Effects on the comparison and not on the compass: water between the two depths, the reference, clocks."""

from __future__ import annotations

from dataclasses import dataclass

from compasslib import angles
from compasslib.effects.effect import Effect, Proportional, Scene, date_parameter, parameter
from compasslib.types import Floats

USUAL_DEG = 6.0  # prior of each harmonic: real directional shear ranged from +22 to -7 degrees over flow directions


@dataclass(frozen=True)
class VeerWithSpeed(Proportional):
    """The directional shear between the two depths changes in proportion to the speed of the flow."""

    name, driver = "current_veer", "speed"
    words = "directional shear of the current between the two depths"
    shows_along = ("speed", "separation", "depth")
    side = "water"
    acts_on = "water"
    literature = "von Appen 2015, appendix, assumes none; lower minus upper direction, clockwise"
    needs = ("speed",)

    deg_s_m: float = parameter("degrees/(m/s)", "directional shear by speed", 5.0)


@dataclass(frozen=True)
class VeerWithSeparation(Proportional):
    """The directional shear is proportional to the vertical distance between the two depths."""

    name, driver = "current_veer", "separation"
    side = "water"
    acts_on = "water"
    literature = "Ekman's spiral, linear over few metres; lower minus upper direction, clockwise"
    needs = ("separation",)

    deg_m: float = parameter("degrees/m", "directional shear by metres of separation", 1.0)


@dataclass(frozen=True)
class VeerWithDepth(Effect):
    """The directional shear changes with depth as the mooring is blown down."""

    name, driver = "current_veer", "depth"
    side = "water"
    acts_on = "water"
    literature = "directional shear of the water column, linear in depth; lower minus upper, clockwise"
    needs = ("depth",)

    deg_100m: float = parameter("degrees/100 m", "directional shear by depth", 1.0)

    def apply(self, x: Floats, scene: Scene) -> Floats:
        return x + self.deg_100m * scene.departures["depth"] / 100.0


@dataclass(frozen=True)
class VeerWithDirection(Proportional):
    """The directional shear depends on the direction of the flow."""

    name, driver = "current_veer", "flow_direction"
    side = "water"
    acts_on = "water"
    literature = "steering by topography, two harmonics; lower minus upper direction, clockwise"
    needs = ("flow_east", "flow_north", "flow_sine2", "flow_cosine2")

    sine_deg: float = parameter("degrees", "part with the sine of the flow's direction", 1.0, usual=USUAL_DEG)
    cosine_deg: float = parameter("degrees", "part with its cosine", 1.0, usual=USUAL_DEG)
    sine2_deg: float = parameter("degrees", "part with the sine of its double", 1.0, usual=USUAL_DEG)
    cosine2_deg: float = parameter("degrees", "part with the cosine of its double", 1.0, usual=USUAL_DEG)


# Motion of the mooring: the sphere is displaced as the flow changes.
@dataclass(frozen=True)
class MooringMotion(Proportional):
    """The instrument's own velocity is missing from the measured current, across the flow when its direction turns."""

    name, driver = "mooring_motion", "motion"
    words = "the mooring's own motion is in the measured current"
    shows_along = ("speed",)
    side = "water"
    acts_on = "water"
    literature = "excursion proportional to speed squared; true minus measured direction, clockwise"
    needs = ("excursion_turn",)

    m_s2_m2: float = parameter("m/(m/s)^2", "excursion by speed squared", 200.0)


# Faults of the reference: of its own compass, and of its beams.
@dataclass(frozen=True)
class OfReference(Effect):
    """An effect that rotates the reference's directions, modelled like a veer of the water."""

    side = "reference"
    acts_on = "water"


@dataclass(frozen=True)
class ReferenceDeviation(OfReference, Proportional):
    """The reference's compass has a deviation of its own."""

    name, driver = "reference_deviation", "reference_heading"
    words = "the compass of the reference has a deviation of its own"
    shows_along = ("reference_heading",)
    literature = "B and C of von Appen 2015, eq. (1), by its own heading; reading minus true"
    needs = ("reference_sine", "reference_cosine")

    sine_deg: float = parameter("degrees", "part with the sine of the reference's heading", 1.0)
    cosine_deg: float = parameter("degrees", "part with its cosine", 1.0)


@dataclass(frozen=True)
class ReferenceSlip(OfReference):
    """The reference's directions are shifted from a date on: its mount slipped, or its iron changed."""

    name = "reference_slip"
    words = "the directions of the reference have a step: its mount slipped, or iron came or went beside it"
    literature = "a step of the reference's directions; clockwise positive"

    offset_deg: float = parameter("degrees", "turn of the reference's directions after the date", 1.0, usual=10.0)
    date_s: float = date_parameter()

    def apply(self, x: Floats, scene: Scene) -> Floats:
        return x + self.offset_deg * scene.since(self.date_s)


@dataclass(frozen=True)
class ReferenceBeams(OfReference):
    """One beam pair of the reference measures larger velocities than the other."""

    name, driver = "reference_beams", "reference_heading"
    words = "the beams of the reference are of unequal gain"
    shows_along = ("reference_heading",)
    literature = "-(gain/2) sin 2(flow - heading), first order; forward over starboard gain less one"
    needs = ("reference_flow_sine2",)

    gain: float = parameter("1", "forward over starboard gain of the reference's beams, less one", 0.035)

    def apply(self, x: Floats, scene: Scene) -> Floats:
        return x - self.gain / 2.0 / angles.DEGREE * scene.departures[self.needs[0]]


@dataclass(frozen=True)
class ReferenceBias(OfReference):
    """A constant velocity in its own frame is added to the reference's measurements, as by ringing."""

    name, driver = "reference_bias", "reference_heading"
    words = "the velocities of the reference have a constant offset in its own frame"
    shows_along = ("speed",)
    literature = "(bias/speed) sin(angle of the bias - angle of the flow), first order"
    needs = ("reference_flow_sine", "reference_flow_cosine")

    forward_m_s: float = parameter("m/s", "velocity added forward", 0.003)
    starboard_m_s: float = parameter("m/s", "velocity added to starboard", 0.003)

    def apply(self, x: Floats, scene: Scene) -> Floats:
        """Add the veer; the departures are sine and cosine of the flow's angle in the body frame, over the speed."""
        sine, cosine = (scene.departures[name] for name in self.needs)
        return x + (self.starboard_m_s * cosine - self.forward_m_s * sine) / angles.DEGREE


@dataclass(frozen=True)
class ClockOffset(Effect):
    """The affected instrument's clock is ahead of the reference's by a constant."""

    name = "clock_offset"
    words = "the two clocks differ"
    shows_along = ("turn_rate",)
    side = "clock"
    stage = "clock"
    acts_on = "time"
    literature = "instrument clock minus UTC, positive ahead"
    recordings = ("mooring", "two_heads")
    detector = "speeds or tilts of both, which have no compass in them"

    hours: float = parameter("h", "affected minus reference clock", 0.3)

    def apply(self, x: Floats, scene: Scene) -> Floats:
        return x + 3600.0 * self.hours


@dataclass(frozen=True)
class ClockDrift(Effect):
    """The affected instrument's clock gains relative to the reference's at a constant rate."""

    name = "clock_drift"
    words = "the two clocks drift apart"
    side = "clock"
    stage = "clock"
    acts_on = "time"
    literature = "instrument clock minus UTC, growing from the beginning, positive ahead"
    recordings = ("mooring", "two_heads")
    detector = "speeds or tilts of both, which have no compass in them"

    hours_year: float = parameter("h/year", "gain of the affected clock", 0.3)

    def apply(self, x: Floats, scene: Scene) -> Floats:
        return x + 3600.0 * self.hours_year * scene.years
