"""Effects of iron in the body frame: hard and soft iron, steps, drifts, batteries, temperature, heeling."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from compasslib.effects import effect
from compasslib.effects.effect import READINGS, SHORT_RECORDINGS, Effect, Scene, additive, parameter
from compasslib.types import Floats

USUAL_NT = 2000.0  # prior of a step, and of a year's drift: some degrees where the horizontal field is weak
USUAL_SHARE = 0.3  # prior of soft iron, as of a magnetometer next to a battery


def _horizontal(series: Floats, term: Effect) -> Floats:
    """Multiply a series, (n,), by the fields forward and to starboard that are the term's parameters, (n, 3)."""
    return np.column_stack([value * series for value in term.values] + [np.zeros(len(series))])


HardIron = additive(
    "HardIron", "A constant field in the body frame is added.", lambda term, _: term.values,
    name="hard_iron", driver="heading", shows_along=("heading",),
    words="a magnetised part that turns with the instrument adds a constant field (hard iron)",
    separated_by={"tilt_uncompensated": "logged tilts: a mean tilt in the vertical field looks like hard iron"},
    literature="Poisson's P, Q, R; Le Menn et al. 2023, eq. (1); forward, starboard, down positive",
    recordings=("magnetometer",),  # elsewhere B and C of the fitted curve hold it
    b_x_nT=parameter("nT", "field forward", 200.0),
    b_y_nT=parameter("nT", "field to starboard", 200.0),
    b_z_nT=parameter("nT", "field down", 2000.0),
)  # fmt: skip

LevelHardIron = additive(
    "LevelHardIron", "Hard iron as seen in a level turn: two components.",
    lambda term, _: np.append(term.values, 0.0),
    name="hard_iron", driver="heading", recordings=("magnetometer", "two_heads"),
    literature="Poisson's P and Q; Le Menn et al. 2023, eq. (1); forward, starboard positive",
    b_x_nT=parameter("nT", "field forward", 200.0),
    b_y_nT=parameter("nT", "field to starboard", 200.0),
)  # fmt: skip

# Step of the hard iron: a knock, a shackle that shifts, gear that comes or goes.
HardIronStep = additive(
    "HardIronStep", "A horizontal field in the body frame is added from a date on.",
    lambda term, scene: _horizontal(scene.since(term.date_s), term),
    name="hard_iron_step", recordings=READINGS,
    words="the hard iron near the compass changed in a step",
    separated_by={
        "heading_slip": "headings all round on both sides of the date, or the field modulus of the magnetometer",
        "compass_drift": "wider headings, or the field modulus of the magnetometer",
        "hard_iron_drift": "more records around the date",
    },
    literature="Poisson's P and Q, a step in time; forward and starboard positive",
    b_x_nT=parameter("nT", "step forward", 200.0, usual=USUAL_NT),
    b_y_nT=parameter("nT", "step to starboard", 200.0, usual=USUAL_NT),
    date_s=effect.date_parameter(),
)  # fmt: skip

# Drift of the hard iron: steel that loses or gains magnetisation over the deployment.
HardIronDrift = additive(
    "HardIronDrift", "A horizontal field in the body frame grows with time.",
    lambda term, scene: _horizontal(scene.years, term),
    name="hard_iron_drift",
    words="the hard iron near the compass drifts with time",
    separated_by=dict.fromkeys(
        ("compass_drift", "heading_slip"), "wider headings, or the field modulus of the magnetometer"
    ),
    literature="Poisson's P and Q, linear in time; forward and starboard positive",
    b_x_nT_year=parameter("nT/year", "rate forward", 200.0, usual=USUAL_NT),
    b_y_nT_year=parameter("nT/year", "rate to starboard", 200.0, usual=USUAL_NT),
)  # fmt: skip

HardIronTrend = additive(
    "HardIronTrend", "A horizontal field in the body frame grows along the record.",
    lambda term, scene: _horizontal(scene.elapsed_share, term),
    name="hard_iron_drift", recordings=SHORT_RECORDINGS,
    literature="Poisson's P and Q, a trend in time; forward and starboard positive",
    b_x_nT=parameter("nT over the record", "change forward", 200.0),
    b_y_nT=parameter("nT over the record", "change to starboard", 200.0),
)  # fmt: skip


def _batteries(term: Any, scene: Scene) -> Floats:
    """Compute the field of the new batteries, which the departure counts."""
    number = scene.departures["battery_number"]
    changes = np.stack([number.clip(0.0, 1.0), (number - 1.0).clip(0.0, 1.0), (number - 2.0).clip(0.0)], axis=1)
    return np.column_stack([changes @ term.values.reshape(3, 2), np.zeros(len(number))])


# A battery change: each battery has its own magnetization.
BatteryChange = additive(
    "BatteryChange",
    "A horizontal field in the body frame is added from each jump of the supply voltage on, a different one each.",
    _batteries,
    name="battery_change", needs=("battery_number",),
    words="a battery was changed, and with it the iron near the compass",
    literature="Poisson's P and Q, a step with each battery; forward and starboard positive",
    b_x_nT=parameter("nT", "step forward", 200.0),
    b_y_nT=parameter("nT", "step to starboard", 200.0),
    second_x_nT=parameter("nT", "step forward at the second change", 200.0),
    second_y_nT=parameter("nT", "step to starboard at the second change", 200.0),
    third_x_nT=parameter("nT", "step forward at the third change and each later one", 200.0),
    third_y_nT=parameter("nT", "step to starboard at the third change and each later one", 200.0),
)  # fmt: skip

# Supply voltage: the battery's current and its stray field change as it discharges.
_voltage = partial(
    additive, name="supply_voltage", driver="voltage", needs=("supply_voltage",), stage="sensor", instrument=True
)
SupplyVoltageOfField = _voltage(
    "SupplyVoltageOfField",
    "A horizontal field in the body frame is proportional to the change of the supply voltage.",
    lambda term, scene: _horizontal(scene.departures["supply_voltage"], term),
    words="the compass depends on its supply voltage",
    shows_along=("supply_voltage",),
    separated_by={
        "hard_iron_drift": "a battery change, or the end of its discharge",
        "compass_drift": "a battery change, or the end of its discharge",
        "hard_iron_step": "more records around the date",
        "heading_slip": "more records around the date",
    },
    literature="stray field of the supply current; forward and starboard positive",
    b_x_nT_V=parameter("nT/V", "field forward; V or counts as logged", 100.0),
    b_y_nT_V=parameter("nT/V", "field to starboard; V or counts as logged", 100.0),
)
SupplyVoltageOfReading = _voltage(
    "SupplyVoltageOfReading", "The reading changes in proportion to the supply voltage.",
    stage="readout", acts_on="reading",
    literature="reference voltage of the readout; clockwise positive",
    deg_V=parameter("degrees/V", "change of the reading; V or counts as logged", 0.5),
)  # fmt: skip

# Temperature: it changes the magnetometer's zero, the iron near it, or the reading.
_temperature = partial(
    additive,
    name="temperature", driver="temperature", needs=("temperature",), stage="sensor", instrument=True,
    recordings=("mooring", "magnetometer"),
)  # fmt: skip
TemperatureOfField = _temperature(
    "TemperatureOfField", "A horizontal field in the body frame is proportional to the change of temperature.",
    lambda term, scene: _horizontal(scene.departures["temperature"], term),
    shows_along=("temperature",),
    words="the compass, its iron or the zero of its tilts depends on temperature",
    separated_by=dict.fromkeys(
        ("compass_drift", "hard_iron_drift", "hard_iron_step", "heading_slip", "supply_voltage"),
        "a year more, with another course of the temperature",
    ),
    literature="zero shift of the magnetometer's axes; forward and starboard positive",
    b_x_nT_K=parameter("nT/K", "field forward", 200.0),
    b_y_nT_K=parameter("nT/K", "field to starboard", 200.0),
)  # fmt: skip
TemperatureOfReading = _temperature(
    "TemperatureOfReading", "The reading changes in proportion to temperature.",
    stage="readout", acts_on="reading",
    literature="thermal drift of the readout; clockwise positive",
    deg_K=parameter("degrees/K", "change of the reading", 1.0),
)  # fmt: skip

# Heeling error: the field along the instrument's own vertical gains a horizontal component when it tilts.
Heeling = additive(
    "Heeling", "A constant field along the body's vertical is added; with tilt it affects the heading.",
    lambda term, _: np.array([0.0, 0.0, term.b_z_nT]),
    name="heeling", driver="tilt", shows_along=("pitch", "roll"), recordings=("mooring", "magnetometer", "two_heads"),
    instrument=True,
    words="the compass tilts over iron along its own vertical (heeling error)",
    separated_by=dict.fromkeys(("tilt_uncompensated", "moving_iron"), "the magnetometer's three axes with tilt"),
    literature="Poisson's equations with tilt: n = T m, so tilt turns b_z into q; left out by von Appen 2015",
    b_z_nT=parameter("nT", "field down, induced part (S33 - S11) Z included", 1000.0),
)  # fmt: skip


def _soft_iron(title: str, summary: str, induced: Callable[[Any], Floats], **members: Any) -> type[Any]:
    """Create the class of an effect of fields induced by a symmetric matrix, trace-free as the scale is fitted."""
    return effect.make_effect(
        title, summary, lambda term, x, scene: x + x @ induced(term), name="soft_iron", driver="heading",
        possible=property(lambda term: bool(np.linalg.eigvalsh(np.eye(3) + induced(term)).min() > 0.0)),
        **members,
    )  # fmt: skip


LevelSoftIron = _soft_iron(
    "LevelSoftIron", "Soft iron as seen in the modulus of a level turn, which deforms the circle to an ellipse.",
    lambda term: np.array([[term.stretch, term.shear, 0.0], [term.shear, -term.stretch, 0.0], [0.0, 0.0, 0.0]]),
    shows_along=("heading",), recordings=("magnetometer", "two_heads"),
    words="a part that the earth's field magnetises distorts it (soft iron)",
    separated_by={"tilt_uncompensated": "logged tilts: a tilt that goes with the heading stretches the circle"},
    literature="(a - e)/2 and (d + b)/2 of Poisson; Le Menn et al. 2023, eq. (1)",
    stretch=parameter("1", "stretch, (a - e)/2, forward against starboard", 0.02, usual=USUAL_SHARE),
    shear=parameter("1", "shear, (d + b)/2", 0.02, usual=USUAL_SHARE),
)  # fmt: skip
SoftIronInSpace = _soft_iron(
    "SoftIronInSpace",
    "Soft iron as seen in the modulus over all orientations: a symmetric matrix, trace-free as the scale is fitted.",
    lambda term: np.array([
        [term.stretch - term.vertical / 2.0, term.xy, term.xz],
        [term.xy, -term.stretch - term.vertical / 2.0, term.yz],
        [term.xz, term.yz, term.vertical],
    ]),
    recordings=("magnetometer",),
    literature="Le Menn et al. 2023, eqs. (1), (2): an ellipsoid shows the symmetric part alone",
    stretch=parameter("1", "stretch, (xx - yy)/2, forward against starboard", 0.02, usual=USUAL_SHARE),
    vertical=parameter("1", "vertical stretch, zz minus the mean of xx and yy, over 1.5", 0.02, usual=USUAL_SHARE),
    xy=parameter("1", "shear between forward and starboard", 0.02, usual=USUAL_SHARE),
    xz=parameter("1", "shear between forward and down", 0.02, usual=USUAL_SHARE),
    yz=parameter("1", "shear between starboard and down", 0.02, usual=USUAL_SHARE),
)  # fmt: skip
