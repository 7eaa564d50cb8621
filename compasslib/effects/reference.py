"""Effects on what a compass is compared with: magnetic north, the current, the reference, a ship's course, clocks.

In the log of a swing, effects of the water act on its velocity, (n, 2) m/s true east and north, effects on time on the
delay of a reading relative to its course, (n,) seconds, and a filter on the heading that the course follows.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from compasslib import angles
from compasslib.effects.effect import additive, date_parameter, make_effect, parameter
from compasslib.types import HOUR_S, Floats

# Magnetic north: secular variation, storms, daily variation, declination errors.
_north = partial(additive, acts_on="north")
_disturbance = partial(_north, name="field_disturbance")

SecularVariation = _north(
    "SecularVariation", "Magnetic north drifts differently from the declination that was applied.",
    lambda term, scene: term.deg_year * scene.years,
    name="secular_variation", recordings=("mooring", "declination"),
    words="magnetic north drifts more than the declination that was applied",
    literature="IGRF's rate of change; east positive",
    deg_year=parameter("degrees/year", "drift beyond what was applied", 1.0, usual=0.5),
)  # fmt: skip

# Storms and daily variation.
FieldDisturbance = _disturbance(
    "FieldDisturbance", "Magnetic north moves by a share of the declination variation recorded at an observatory.",
    driver="observatory", recordings=("mooring", "declination"), needs=("declination_observatory",),
    words="magnetic north moved as the observatory recorded it, most of all on these dates",
    literature="declination of an observatory minus its quiet value; east positive",
    share=parameter("1", "share of the observatory's variation", 1.0),
)  # fmt: skip
VectorDisturbance = _disturbance(
    "VectorDisturbance", "Magnetic north moves by shares of both horizontal components recorded at an observatory.",
    driver="observatory", needs=("declination_observatory", "horizontal_observatory"),
    literature="(dE cos D - dN sin D)/H, a transfer term for either component; east positive",
    across=parameter("1", "share of the observatory's variation across its magnetic north, over H", 1.0),
    along=parameter("1", "share of its variation along magnetic north, over H", 1.0),
)  # fmt: skip
IndexedDisturbance = _disturbance(
    "IndexedDisturbance",
    "The uncertainty of magnetic north grows with a global storm index; its actual variation is unknown.",
    lambda term, scene: term.nT_ap * scene.departures["storm_index"] / scene.horizontal_nT / angles.DEGREE,
    driver="index", detector="directions that scatter more where the index is larger", needs=("storm_index",),
    literature="standard deviation c ap/H (Bartels 1957 for ap); either way",
    nT_ap=parameter("nT", "across magnetic north, one standard deviation a unit of ap", 5.0),
)  # fmt: skip

# Declination error: a wrong number in the metadata.
DeclinationError = _north(
    "DeclinationError", "The declination that was applied has a constant error.", lambda term, _: term.error_deg,
    name="declination_error", driver="", recordings=("mooring", "declination"),
    detector="an observatory's mean against the model",
    words="the declination is off by a constant",
    literature="von Appen 2015, eq. (2): inseparable from A, mean shear and mounting; east positive",
    error_deg=parameter("degrees", "true minus applied declination", 1.0),
)  # fmt: skip

# Between two instruments of a mooring: the water, the reference, clocks.
REFERENCE_DEG = 5.0  # prior of either part of a reference's deviation: up to 6 degrees in a cage (Le Menn 2023)
# The same of its velocities: ten times a maker's accuracy of 0.5 % and 0.5 cm/s (RDI Workhorse).
REFERENCE_GAIN, REFERENCE_BIAS_M_S = 0.05, 0.05
USUAL_DEG = 6.0  # prior of each harmonic: real directional shear ranged from +22 to -7 degrees over flow directions
HIGHER_VEER_DEG = 1.3  # of the third and fourth: amplitudes of 1.7 and 1.8 degrees in 16 pairs of bins (eh2)

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
    literature="von Appen 2015, appendix, assumes none; reference minus affected direction, clockwise",
    deg_s_m=parameter("degrees/(m/s)", "directional shear by speed", 5.0),
)  # fmt: skip
VeerWithSeparation = _veer(
    "VeerWithSeparation", "The directional shear is proportional to the vertical distance between the two depths.",
    driver="separation", needs=("separation",),
    literature="Ekman's spiral, linear over few metres; reference minus affected direction, clockwise",
    deg_m=parameter("degrees/m", "directional shear by metres of separation", 1.0),
)  # fmt: skip
VeerWithDepth = _veer(
    "VeerWithDepth", "The directional shear changes with depth as the mooring is blown down.",
    lambda term, scene: term.deg_100m * scene.departures["depth"] / 100.0,
    driver="depth", needs=("depth",),
    literature="directional shear of the water column, linear in depth; reference minus affected, clockwise",
    deg_100m=parameter("degrees/100 m", "directional shear by depth", 1.0),
)  # fmt: skip
VeerWithDirection = _veer(
    "VeerWithDirection", "The directional shear depends on the direction of the flow.",
    driver="flow_direction",
    needs=(
        "flow_east", "flow_north", "flow_sine2", "flow_cosine2", "flow_sine3", "flow_cosine3", "flow_sine4",
        "flow_cosine4",
    ),
    literature="steering by topography, four harmonics; reference minus affected direction, clockwise",
    sine_deg=parameter("degrees", "part with the sine of the flow's direction", 1.0, usual=USUAL_DEG),
    cosine_deg=parameter("degrees", "part with its cosine", 1.0, usual=USUAL_DEG),
    sine2_deg=parameter("degrees", "part with the sine of its double", 1.0, usual=USUAL_DEG),
    cosine2_deg=parameter("degrees", "part with the cosine of its double", 1.0, usual=USUAL_DEG),
    sine3_deg=parameter("degrees", "part with the sine of its triple", 1.0, usual=HIGHER_VEER_DEG),
    cosine3_deg=parameter("degrees", "part with the cosine of its triple", 1.0, usual=HIGHER_VEER_DEG),
    sine4_deg=parameter("degrees", "part with the sine of its quadruple", 1.0, usual=HIGHER_VEER_DEG),
    cosine4_deg=parameter("degrees", "part with the cosine of its quadruple", 1.0, usual=HIGHER_VEER_DEG),
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
    sine_deg=parameter("degrees", "part with the sine of the reference's heading", 1.0, usual=REFERENCE_DEG),
    cosine_deg=parameter("degrees", "part with its cosine", 1.0, usual=REFERENCE_DEG),
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
    gain=parameter("1", "forward over starboard gain of the reference's beams, less one", 0.035, usual=REFERENCE_GAIN),
)  # fmt: skip


ReferenceBias = _reference(
    "ReferenceBias", "A constant velocity in its own frame is added to the reference's measurements, as by ringing.",
    lambda term, scene: (
        term.starboard_m_s * scene.departures["reference_flow_cosine"]
        - term.forward_m_s * scene.departures["reference_flow_sine"]
    ) / angles.DEGREE,
    name="reference_bias", driver="reference_heading", shows_along=("speed",),
    needs=("reference_flow_sine", "reference_flow_cosine"),
    words="the velocities of the reference have a constant offset in its own frame",
    literature="(bias/speed) sin(angle of the bias - angle of the flow), first order",
    forward_m_s=parameter("m/s", "velocity added forward", 0.003, usual=REFERENCE_BIAS_M_S),
    starboard_m_s=parameter("m/s", "velocity added to starboard", 0.003, usual=REFERENCE_BIAS_M_S),
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

# In a swing: water that carries the ship, and time offsets between courses and readings.
_drift = partial(
    additive,
    name="water_drift", recordings=("swing",), side="water", acts_on="velocity",
    literature="Moncunill et al. 2023, eqs. (29)-(37), not linearised: velocity over ground less that of the water",
)  # fmt: skip
NOT_EARLY = property(lambda term: term.lag_s >= 0.0)  # a negative delay is one of another quantity
_late = partial(
    additive,
    driver="turn_rate", recordings=("swing",), stage="readout", acts_on="time",
    possible=NOT_EARLY,
)  # fmt: skip

SetAndDrift = _drift(
    "SetAndDrift", "A current of constant set and drift carries the ship.", lambda term, _: term.values,
    driver="heading", shows_along=("heading",),
    words="the current carries the vessel sideways, so that its course over ground differs from its heading",
    separated_by={
        "sextantal": "each heading at two speeds, or a log of the speed through the water",
        "octantal": "each heading at two speeds, or a log of the speed through the water",
        "heading_slip": "the first headings swung again at the end",
        "compass_drift": "the first headings swung again at the end",
        "hard_iron_step": "the first headings swung again, each at two speeds",
        "hard_iron_drift": "the first headings swung again, each at two speeds",
    },
    east_m_s=parameter("m/s", "current towards east", 0.05),
    north_m_s=parameter("m/s", "current towards north", 0.05),
)  # fmt: skip
TidalSetAndDrift = _drift(
    "TidalSetAndDrift", "A current that changes linearly along the log carries the ship.",
    lambda term, scene: term.values[:2] + term.values[2:] * (scene.elapsed_share[:, None] - 0.5),
    east_m_s=parameter("m/s", "current towards east in the middle of the log", 0.05),
    north_m_s=parameter("m/s", "current towards north in the middle of the log", 0.05),
    east_gain_m_s=parameter("m/s over the record", "gain towards east", 0.05),
    north_gain_m_s=parameter("m/s over the record", "gain towards north", 0.05),
)  # fmt: skip
LateReading = _late(
    "LateReading", "The reading of the compass is delayed by a constant time.", lambda term, _: term.lag_s,
    name="compass_lag",
    literature="a delay; for slow turns its first order, reading minus lag times the rate of turn",
    lag_s=parameter("s", "time by which the reading is late", 1.0),
)  # fmt: skip
LateCourse = _late(
    "LateCourse",
    "The course over ground is delayed by a constant time, by a receiver's filter or a hull sliding on in a turn.",
    lambda term, _: -term.lag_s,
    name="course_lag", shows_along=("turn_rate",), side="reference",
    words="the course over ground lags: the receiver filters it, and a hull slides on in a turn",
    separated_by={"clock_offset": "headings and courses logged by one clock"},
    literature="a delay; for slow turns its first order, course minus lag times the rate of turn",
    lag_s=parameter("s", "time by which the course is late", 1.0),
)  # fmt: skip
ClocksApart = additive(
    "ClocksApart", "Headings and courses were logged by clocks that differ by a constant.",
    lambda term, _: term.offset_s,
    name="clock_offset", recordings=("swing",), side="clock", stage="clock", acts_on="time",
    literature="time of the compass minus that of the receiver",
    offset_s=parameter("s", "the compass's clock minus the receiver's", 1.0),
)  # fmt: skip


def filter_course(heading_deg: Floats, lag_s: float) -> Floats:
    """Filter headings sampled once per second, not wrapped, (n,) degrees; a negative lag gives a lead."""
    size = abs(lag_s)
    kernel = (size / (1.0 + size)) ** np.arange(int(5.0 * size) + 2) / (1.0 + size)  # five time constants
    unit = angles.phasor(np.concatenate([np.full(len(kernel) - 1, heading_deg[0]), heading_deg]))
    late = angles.difference(angles.argument(np.convolve(unit, kernel, "valid")), heading_deg)
    return np.asarray(heading_deg + np.sign(lag_s) * late)


FilteredCourse = make_effect(
    "FilteredCourse", "The course over ground follows the heading through a first-order low-pass filter.",
    lambda term, x, scene: filter_course(x, term.lag_s),
    name="course_lag", driver="turn_rate", recordings=("swing",), side="reference", stage="readout",
    acts_on="reading", possible=NOT_EARLY,
    literature="a filter of first order of the velocity: a receiver's, or the inertia of a hull",
    lag_s=parameter("s", "mean delay of the filter", 1.0),
)  # fmt: skip
