"""Effects between the magnetometer and the recorded heading: mount, electronics, levelling, time."""

from __future__ import annotations

import numpy as np

from compasslib.nature.effects import Circumstances, Effect, steps
from compasslib.nature.series import Floats


def heading_slip(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return an instrument that turned in its clamp on one day."""
    date = float(here.time_s[int(rng.uniform(0.2, 0.8) * here.time_s.size)])
    return _offset("heading_slip", {"offset_deg": 1.0, "date_s": date}, steps(here.time_s, date).astype(float))


def compass_drift(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return a reading that walks away in proportion to time."""
    return _offset("compass_drift", {"deg_year": 1.0}, here.years)


def temperature(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return a reading that follows the temperature."""
    return _offset("temperature", {"deg_K": 1.0}, here.temperature_c - here.temperature_c.mean())


def supply_voltage(rng: np.random.Generator, here: Circumstances) -> Effect:
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
