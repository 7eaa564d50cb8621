"""Effects of iron and magnetometer: what is added to the field in the body frame."""

from __future__ import annotations

import numpy as np

from compasslib.simulation.effects import Circumstances, Effect, steps
from compasslib.simulation.series import DAY_S, HOUR_S, Floats, red_noise

UNIT_NT = 200.0


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


def _offset(name: str, parameters: dict[str, float], series: Floats) -> Effect:
    return Effect(name, parameters, reading=lambda gamma: series[:, None] * np.ones(gamma.shape))


def _lobes(rng: np.random.Generator, name: str, count: int) -> Effect:
    phase = rng.uniform(0.0, 2.0 * np.pi)
    parameters = {"sine_deg": float(np.cos(phase)), "cosine_deg": float(np.sin(phase))}
    return Effect(name, parameters, reading=lambda gamma: np.sin(np.deg2rad(count * gamma) + phase))
