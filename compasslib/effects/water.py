"""Effects on the comparison and not on the compass: water between the two depths, the reference, clocks."""

from __future__ import annotations

from functools import partial
from typing import Any

from compasslib import angles
from compasslib.effects.effect import Scene, additive, date_parameter, parameter
from compasslib.types import HOUR_S, Floats

USUAL_DEG = 6.0  # prior of each harmonic: real directional shear ranged from +22 to -7 degrees over flow directions

_veer = partial(additive, name="current_veer", side="water", acts_on="water")
_reference = partial(additive, side="reference", acts_on="water")  # turns the reference's directions like a veer
_clock = partial(
    additive,
    side="clock", stage="clock", acts_on="time", recordings=("mooring", "two_heads"),
    detector="speeds or tilts of both, which have no compass in them",
)  # fmt: skip

VeerWithSpeed = _veer(
    "VeerWithSpeed", "The directional shear between the two depths changes in proportion to the speed of the flow.",
    driver="speed", shows_along=("speed", "separation", "depth"), needs=("speed",),
    words="directional shear of the current between the two depths",
    literature="von Appen 2015, appendix, assumes none; lower minus upper direction, clockwise",
    deg_s_m=parameter("degrees/(m/s)", "directional shear by speed", 5.0),
)  # fmt: skip
VeerWithSeparation = _veer(
    "VeerWithSeparation", "The directional shear is proportional to the vertical distance between the two depths.",
    driver="separation", needs=("separation",),
    literature="Ekman's spiral, linear over few metres; lower minus upper direction, clockwise",
    deg_m=parameter("degrees/m", "directional shear by metres of separation", 1.0),
)  # fmt: skip
VeerWithDepth = _veer(
    "VeerWithDepth", "The directional shear changes with depth as the mooring is blown down.",
    lambda term, scene: term.deg_100m * scene.departures["depth"] / 100.0,
    driver="depth", needs=("depth",),
    literature="directional shear of the water column, linear in depth; lower minus upper, clockwise",
    deg_100m=parameter("degrees/100 m", "directional shear by depth", 1.0),
)  # fmt: skip
VeerWithDirection = _veer(
    "VeerWithDirection", "The directional shear depends on the direction of the flow.",
    driver="flow_direction", needs=("flow_east", "flow_north", "flow_sine2", "flow_cosine2"),
    literature="steering by topography, two harmonics; lower minus upper direction, clockwise",
    sine_deg=parameter("degrees", "part with the sine of the flow's direction", 1.0, usual=USUAL_DEG),
    cosine_deg=parameter("degrees", "part with its cosine", 1.0, usual=USUAL_DEG),
    sine2_deg=parameter("degrees", "part with the sine of its double", 1.0, usual=USUAL_DEG),
    cosine2_deg=parameter("degrees", "part with the cosine of its double", 1.0, usual=USUAL_DEG),
)  # fmt: skip

# Motion of the mooring: the sphere is displaced as the flow changes.
MooringMotion = additive(
    "MooringMotion",
    "The instrument's own velocity is missing from the measured current, across the flow when its direction turns.",
    name="mooring_motion", driver="motion", shows_along=("speed",), side="water", acts_on="water",
    needs=("excursion_turn",),
    words="the mooring's own motion is in the measured current",
    literature="excursion proportional to speed squared; true minus measured direction, clockwise",
    m_s2_m2=parameter("m/(m/s)^2", "excursion by speed squared", 200.0),
)  # fmt: skip

# Faults of the reference: of its own compass, and of its beams.
ReferenceDeviation = _reference(
    "ReferenceDeviation", "The reference's compass has a deviation of its own.",
    name="reference_deviation", driver="reference_heading", shows_along=("reference_heading",),
    needs=("reference_sine", "reference_cosine"),
    words="the compass of the reference has a deviation of its own",
    literature="B and C of von Appen 2015, eq. (1), by its own heading; reading minus true",
    sine_deg=parameter("degrees", "part with the sine of the reference's heading", 1.0),
    cosine_deg=parameter("degrees", "part with its cosine", 1.0),
)  # fmt: skip
ReferenceSlip = _reference(
    "ReferenceSlip", "The reference's directions are shifted from a date on: its mount slipped, or its iron changed.",
    lambda term, scene: term.offset_deg * scene.since(term.date_s),
    name="reference_slip",
    words="the directions of the reference have a step: its mount slipped, or iron came or went beside it",
    literature="a step of the reference's directions; clockwise positive",
    offset_deg=parameter("degrees", "turn of the reference's directions after the date", 1.0, usual=10.0),
    date_s=date_parameter(),
)  # fmt: skip
ReferenceBeams = _reference(
    "ReferenceBeams", "One beam pair of the reference measures larger velocities than the other.",
    lambda term, scene: -term.gain / 2.0 / angles.DEGREE * scene.departures["reference_flow_sine2"],
    name="reference_beams", driver="reference_heading", shows_along=("reference_heading",),
    needs=("reference_flow_sine2",),
    words="the beams of the reference are of unequal gain",
    literature="-(gain/2) sin 2(flow - heading), first order; forward over starboard gain less one",
    gain=parameter("1", "forward over starboard gain of the reference's beams, less one", 0.035),
)  # fmt: skip


def _bias(term: Any, scene: Scene) -> Floats:
    """Compute the veer; the departures are sine and cosine of the flow's angle in the body frame, over the speed."""
    sine, cosine = (scene.departures[name] for name in term.needs)
    return (term.starboard_m_s * cosine - term.forward_m_s * sine) / angles.DEGREE


ReferenceBias = _reference(
    "ReferenceBias", "A constant velocity in its own frame is added to the reference's measurements, as by ringing.",
    _bias,
    name="reference_bias", driver="reference_heading", shows_along=("speed",),
    needs=("reference_flow_sine", "reference_flow_cosine"),
    words="the velocities of the reference have a constant offset in its own frame",
    literature="(bias/speed) sin(angle of the bias - angle of the flow), first order",
    forward_m_s=parameter("m/s", "velocity added forward", 0.003),
    starboard_m_s=parameter("m/s", "velocity added to starboard", 0.003),
)  # fmt: skip

ClockOffset = _clock(
    "ClockOffset", "The affected instrument's clock is ahead of the reference's by a constant.",
    lambda term, _: HOUR_S * term.hours,
    name="clock_offset", shows_along=("turn_rate",),
    words="the two clocks differ",
    literature="instrument clock minus UTC, positive ahead",
    hours=parameter("h", "affected minus reference clock", 0.3),
)  # fmt: skip
ClockDrift = _clock(
    "ClockDrift", "The affected instrument's clock gains relative to the reference's at a constant rate.",
    lambda term, scene: HOUR_S * term.hours_year * scene.years,
    name="clock_drift",
    words="the two clocks drift apart",
    literature="instrument clock minus UTC, growing from the beginning, positive ahead",
    hours_year=parameter("h/year", "gain of the affected clock", 0.3),
)  # fmt: skip
