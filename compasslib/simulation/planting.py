"""Plants effects of a wanted visible size in a mooring."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from compasslib.simulation import effects_known as iron
from compasslib.simulation import effects_known as reading
from compasslib.simulation import effects_known as water
from compasslib.simulation import readings, sealed
from compasslib.simulation import water as sea
from compasslib.simulation.effects import Effect, scaled, total
from compasslib.simulation.effects_strange import STRANGE, Maker
from compasslib.simulation.sealed import Ground
from compasslib.simulation.series import Complexes, Floats, direction

# By name, every way in which it may come about.
KNOWN: dict[str, tuple[Maker, ...]] = {
    "heeling": (iron.heeling,),
    "hard_iron_drift": (iron.hard_iron_drift,),
    "hard_iron_step": (iron.hard_iron_step,),
    "battery_change": (iron.battery_change,),
    "temperature": (iron.temperature, reading.temperature_of_reading),
    "supply_voltage": (iron.supply_voltage, reading.voltage_of_reading),
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
        made: the effect in its unit size.
        wanted_deg: rms degrees.
    """
    seen = visible_rms_deg(ground, made)
    if not made.grows:
        return Planted(made, seen)
    most, size = STRONGEST.get(made.name, np.inf), 1.0
    for _ in range(ROUNDS):
        size = min(size * float(np.clip(wanted_deg / max(seen, 1e-3), 0.05, 20.0)), most)
        seen = visible_rms_deg(ground, scaled(made, size))
    return Planted(scaled(made, size), seen)


# How much of an effect can be seen: what is left of it after five coefficients were fitted to the true headings.

EVERY = 3  # hours: the size of an effect needs no more
ITERATIONS = 12
STEADIEST = 0.2  # slope of the recorded over the correct heading below which a deviation is not blown up further


def left_deg(recorded_deg: Floats, heading_deg: Floats) -> Floats:
    """Return the error of the heading that the best compass of five coefficients leaves, degrees, (n,).

    Args:
        recorded_deg: readings, (n,).
        heading_deg: correct headings, (n,).
    """
    w = np.exp(1j * np.deg2rad(heading_deg))
    columns = np.stack([-1j * w, np.ones_like(w), -1j * np.ones_like(w), 1.0 / w, -1j / w], axis=1)
    values = np.zeros(5)
    for _ in range(ITERATIONS):
        q = w + columns @ values
        miss = _turn(recorded_deg, np.rad2deg(np.angle(q)))
        values = values + np.linalg.lstsq(np.imag(columns / q[:, None]), miss, rcond=None)[0]
    q = w + columns @ values
    slope = np.real((w + columns[:, 0] * values[0] - columns[:, 3] * values[3] - columns[:, 4] * values[4]) / q)
    return np.rad2deg(_turn(recorded_deg, np.rad2deg(np.angle(q)))) / np.maximum(slope, STEADIEST)


def visible_rms_deg(ground: Ground, effect: Effect) -> float:
    """Return the visible size of one effect alone, rms degrees.

    Args:
        effect: what is planted.
    """
    if effect.ahead_s is not None:
        return _clock_deg(ground, effect.ahead_s)
    bare, with_it = (_ideal(ground, planted) for planted in ((), (effect,)))
    return float(np.std(with_it - bare))


def background_deg(ground: Ground) -> float:
    """Return what five coefficients leave where nothing is planted, rms degrees."""
    return float(np.std(_ideal(ground, ())))


def _ideal(ground: Ground, effects: Sequence[Effect]) -> Floats:
    made = readings.read(ground, effects, ground.stamp_s)
    # Water that veers clockwise at the trusted instrument looks like a compass that reads too little.
    seen = made.recorded_deg - total(effects, "veer_deg", np.zeros(ground.stamp_s.size))
    return left_deg(seen[::EVERY], made.heading_deg[::EVERY])


def _clock_deg(ground: Ground, ahead_s: Floats) -> float:
    """Return by how much the direction that is paired moves, robustly: slow water may point anywhere."""
    stamps = ground.stamp_s
    at = [direction(_flow(ground, when)) for when in (stamps, stamps - ahead_s)]
    return float(1.4826 * np.median(np.abs(np.rad2deg(_turn(at[1], at[0])))))


def _flow(ground: Ground, time_s: Floats) -> Complexes:
    depth = np.interp(time_s, ground.motion.time_s, ground.motion.sphere_depth_m)
    return sea.velocity(ground.currents, time_s, depth, depth)


def _turn(a_deg: Floats, b_deg: Floats) -> Floats:
    """Return a - b in radians, the short way."""
    return np.asarray(np.angle(np.exp(1j * np.deg2rad(a_deg - b_deg))))
