"""Plants effects of a wanted visible size in a mooring: those of the catalogue, and those that have no name in it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from compasslib.simulation import adcp, readings, sealed
from compasslib.simulation import water as sea
from compasslib.simulation.effects import Circumstances, Effect, scaled, steps, total
from compasslib.simulation.sealed import Ground
from compasslib.simulation.series import DAY_S, HOUR_S, Complexes, Floats, clockwise, direction, red_noise

# Unit sizes beyond which nobody would believe the effect.
STRONGEST = {"heeling": 15.0, "sextantal": 9.0, "octantal": 9.0, "compass_lag": 2.0}
ROUNDS = 3
LEAST_BLOW_DOWN_M = 15.0  # standard deviation of the depth below which no veer with it is planted
EVERY = 3  # hours: the size of an effect needs no more
ITERATIONS = 12
STEADIEST = 0.2  # slope of the recorded over the correct heading below which a deviation is not blown up further
UNIT_NT = 200.0
OBSERVED_NT = 14000.0  # horizontal field of an observatory

# Iron and magnetometer: what is added to the field in the body frame.


def heeling(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return a vertical magnet below the compass: nothing while level, a turn of the heading when it leans."""
    return Effect("heeling", {"b_z_nT": 1000.0}, body_nt=np.array([0.0, 0.0, 1000.0]) * np.ones((here.time_s.size, 1)))


def hard_iron_drift(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return steel that gains or loses magnetisation, in proportion to time."""
    return _horizontal(rng, "hard_iron_drift", here.years, "_year")


def hard_iron_step(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return steel whose magnetisation changed at once: a knock."""
    date = _date(rng, here)
    made = _horizontal(rng, "hard_iron_step", steps(here.time_s, date).astype(float), "")
    return Effect(made.name, made.parameters | {"date_s": date}, body_nt=made.body_nt)


def temperature(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return a zero of the magnetometer that follows the temperature."""
    return _horizontal(rng, "temperature", here.temperature_c - here.temperature_c.mean(), "_K")


def supply_voltage(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return the stray field of the supply current, which follows the battery's voltage in counts."""
    return _horizontal(rng, "supply_voltage", here.supply_counts - here.supply_counts.mean(), "_V")


def battery_change(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return another battery's iron from the change on: where the voltage rises most."""
    date = float(here.time_s[1 + int(np.argmax(np.diff(here.supply_counts)))])
    made = _horizontal(rng, "battery_change", steps(here.time_s, date).astype(float), "")
    return Effect(made.name, made.parameters, body_nt=made.body_nt)


def moving_iron(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return a battery that hangs in its straps, so that its field in the body follows the pitch, or the roll."""
    lean, of = (here.pitch_deg, "_pitch") if rng.random() < 0.5 else (here.roll_deg, "_roll")
    return _horizontal(rng, "moving_iron", (lean - lean.mean()) / 5.0, of)


def tilts_by_temperature(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return tilt sensors whose zeros follow the temperature; the compass levels by what they give."""
    angle, warm = rng.uniform(0.0, 2.0 * np.pi), here.temperature_c - here.temperature_c.mean()
    pitch, roll = 0.2 * np.cos(angle), 0.2 * np.sin(angle)
    parameters = {"pitch_deg_K": float(pitch), "roll_deg_K": float(roll)}
    return Effect("temperature", parameters, tilts_deg=np.column_stack([pitch * warm, roll * warm]))


def tilt_offset(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return tilt sensors that were screwed on at an angle."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    pitch, roll = 2.0 * np.cos(angle), 2.0 * np.sin(angle)
    off = np.ones((here.time_s.size, 2)) * [pitch, roll]
    return Effect("tilt_offset", {"pitch_deg": float(pitch), "roll_deg": float(roll)}, tilts_deg=off)


def _horizontal(rng: np.random.Generator, name: str, series: Floats, unit: str) -> Effect:
    angle = rng.uniform(0.0, 2.0 * np.pi)
    x, y = UNIT_NT * np.cos(angle), UNIT_NT * np.sin(angle)
    field = np.column_stack([x * series, y * series, np.zeros(series.size)])
    return Effect(name, {f"b_x_nT{unit}": float(x), f"b_y_nT{unit}": float(y)}, body_nt=field)


def _date(rng: np.random.Generator, here: Circumstances) -> float:
    return float(here.time_s[int(rng.uniform(0.2, 0.8) * here.time_s.size)])


# Effects that are no fault of a compass: water that veers between the two depths, clocks, the earth's own field.


def veer_with_speed(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return water that veers the more, the faster it flows."""
    fast = here.speed_m_s - here.speed_m_s.mean()
    return Effect("current_veer", {"deg_s_m": 5.0}, veer_deg=5.0 * fast)


def veer_with_depth(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return water that veers the more, the deeper the sphere is blown down."""
    deep = here.depth_m - here.depth_m.mean()
    return Effect("current_veer", {"deg_100m": 1.0}, veer_deg=0.01 * deep)


def veer_with_direction(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return water that is steered by the bottom: another veer for each direction."""
    phase = rng.uniform(0.0, 2.0 * np.pi)
    veer = np.sin(np.deg2rad(here.flow_deg) + phase)
    veer = veer - veer.mean()  # a constant veer is no effect that any record could show
    return Effect("current_veer", {"sine_deg": float(np.cos(phase)), "cosine_deg": float(np.sin(phase))}, veer_deg=veer)


def clock_offset(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return a clock that was set wrong, of either instrument."""
    hours = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.45, 1.5))
    return _clock(rng, "clock_offset", {"hours": hours}, hours * HOUR_S + np.zeros(here.time_s.size))


def clock_drift(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return a clock that runs fast or slow, of either instrument."""
    rate = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.6, 1.5))
    return _clock(rng, "clock_drift", {"hours_year": rate}, rate * HOUR_S * here.years)


def field_disturbance(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return storms and quiet days: magnetic north itself swings."""
    return Effect("field_disturbance", {"share_of_observatory": 1.0}, north_deg=disturbed_north(rng, here.time_s))


def disturbed_north(rng: np.random.Generator, time_s: Floats) -> Floats:
    """Return the swing of magnetic north, degrees east, (n,): a daily tide and some thirty storms a year.

    Args:
        time_s: UTC seconds, an hour apart, (n,).
    """
    day = 2.0 * np.pi * (time_s / DAY_S - 0.55)
    swing = 0.08 * np.sin(day) + 0.04 * np.sin(2.0 * day)
    activity = 0.05 * np.ones(time_s.size)
    for begin in rng.uniform(time_s[0], time_s[-1], 30):
        since = (time_s - begin) / DAY_S
        activity += np.where(since > 0.0, rng.lognormal(0.0, 0.6) * np.exp(-since / 0.8), 0.0)
    return swing + activity * red_noise(rng, time_s.size, memory=2.0, deviation=1.0)


def vector_disturbance(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return storms that reach the mooring turned: rock that conducts there, and another magnetic north."""
    across, along = (disturbed_north(rng, here.time_s) for _ in range(2))
    terms = {"across": float(rng.uniform(0.4, 1.2)), "along": float(rng.uniform(0.4, 1.2) * rng.choice([-1.0, 1.0]))}
    north = terms["across"] * across + terms["along"] * along
    observed = OBSERVED_NT * np.deg2rad(np.column_stack([across, along]))
    return Effect("field_disturbance", terms, north_deg=north, observed_nt=observed)


def storm_index(rng: np.random.Generator, time_s: Floats) -> Floats:
    """Return an index as ap is, one value for three hours: quiet, and some thirty storms a year, (n,).

    Args:
        time_s: UTC seconds, an hour apart, (n,).
    """
    index = np.repeat(4.0 + rng.gamma(2.0, 2.0, time_s.size // 3 + 1), 3)[: time_s.size]
    for begin in rng.uniform(time_s[0], time_s[-1], 30):
        since = (time_s - begin) / DAY_S
        index += np.where(since > 0.0, 30.0 * rng.lognormal(0.0, 0.8) * np.exp(-since / 0.8), 0.0)
    return index.clip(0.0, 400.0)


def unseen_disturbance(rng: np.random.Generator, index: Floats, size_deg: float) -> Floats:
    """Return the swing of magnetic north in storms of which only an index is known, degrees east, (n,).

    Args:
        index: as ap, hourly, (n,).
        size_deg: standard deviation for one unit of the index.
    """
    return size_deg * index * red_noise(rng, index.size, memory=3.0, deviation=1.0)


def _clock(rng: np.random.Generator, name: str, parameters: dict[str, float], ahead_s: Floats) -> Effect:
    return Effect(name, parameters, ahead_s=ahead_s, wrong_clock=str(rng.choice(["top", "deep"])))


# Effects between the magnetometer and the recorded heading: mount, electronics, levelling, time.


def heading_slip(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return an instrument that turned in its clamp on one day."""
    date = float(here.time_s[int(rng.uniform(0.2, 0.8) * here.time_s.size)])
    return _offset("heading_slip", {"offset_deg": 1.0, "date_s": date}, steps(here.time_s, date).astype(float))


def compass_drift(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return a reading that walks away in proportion to time."""
    return _offset("compass_drift", {"deg_year": 1.0}, here.years)


def temperature_of_reading(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return a reading that follows the temperature."""
    return _offset("temperature", {"deg_K": 1.0}, here.temperature_c - here.temperature_c.mean())


def voltage_of_reading(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return a reading that follows the battery's voltage in counts."""
    return _offset("supply_voltage", {"deg_V": 1.0}, here.supply_counts - here.supply_counts.mean())


def sextantal(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return a table of calibration with three lobes."""
    return _lobes(rng, "sextantal", 3)


def octantal(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return a table of calibration with four lobes."""
    return _lobes(rng, "octantal", 4)


def compass_lag(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return headings that are read well before the middle of the ensemble that they stand beside."""
    return Effect("compass_lag", {"lag_s": 1200.0}, lag_s=1200.0)


def tilt_uncompensated(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return a compass that does not level at all."""
    return Effect("tilt_uncompensated", {"share": 1.0}, unlevelled=1.0)


def stuck_tilt(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return inclinometers that stick at one value from a date on."""
    date = float(here.time_s[int(rng.uniform(0.3, 0.6) * here.time_s.size)])
    return Effect("stuck_tilt", {"date_s": date}, stuck_from_s=date)


# Effects of the reference.


def reference_deviation(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return a trusted compass with iron beside it."""
    phase = rng.uniform(0.0, 2.0 * np.pi)
    parameters = {"sine_deg": float(np.cos(phase)), "cosine_deg": float(np.sin(phase))}
    return Effect("reference_deviation", parameters, trusted=lambda heading: np.sin(np.deg2rad(heading) + phase))


def reference_slip(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return a reference that turned in its clamp on one day."""
    date = _date(rng, here)
    shift = steps(here.time_s, date).astype(float)
    return Effect("reference_slip", {"offset_deg": 1.0, "date_s": date}, trusted=lambda heading: shift)


def reference_beams(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return a reference whose forward beam pair gives too much."""
    return Effect("reference_beams", {"gain": 0.035}, gain=0.035)


def reference_bias(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return a reference that measures a constant velocity of its own, as by ringing."""
    bias = complex(0.003 * np.exp(1j * rng.uniform(0.0, 2.0 * np.pi)))
    return Effect("reference_bias", {"starboard_m_s": bias.real, "forward_m_s": bias.imag}, bias_m_s=bias)


def _offset(name: str, parameters: dict[str, float], series: Floats) -> Effect:
    return Effect(name, parameters, reading=lambda gamma: series[:, None] * np.ones(gamma.shape))


def _lobes(rng: np.random.Generator, name: str, count: int) -> Effect:
    phase = rng.uniform(0.0, 2.0 * np.pi)
    parameters = {"sine_deg": float(np.cos(phase)), "cosine_deg": float(np.sin(phase))}
    return Effect(name, parameters, reading=lambda gamma: np.sin(np.deg2rad(count * gamma) + phase))


# Effects that are in nobody's catalogue, and that no test of the search has seen.


def settling(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return a mount that settles after the deployment, within days to weeks."""
    age = here.time_s - here.time_s[0]
    return _series("settling", 4.0 * np.exp(-age / (rng.uniform(12.0, 50.0) * DAY_S)))


def corrosion(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return a fault that grows ever faster towards the end."""
    left = here.time_s[-1] - here.time_s
    return _series("corrosion", 4.0 * np.exp(-left / (rng.uniform(15.0, 60.0) * DAY_S)))


def backlash(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return a card that is dragged along, so that it reads otherwise after turns to the left than to the right."""
    width, at, side = float(rng.uniform(8.0, 20.0)), float(here.heading_deg[0]), []
    for heading in np.unwrap(here.heading_deg, period=360.0).tolist():
        at = min(max(at, heading - width), heading + width)
        side.append((heading - at) / width)
    return _series("backlash", side)


def sliding_magnet(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return a loose piece of steel that slides to the other end of its box when the instrument pitches far enough."""
    angle, there = rng.uniform(0.0, 2.0 * np.pi), here.pitch_deg > np.quantile(here.pitch_deg, rng.uniform(0.3, 0.7))
    ends = np.array([UNIT_NT * np.cos(angle), UNIT_NT * np.sin(angle), 0.0])
    return Effect("sliding_magnet", body_nt=there[:, None] * ends)


def tidal(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return a reading that swings with the tide of the moon."""
    turns = here.time_s / (sea.TIDES[0][0] * HOUR_S)
    return _series("tidal", np.cos(2.0 * np.pi * turns + rng.uniform(0.0, 2.0 * np.pi)))


def night_load(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return another instrument that draws its current for some hours of each day."""
    hour = (here.time_s / HOUR_S + rng.uniform(0.0, 24.0)) % 24.0
    return _series("night_load", 2.0 * (hour < rng.uniform(3.0, 8.0)))


def saturating(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return a readout that stops following the temperature where it is warm."""
    warm = (here.temperature_c - np.quantile(here.temperature_c, rng.uniform(0.2, 0.5))) / here.temperature_c.std()
    return _series("saturating", np.tanh(3.0 * warm))


def telegraph(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return a bad contact: the reading jumps between two values every few days."""
    mean_s, count = rng.uniform(3.0, 12.0) * DAY_S, int(np.ptp(here.time_s) / DAY_S) + 2
    jumps = here.time_s[0] + np.cumsum(rng.exponential(mean_s, count))
    return _series("telegraph", np.searchsorted(jumps, here.time_s) % 2)


def _series(name: str, series: ArrayLike) -> Effect:
    return Effect(name, reading=lambda gamma: np.asarray(series, dtype=float)[:, None] * np.ones(gamma.shape))


Maker = Callable[[np.random.Generator, Circumstances], Effect]
# By name, every way in which it may come about.
CATALOGUED: dict[str, tuple[Maker, ...]] = {
    "heeling": (heeling,),
    "hard_iron_drift": (hard_iron_drift,),
    "hard_iron_step": (hard_iron_step,),
    "battery_change": (battery_change,),
    "temperature": (temperature, temperature_of_reading, tilts_by_temperature),
    "moving_iron": (moving_iron,),
    "tilt_offset": (tilt_offset,),
    "supply_voltage": (supply_voltage, voltage_of_reading),
    "sextantal": (sextantal,),
    "octantal": (octantal,),
    "heading_slip": (heading_slip,),
    "compass_drift": (compass_drift,),
    "compass_lag": (compass_lag,),
    "tilt_uncompensated": (tilt_uncompensated,),
    "stuck_tilt": (stuck_tilt,),
    "current_veer": (veer_with_speed, veer_with_depth, veer_with_direction),
    "clock_offset": (clock_offset,),
    "clock_drift": (clock_drift,),
    "field_disturbance": (field_disturbance, vector_disturbance),
}
AT_REFERENCE: dict[str, Maker] = {
    made.__name__: made for made in (reference_deviation, reference_slip, reference_beams, reference_bias)
}
UNCATALOGUED: dict[str, Maker] = {
    made.__name__: made
    for made in (settling, corrosion, backlash, sliding_magnet, tidal, night_load, saturating, telegraph)
}


# Planting.


@dataclass(frozen=True, eq=False)
class Planted:
    """An effect with the size that is to be seen of it."""

    effect: Effect
    visible_deg: float


def plant(ground: Ground, wanted: Mapping[str, float]) -> tuple[Planted, ...]:
    """Return effects of wanted visible sizes, or of what is plausible.

    Args:
        wanted: rms degrees by name; a clock and a stuck sensor are as large as they are.
    """
    here = sealed.circumstances(ground)
    result = []
    for name, size in wanted.items():
        rng = ground.random(f"effect {name}")
        makers = CATALOGUED.get(name) or ((AT_REFERENCE | UNCATALOGUED)[name],)
        if name == "current_veer" and here.depth_m.std() < LEAST_BLOW_DOWN_M:
            makers = tuple(maker for maker in makers if maker is not veer_with_depth)
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
    """Return the visible size of one effect alone, rms degrees."""
    if effect.ahead_s is not None:
        return _clock_deg(ground, effect.ahead_s)
    bare, with_it = (_ideal(ground, planted) for planted in ((), (effect,)))
    if effect.bias_m_s:  # slow water may point anywhere
        return float(1.4826 * np.median(np.abs(with_it - bare)))
    return float(np.std(with_it - bare))


def background_deg(ground: Ground) -> float:
    """Return what five coefficients leave where nothing is planted, rms degrees."""
    return float(np.std(_ideal(ground, ())))


def _ideal(ground: Ground, effects: Sequence[Effect]) -> Floats:
    made = readings.read(ground, effects, ground.stamp_s)
    # Water that veers clockwise at the reference looks like a compass that reads too little.
    seen = made.recorded_deg - total(effects, "veer_deg", np.zeros(ground.stamp_s.size)) - _at_trusted(ground, effects)
    return left_deg(seen[::EVERY], made.heading_deg[::EVERY])


def _at_trusted(ground: Ground, effects: Sequence[Effect]) -> Floats:
    """Return by how much faults of the reference turn its directions, clockwise, degrees."""
    heading = sealed.trusted_heading(ground)
    turned = sum((one.trusted(heading) for one in effects if one.trusted is not None), np.zeros(heading.size))
    true = heading + ground.field.at(ground.stamp_s)[0]
    body = clockwise(_flow(ground, ground.stamp_s), -true)
    flawed = adcp.by_beams(body, sum(one.gain for one in effects), sum(one.bias_m_s for one in effects))
    return turned + np.rad2deg(np.angle(body * np.conj(flawed)))


def _clock_deg(ground: Ground, ahead_s: Floats) -> float:
    """Return by how much the direction that is paired moves, robustly: slow water may point anywhere."""
    stamps = ground.stamp_s
    at = [direction(_flow(ground, when)) for when in (stamps, stamps - ahead_s)]
    return float(1.4826 * np.median(np.abs(np.rad2deg(_turn(at[1], at[0])))))


def _flow(ground: Ground, time_s: Floats) -> Complexes:
    depth = np.interp(time_s, ground.motion.time_s, ground.motion.sphere_depth_m)
    return sea.velocity(ground.currents, time_s, depth)


def _turn(a_deg: Floats, b_deg: Floats) -> Floats:
    """Return a - b in radians, the short way."""
    return np.asarray(np.angle(np.exp(1j * np.deg2rad(a_deg - b_deg))))
