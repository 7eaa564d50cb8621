"""Plants effects of a wanted visible size in a mooring."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from compasslib.nature import effects_iron as iron
from compasslib.nature import effects_reading as reading
from compasslib.nature import effects_water as water
from compasslib.nature import sealed, visible
from compasslib.nature.effects import Effect, scaled
from compasslib.nature.effects_strange import STRANGE, Maker
from compasslib.nature.sealed import Ground

# By name, every way in which it may come about.
KNOWN: dict[str, tuple[Maker, ...]] = {
    "heeling": (iron.heeling,),
    "hard_iron_drift": (iron.hard_iron_drift,),
    "hard_iron_step": (iron.hard_iron_step,),
    "battery_change": (iron.battery_change,),
    "temperature": (iron.temperature, reading.temperature),
    "supply_voltage": (iron.supply_voltage, reading.supply_voltage),
    "sextantal": (reading.sextantal,),
    "octantal": (reading.octantal,),
    "heading_slip": (reading.heading_slip,),
    "compass_drift": (reading.compass_drift,),
    "compass_lag": (reading.compass_lag,),
    "tilt_uncompensated": (reading.tilt_uncompensated,),
    "stuck_tilt": (reading.stuck_tilt,),
    "current_veer": (water.veer_with_speed, water.veer_with_depth, water.veer_with_direction),
    "clock_offset": (water.clock_offset,),
    "clock_drift": (water.clock_drift,),
    "field_disturbance": (water.field_disturbance,),
}
# Unit sizes beyond which nobody would believe the effect.
STRONGEST = {"heeling": 15.0, "sextantal": 9.0, "octantal": 9.0, "compass_lag": 2.0}
ROUNDS = 3
LEAST_BLOW_DOWN_M = 15.0  # standard deviation of the depth below which no veer with it is planted


@dataclass(frozen=True, eq=False)
class Planted:
    """An effect with the size that is to be seen of it."""

    effect: Effect
    visible_deg: float


def plant(ground: Ground, wanted: Mapping[str, float]) -> tuple[Planted, ...]:
    """Return effects of wanted visible sizes, or of what is believable.

    Args:
        ground: the mooring.
        wanted: rms degrees by name; a clock and a stuck sensor are as large as they are.
    """
    here = sealed.circumstances(ground)
    result = []
    for name, size in wanted.items():
        rng = ground.random(f"effect {name}")
        makers = KNOWN.get(name) or (STRANGE[name],)
        if name == "current_veer" and here.depth_m.std() < LEAST_BLOW_DOWN_M:
            makers = tuple(maker for maker in makers if maker is not water.veer_with_depth)
        made = makers[int(rng.integers(len(makers)))](rng, here)
        result.append(sized(ground, made, size))
    return tuple(result)


def sized(ground: Ground, made: Effect, wanted_deg: float) -> Planted:
    """Return an effect so large that a wanted size can be seen of it.

    Args:
        ground: the mooring.
        made: the effect in its unit size.
        wanted_deg: rms degrees.
    """
    seen = visible.visible_deg(ground, made)
    if not made.grows:
        return Planted(made, seen)
    most, size = STRONGEST.get(made.name, np.inf), 1.0
    for _ in range(ROUNDS):
        size = min(size * float(np.clip(wanted_deg / max(seen, 1e-3), 0.05, 20.0)), most)
        seen = visible.visible_deg(ground, scaled(made, size))
    return Planted(scaled(made, size), seen)
