"""Effects of iron and magnetometer: what is added to the field in the body frame."""

from __future__ import annotations

import numpy as np

from compasslib.nature.effects import Circumstances, Effect, steps
from compasslib.nature.series import Floats

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
