"""The catalogue of physics that a recording may show and its simulation may lack."""

from __future__ import annotations

import re
from dataclasses import fields

from compasslib.physics.battery_change import BatteryChange
from compasslib.physics.clock_drift import ClockDrift
from compasslib.physics.clock_offset import ClockOffset
from compasslib.physics.compass_drift import CompassDrift
from compasslib.physics.compass_lag import CompassLag
from compasslib.physics.course_lag import CourseLag
from compasslib.physics.current_veer import VeerWithDepth, VeerWithDirection, VeerWithSeparation, VeerWithSpeed
from compasslib.physics.declination_error import DeclinationError
from compasslib.physics.field_disturbance import FieldDisturbance
from compasslib.physics.hard_iron import HardIron
from compasslib.physics.hard_iron_drift import HardIronDrift
from compasslib.physics.hard_iron_step import HardIronStep
from compasslib.physics.heading_slip import HeadingSlip
from compasslib.physics.heeling import Heeling
from compasslib.physics.large_deviation import LargeDeviation
from compasslib.physics.mooring_motion import MooringMotion
from compasslib.physics.octantal import Octantal
from compasslib.physics.rotation_rate import RotationRate
from compasslib.physics.secular_variation import SecularVariation
from compasslib.physics.sextantal import Sextantal
from compasslib.physics.soft_iron import SoftIron
from compasslib.physics.stuck_tilt import StuckTilt, StuckTiltOfLean
from compasslib.physics.supply_voltage import SupplyVoltageOfField, SupplyVoltageOfReading
from compasslib.physics.temperature import TemperatureOfField, TemperatureOfReading
from compasslib.physics.term import Scene, Term
from compasslib.physics.tilt_uncompensated import TiltUncompensated
from compasslib.physics.water_drift import WaterDrift

__all__ = ["CATALOGUE", "SIDES", "Scene", "Term", "meanings"]

# In the order in which they act: surroundings, sensor, readout, then water and clocks.
CATALOGUE: tuple[type[Term], ...] = (
    HardIron,
    SoftIron,
    Heeling,
    HardIronDrift,
    HardIronStep,
    BatteryChange,
    LargeDeviation,
    FieldDisturbance,
    SecularVariation,
    DeclinationError,
    TemperatureOfField,
    SupplyVoltageOfField,
    RotationRate,
    TiltUncompensated,
    StuckTilt,
    StuckTiltOfLean,
    Sextantal,
    Octantal,
    TemperatureOfReading,
    SupplyVoltageOfReading,
    HeadingSlip,
    CompassDrift,
    CompassLag,
    VeerWithSpeed,
    VeerWithSeparation,
    VeerWithDepth,
    VeerWithDirection,
    WaterDrift,
    CourseLag,
    MooringMotion,
    ClockOffset,
    ClockDrift,
)

SIDES = {term.name: term.side for term in CATALOGUE}  # what each effect acts on


def meanings(effect: str) -> dict[str, str]:
    """Return what an effect's parameters are, by their names, without the details behind a comma.

    Args:
        effect: its name.
    """
    terms = [term for term in CATALOGUE if term.name == effect]
    return {one.name: re.split("[,;]", one.metadata["meaning"])[0] for term in terms for one in fields(term)}
