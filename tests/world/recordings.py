"""Simulated recordings of a magnetometer and a swing with one known effect; other properties are random.

``truth`` holds the parameters of the effect, named as in a diagnosis.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from compasslib.angles import wrap360
from compasslib.demo.compass import Iron, tilting
from compasslib.demo.water import Floats
from tests.world import swing
from tests.world.pairs import RAD
from tests.world.swing import Boat, Passage

H_NT, Z_NT = 20000.0, 42000.0
KNOT_M_S = 1852.0 / 3600.0
Truth = dict[str, float]


@dataclass(frozen=True)
class AxesLog:
    """Log of a magnetometer, one sample per second."""

    time_s: Floats  # (n,)
    field_nt: Floats  # (n, 3) forward, starboard, down
    pitch_deg: Floats | None  # (n,); None if level
    roll_deg: Floats | None
    heading_deg: Floats  # (n,) logged by the instrument
    temperature_c: Floats  # (n,)
    truth: Truth


def _sin_cos(angle_deg: Floats | float) -> tuple[Floats, Floats]:
    return np.sin(RAD * angle_deg), np.cos(RAD * angle_deg)


def log(rng: np.random.Generator, effect: str) -> AxesLog:
    """Simulate the log of a magnetometer over several turns, tilted only with the effect ``tilt_uncompensated``."""
    n, turns = 1500, rng.uniform(3.0, 8.0)
    time_s = 1.6e9 + np.arange(n, dtype=float)
    heading = 360.0 * turns * np.arange(n) / n + 20.0 * np.sin(np.arange(n) / rng.uniform(20.0, 60.0))
    pitch, roll = (rng.uniform(-1.0, 1.0) + 2.0 * np.sin(np.arange(n) / rng.uniform(5.0, 40.0)) for _ in range(2))
    sine, cosine = _sin_cos(heading)
    level = np.column_stack([H_NT * cosine, -H_NT * sine, np.full(n, Z_NT)])
    levelling = tilting(pitch, roll)
    if effect != "tilt_uncompensated":
        pitch, roll, levelling = np.zeros(n), np.zeros(n), np.broadcast_to(np.eye(3), (n, 3, 3))
    field = np.einsum("nji,nj->ni", levelling, level)
    temperature = 10.0 + 5.0 * np.sin(np.arange(n) / rng.uniform(150.0, 300.0))
    strength, towards = rng.uniform(1000.0, 6000.0), rng.uniform(0.0, 360.0)
    hard = strength * np.array([*_sin_cos(towards), 0.0])
    truth = {"share": 1.0} if effect == "tilt_uncompensated" else Truth()
    if effect == "hard_iron":
        field, truth = field + hard, {"b_x_nT": hard[0], "b_y_nT": hard[1]}
    if effect == "soft_iron":
        stretch = rng.uniform(0.04, 0.12)
        field, truth = field * np.array([1.0 + stretch, 1.0, 1.0]), {"stretch": stretch / (2.0 + stretch), "shear": 0.0}
    if effect == "hard_iron_step":
        field = field + hard / 2.0 * (np.arange(n) >= rng.uniform(0.3, 0.7) * n)[:, None]
        truth = {"b_x_nT": hard[0] / 2.0, "b_y_nT": hard[1] / 2.0}
    if effect == "temperature":
        field = field + hard / 12.0 * (temperature - 10.0)[:, None]
        truth = {"b_x_nT_K": hard[0] / 12.0, "b_y_nT_K": hard[1] / 12.0}
    noise = rng.normal(0.0, rng.uniform(20.0, 150.0), (n, 3))
    shown = np.einsum("nij,nj->ni", levelling, field + noise)
    logged = wrap360(np.arctan2(-shown[:, 1], shown[:, 0]) / RAD)
    if effect == "compass_lag":
        truth = {"lag_s": rng.uniform(2.0, 6.0)}
        logged = wrap360(np.interp(np.arange(n) - truth["lag_s"], np.arange(n), heading))
    tilts = (pitch, roll) if pitch.any() else (None, None)
    return AxesLog(time_s, field + noise, *tilts, logged, temperature, truth)


def lobes(size_deg: float, phase_deg: float) -> Truth:
    """Compute the sine and cosine parameters of a harmonic."""
    sine, cosine = _sin_cos(phase_deg)
    return {"sine_deg": float(size_deg * cosine), "cosine_deg": float(size_deg * sine)}


def boat(rng: np.random.Generator, effect: str) -> tuple[Boat, Truth]:
    """Draw a boat that swings its compass with one effect besides the deviation curve, and the true parameters."""
    plan = str(rng.choice([swing.LEGS, swing.CIRCLES]))
    hard = (*rng.normal(0.0, 0.07 * swing.FIELD_NT[0], 2), 0.0)
    plain = Boat(
        plan=plan,
        minutes=rng.uniform(14.0, 45.0),
        speed_kn=rng.uniform(3.5, 7.0),
        wander_deg=rng.uniform(1.0, 3.0),
        leeway_deg=rng.uniform(0.5, 2.0),
        leeway_s=rng.uniform(15.0, 60.0),
        iron=Iron(hard),
    )
    phase, size = rng.uniform(0.0, 360.0), rng.uniform()
    water = (0.4 + 0.6 * size) * np.exp(1j * np.deg2rad(phase))
    known = {"east_m_s": KNOT_M_S * water.real, "north_m_s": KNOT_M_S * water.imag}
    late, way, harmonic = 4.0 + 6.0 * size, rng.choice([-1.0, 1.0]), 1.5 + 2.5 * size
    keep = np.exp(-1.0 / late)
    log_scale = rng.normal(1.0, 0.05)
    one_speed = {"water_kn": water, "speeds_vary": False, "plan": swing.ONE_CIRCLE}
    drawn: dict[str, tuple[dict[str, object], Truth]] = {
        "": ({}, {}),
        "water_drift": ({"water_kn": water}, known),
        "water_drift, one speed, ship's log": (one_speed | {"log_scale": log_scale}, known),
        "water_drift, one speed, one circle": (one_speed, known),
        "course_lag": ({"filter_s": late}, {"lag_s": keep / (1.0 - keep)}),
        "compass_lag": ({"lag_s": late}, {"lag_s": late}),
        "clock_offset": ({"clock_s": way * 2.0 * late}, {"offset_s": way * 2.0 * late}),
        "sextantal": ({"lobes": (3, harmonic, phase)}, lobes(harmonic, phase)),
        "octantal": ({"lobes": (4, harmonic, phase)}, lobes(harmonic, phase)),
        "heading_slip": ({"slip_deg": way * late, "slip_at": rng.uniform(0.3, 0.7)}, {"offset_deg": way * late}),
        "(a card that hangs)": ({"hangs_deg": way * 2.0 * late, "hangs_at_deg": phase}, {}),
        "(a while astray)": ({"astray": (way * 2.0 * late, 0.3, 0.5 + 0.2 * size)}, {}),
    }
    given, truth = drawn[effect]
    return replace(plain, **given), truth  # type: ignore[arg-type]


def written(passage: Passage, path: Path) -> Path:
    """Write the log of a swing as a table and return its path."""
    stamps = np.datetime_as_string((1000.0 * passage.time_s).astype("datetime64[ms]"))
    columns = {"compass_deg": passage.compass_deg, "cog_deg": passage.course_deg, "speed_kn": passage.speed_kn}
    columns["time_utc"] = stamps
    if np.isfinite(passage.water_speed_kn).all():
        columns["water_speed_kn"] = passage.water_speed_kn
    pd.DataFrame(columns).to_csv(path, index=False)
    return path
