"""The catalogue of physical effects that a recording may show and its forward model may lack.

Heeling, the effect of vertical iron under tilt: at 3 degrees of roll 2000 nT turn a reading of north by half a degree.

>>> import numpy as np
>>> from compasslib import effects
>>> from compasslib.effects.iron import Heeling
>>> level = np.zeros(1)
>>> scene = effects.Scene(level, level + 12000.0, level + 52000.0, level, level + 3.0, begin_s=0.0)
>>> north = np.array([[12000.0, 0.0, 52000.0]])  # forward, starboard, down in the body, nT
>>> (Heeling(b_z_nT=2000.0).apply(north, scene) - north).tolist()
[[0.0, 0.0, 2000.0]]
>>> effects.SIDES["heeling"], effects.meanings("heeling")
('compass', {'b_z_nT': 'field down'})
"""

from __future__ import annotations

import re
from dataclasses import fields
from functools import cache

from compasslib import plugins
from compasslib.effects import composed, iron, readout, reference
from compasslib.effects.composed import COMPOSED as COMPOSED
from compasslib.effects.effect import Effect as Effect
from compasslib.effects.effect import Scene as Scene
from compasslib.errors import InputError

# Roughly in the order in which they act, with the forms of an effect together; effects of other packages follow.
CATALOGUE: tuple[type[Effect], ...] = (
    *(iron.HardIron, iron.LevelHardIron, iron.LevelSoftIron, iron.SoftIronInSpace, iron.Heeling),
    *(iron.HardIronDrift, iron.HardIronTrend, iron.HardIronStep, iron.BatteryChange),
    *(composed.Pressure, composed.IronMovedByPitch, composed.IronMovedByRoll, readout.LargeDeviation),
    *(reference.FieldDisturbance, reference.VectorDisturbance, reference.IndexedDisturbance),
    *(reference.SecularVariation, reference.DeclinationError),
    *(readout.Sextantal, readout.Octantal),
    *(iron.TemperatureOfField, iron.TemperatureOfReading, readout.TemperatureOfTilt),
    *(iron.SupplyVoltageOfField, iron.SupplyVoltageOfReading),
    *(readout.TiltOffset, readout.TiltUncompensated, readout.ReadingLevelled, readout.StuckTilt),
    *(readout.MountingOffset, readout.HeadingSlip),
    *(readout.CompassDrift, readout.CompassTrend),
    *(readout.CompassLag, readout.CompassDelay, reference.LateReading, composed.PivotFriction),
    *(reference.VeerWithSpeed, reference.VeerWithSeparation, reference.VeerWithDepth, reference.VeerWithDirection),
    *(
        reference.SetAndDrift,
        reference.TidalSetAndDrift,
        reference.LateCourse,
        reference.FilteredCourse,
        reference.MooringMotion,
    ),
    *(composed.BeamGain, composed.VelocityBias),
    *(reference.ReferenceDeviation, reference.ReferenceSlip, reference.ReferenceBeams, reference.ReferenceBias),
    *(reference.ClockOffset, reference.ClocksApart, reference.ClockDrift),
)

SLOW_WATER = "current_shear_slow"  # not a term but part of the noise; listed as the alternative to slow effects
SIDES = {term.name: term.side for term in CATALOGUE} | {SLOW_WATER: "water"}  # side of each effect


@cache
def all_effects() -> tuple[type[Effect], ...]:
    """List the effects of the catalogue and of other packages, which are loaded on the first call.

    Raises:
        InputError: a name is already used, or an entry point does not provide an effect of its name.
    """
    effects = [*CATALOGUE]
    for name, point in plugins.plugin_table(plugins.EFFECTS, SIDES).items():
        term = plugins.load_plugin(point)
        if not (isinstance(term, type) and issubclass(term, Effect) and getattr(term, "name", "") == name):
            where, advice = f"{plugins.package_version(point)}: {point.value}", "see docs/howto/plugins.md"
            raise InputError(where, expected=f"an Effect whose name is {name!r}", found=repr(term), advice=advice)
        effects.append(term)
    return tuple(effects)


def side_of(effect: str) -> str:
    """Look up the side of an effect; that of a composed one, composed:ACTS_ON/DRIVER/FORM, follows from its target.

    Raises:
        KeyError: no such effect.
    """
    if effect.startswith(COMPOSED):
        acts_on = effect.removeprefix(COMPOSED).split("/")[0]
        return "water" if acts_on.startswith("flow") else "clock" if acts_on == "clock" else "compass"
    return SIDES[effect] if effect in SIDES else {term.name: term.side for term in all_effects()}[effect]


def driver_of(effect: str) -> str:
    """Look up the driver of an effect, for a composed one the second part of its name; ``time`` if unknown."""
    if effect.startswith(COMPOSED):
        return effect.split("/")[1]
    return {term.name: term.driver for term in reversed(all_effects())}.get(effect, "time")


def meanings(effect: str) -> dict[str, str]:
    """Describe an effect's parameters by name, without details after a comma or semicolon."""
    forms = [term for term in all_effects() if term.name == effect][::-1]  # a mooring's, the first, counts
    return {part.name: re.split("[,;]", part.metadata["meaning"])[0] for form in forms for part in fields(form)}
