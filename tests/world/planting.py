"""Planting of effects with a requested visible size in a simulated mooring."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from compasslib.demo import adcp, sealed
from compasslib.demo import water as sea
from compasslib.demo.sealed import Effect, Ground
from compasslib.demo.water import Complexes, Floats, clockwise

# Largest plausible multiples of the unit sizes.
STRONGEST = {"heeling": 15.0, "sextantal": 9.0}
ROUNDS = 3
EVERY = 3  # hours, sufficient for the size of an effect
ITERATIONS = 12
STEADIEST = 0.2  # lower bound of the slope of recorded over correct heading, by which an error is divided
UNIT_NT = 200.0
AS_THEY_ARE = ("date_s",)  # parameters that do not scale with the size


@dataclass(frozen=True, eq=False)
class Circumstances:
    """True attitude and temperature of an instrument at its ensembles; (n,) each."""

    time_s: Floats  # true
    heading_deg: Floats  # correct, magnetic
    pitch_deg: Floats
    roll_deg: Floats
    temperature_c: Floats


def circumstances(ground: Ground) -> Circumstances:
    """Interpolate attitude and temperature of the affected instrument to the full hours."""
    motion = ground.motion
    columns = motion.heading_deg, motion.pitch_deg, motion.roll_deg, ground.temperature_c
    return Circumstances(ground.stamp_s, *(np.interp(ground.stamp_s, motion.time_s, x) for x in columns))


def scaled(effect: Effect, size: float) -> Effect:
    """Scale an effect by a factor."""
    plain, trusted = effect.reading, effect.trusted
    return replace(
        effect,
        parameters={k: v if k in AS_THEY_ARE else size * v for k, v in effect.parameters.items()},
        body_nt=None if effect.body_nt is None else size * effect.body_nt,
        reading=None if plain is None else lambda gamma: size * plain(gamma),
        trusted=None if trusted is None else lambda heading: size * trusted(heading),
        gain=size * effect.gain,
        bias_m_s=size * effect.bias_m_s,
        size=size,
    )


def heeling(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Make a vertical magnet below the compass, which turns the heading only if the instrument is tilted."""
    return Effect("heeling", {"b_z_nT": 1000.0}, body_nt=np.array([0.0, 0.0, 1000.0]) * np.ones((here.time_s.size, 1)))


def temperature(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Draw a zero offset of the magnetometer that is linear in temperature."""
    angle, warm = rng.uniform(0.0, 2.0 * np.pi), here.temperature_c - here.temperature_c.mean()
    x, y = UNIT_NT * np.cos(angle), UNIT_NT * np.sin(angle)
    field = np.column_stack([x * warm, y * warm, np.zeros(warm.size)])
    return Effect("temperature", {"b_x_nT_K": float(x), "b_y_nT_K": float(y)}, body_nt=field)


def heading_slip(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Draw a turn of the instrument in its clamp on one date."""
    date = _date(rng, here)
    shift = (here.time_s >= date).astype(float)[:, None]
    parameters = {"offset_deg": 1.0, "date_s": date}
    return Effect("heading_slip", parameters, reading=lambda gamma: shift * np.ones(gamma.shape))


def sextantal(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Draw a third harmonic of the reading, as by an erroneous calibration table."""
    phase = rng.uniform(0.0, 2.0 * np.pi)
    parameters = {"sine_deg": float(np.cos(phase)), "cosine_deg": float(np.sin(phase))}
    return Effect("sextantal", parameters, reading=lambda gamma: np.sin(np.deg2rad(3 * gamma) + phase))


def reference_deviation(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Draw a deviation of one cycle of the reference's compass, as by iron."""
    phase = rng.uniform(0.0, 2.0 * np.pi)
    parameters = {"sine_deg": float(np.cos(phase)), "cosine_deg": float(np.sin(phase))}
    return Effect("reference_deviation", parameters, trusted=lambda heading: np.sin(np.deg2rad(heading) + phase))


def reference_slip(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Draw a turn of the reference in its clamp on one date."""
    date = _date(rng, here)
    shift = (here.time_s >= date).astype(float)
    return Effect("reference_slip", {"offset_deg": 1.0, "date_s": date}, trusted=lambda heading: shift)


def reference_beams(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Make an excess gain of the reference's forward beam pair."""
    return Effect("reference_beams", {"gain": 0.035}, gain=0.035)


def reference_bias(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Draw a constant velocity bias of the reference in its body frame, as by ringing."""
    bias = complex(0.003 * np.exp(1j * rng.uniform(0.0, 2.0 * np.pi)))
    return Effect("reference_bias", {"starboard_m_s": bias.real, "forward_m_s": bias.imag}, bias_m_s=bias)


def _date(rng: np.random.Generator, here: Circumstances) -> float:
    return float(here.time_s[int(rng.uniform(0.2, 0.8) * here.time_s.size)])


EFFECTS: dict[str, Callable[[np.random.Generator, Circumstances], Effect]] = {
    made.__name__: made
    for made in (
        heeling, temperature, heading_slip, sextantal, reference_deviation, reference_slip, reference_beams,
        reference_bias,
    )
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Planted:
    """An effect and its visible size, rms degrees."""

    effect: Effect
    visible_deg: float


def plant(ground: Ground, wanted: Mapping[str, float]) -> tuple[Planted, ...]:
    """Draw effects with requested visible sizes, limited to plausible ones.

    Args:
        wanted: visible size of each effect by name, rms degrees.
    """
    here = circumstances(ground)
    return tuple(sized(ground, EFFECTS[name](ground.random(f"effect {name}"), here), x) for name, x in wanted.items())


def sized(ground: Ground, made: Effect, wanted_deg: float) -> Planted:
    """Scale an effect to a requested visible size, or to the largest plausible one.

    Args:
        made: effect at unit size.
        wanted_deg: visible size, rms degrees.
    """
    seen = visible_rms_deg(ground, made)
    most, size = STRONGEST.get(made.name, np.inf), 1.0
    for _ in range(ROUNDS):
        size = min(size * float(np.clip(wanted_deg / max(seen, 1e-3), 0.05, 20.0)), most)
        seen = visible_rms_deg(ground, scaled(made, size))
    return Planted(scaled(made, size), seen)


# The visible size of an effect is its residual after a fit of five coefficients to the true headings.


def left_deg(recorded_deg: Floats, heading_deg: Floats) -> Floats:
    """Compute the heading error that remains after fitting a compass with five coefficients, degrees, (n,).

    Args:
        recorded_deg: recorded headings, (n,).
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
    """Compute the visible size of a single effect, rms degrees."""
    bare, with_it = (_ideal(ground, planted) for planted in ((), (effect,)))
    if effect.bias_m_s:  # robust, as slow flow may have any direction
        return float(1.4826 * np.median(np.abs(with_it - bare)))
    return float(np.std(with_it - bare))


def background_deg(ground: Ground) -> float:
    """Compute the residual of five coefficients without planted effects, rms degrees."""
    return float(np.std(_ideal(ground, ())))


def _ideal(ground: Ground, effects: Sequence[Effect]) -> Floats:
    made = sealed.read(ground, effects, ground.stamp_s)
    seen = made.recorded_deg - _at_trusted(ground, effects)
    return left_deg(seen[::EVERY], made.heading_deg[::EVERY])


def _at_trusted(ground: Ground, effects: Sequence[Effect]) -> Floats:
    """Compute the clockwise turn of the reference's directions by its faults, degrees."""
    heading = sealed.trusted_heading(ground)
    turned = sum((one.trusted(heading) for one in effects if one.trusted is not None), np.zeros(heading.size))
    true = heading + ground.field.at(ground.stamp_s)[0]
    body = clockwise(_flow(ground, ground.stamp_s), -true)
    flawed = adcp.by_beams(body, sum(one.gain for one in effects), sum(one.bias_m_s for one in effects))
    return turned + np.rad2deg(np.angle(body * np.conj(flawed)))


def _flow(ground: Ground, time_s: Floats) -> Complexes:
    depth = np.interp(time_s, ground.motion.time_s, ground.motion.sphere_depth_m)
    return sea.velocity(ground.currents, time_s, depth)


def _turn(a_deg: Floats, b_deg: Floats) -> Floats:
    """Compute a - b in radians, wrapped to (-pi, pi]."""
    return np.asarray(np.angle(np.exp(1j * np.deg2rad(a_deg - b_deg))))
