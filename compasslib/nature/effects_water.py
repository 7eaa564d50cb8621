"""Effects that are no fault of a compass: water that veers between the two depths, clocks, the earth's own field."""

from __future__ import annotations

import numpy as np

from compasslib.nature.effects import Circumstances, Effect
from compasslib.nature.series import DAY_S, HOUR_S, Floats, red_noise


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
        rng: source of randomness.
        time_s: UTC seconds, an hour apart, (n,).
    """
    day = 2.0 * np.pi * (time_s / DAY_S - 0.55)
    swing = 0.08 * np.sin(day) + 0.04 * np.sin(2.0 * day)
    activity = 0.05 * np.ones(time_s.size)
    for begin in rng.uniform(time_s[0], time_s[-1], 30):
        since = (time_s - begin) / DAY_S
        activity += np.where(since > 0.0, rng.lognormal(0.0, 0.6) * np.exp(-since / 0.8), 0.0)
    return swing + activity * red_noise(rng, time_s.size, memory=2.0, deviation=1.0)


def _clock(rng: np.random.Generator, name: str, parameters: dict[str, float], ahead_s: Floats) -> Effect:
    return Effect(name, parameters, ahead_s=ahead_s, wrong_clock=str(rng.choice(["top", "deep"])))
