"""Recordings with one known effect, drawn anew: headings, noise, iron, place in the record; each with its diagnosis."""

from __future__ import annotations

import csv
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from compasslib.calibration.magnetometer.log import Log
from compasslib.core import angles, compass
from compasslib.search import kinds
from compasslib.search.diagnosis import Options
from compasslib.search.kinds import magnetometer, platform, two_heads
from compasslib.search.verdict import Diagnosis
from compasslib.simulation import package, swing
from compasslib.simulation.compass import Iron
from compasslib.simulation.package import Head, Sea
from compasslib.simulation.swing import Boat, Passage

OPTIONS = Options()
H_NT, Z_NT = 20000.0, 42000.0
Truth = dict[str, float]  # parameters of the effect, by the names of the finding
Made = tuple[Diagnosis, Truth]


def bench(rng: np.random.Generator, effect: str) -> Made:
    """Return the diagnosis of a bench of 16 to 36 headings."""
    count = int(rng.integers(16, 37))
    rounds = 3 if effect in ("heading_slip", "hard_iron_step") else int(rng.integers(1, 4))
    correct = np.tile(360.0 / count * np.arange(count) + rng.uniform(0.0, 10.0), rounds)
    iron = np.append(rng.normal(0.0, 0.02), rng.normal(0.0, 0.12, 2))
    iron = np.append(iron, rng.normal(0.0, 0.02, 2))
    if effect == "large_deviation":
        iron[1:3] = rng.uniform(0.6, 1.4) * np.array(angles.sin_cos(rng.uniform(0.0, 360.0)))
    recorded, truth = compass.recorded_heading(iron, correct), Truth()
    if effect in ("sextantal", "octantal"):
        cycles = 3 if effect == "sextantal" else 4
        size, phase = rng.uniform(1.2, 3.0), rng.uniform(0.0, 360.0)
        recorded = recorded + size * angles.sin_cos(cycles * recorded + phase)[0]
        truth = lobes(size, phase)
    if effect == "heading_slip":
        truth = {"offset_deg": rng.uniform(1.5, 4.0)}
        late = np.arange(len(correct)) >= rng.uniform(0.3, 0.7) * len(correct)
        recorded = recorded + truth["offset_deg"] * late
    noise = rng.normal(0.0, rng.uniform(0.1, 0.6), len(correct))
    return platform.judge(correct, angles.wrap360(recorded + noise), field=None, options=OPTIONS), truth


def log(rng: np.random.Generator, effect: str) -> Made:
    """Return the diagnosis of a magnetometer's log: some turns with tilts, its heading logged or not."""
    n, turns = 1500, rng.uniform(3.0, 8.0)
    time_s = 1.6e9 + np.arange(n) * 1.0
    heading = 360.0 * turns * np.arange(n) / n + 20.0 * np.sin(np.arange(n) / rng.uniform(20.0, 60.0))
    pitch, roll = (rng.uniform(-1.0, 1.0) + 2.0 * np.sin(np.arange(n) / rng.uniform(5.0, 40.0)) for _ in range(2))
    level = np.column_stack([H_NT * angles.sin_cos(heading)[1], -H_NT * angles.sin_cos(heading)[0], np.full(n, Z_NT)])
    tilting = compass.levelling(pitch, roll)
    if effect != "tilt_uncompensated":
        pitch, roll, tilting = np.zeros(n), np.zeros(n), np.broadcast_to(np.eye(3), (n, 3, 3))
    field = np.einsum("nji,nj->ni", tilting, level)
    temperature = 10.0 + 5.0 * np.sin(np.arange(n) / rng.uniform(150.0, 300.0))
    hard = rng.uniform(1000.0, 6000.0) * np.append(angles.sin_cos(rng.uniform(0.0, 360.0)), 0.0)
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
    shown = np.einsum("nij,nj->ni", tilting, field + noise)
    logged = angles.argument(shown[:, 0] - 1j * shown[:, 1])
    if effect == "compass_lag":
        truth = {"lag_s": rng.uniform(2.0, 6.0)}
        logged = angles.wrap360(np.interp(np.arange(n) - truth["lag_s"], np.arange(n), heading))
    tilts = (None, None) if not pitch.any() else (pitch, roll)
    made = Log(field + noise, True, tilts[0], tilts[1], logged, time_s, 0, (), temperature)
    return magnetometer.judge(made, field={"horizontal_nT": H_NT, "vertical_nT": Z_NT}, options=OPTIONS), truth


def heads(rng: np.random.Generator, effect: str) -> Made:
    """Return the diagnosis of two heads in the simulated sea, through PD0 bytes."""
    noise, slow = rng.uniform(0.2, 0.8), {"slow_deg": rng.uniform(0.0, 0.8), "slow_s": rng.uniform(5.0, 60.0)}
    sea = Sea(turns=rng.uniform(-8.0, 8.0), wander_deg=rng.uniform(40.0, 90.0), swell_s=rng.uniform(6.0, 14.0))
    a = Head(noise_deg=noise, **slow)
    b = Head(mount_deg=(rng.uniform(-180.0, 180.0), 1.0, -1.0), noise_deg=noise, **slow)
    b = replace(b, clock_s=rng.uniform(2.0, 60.0)) if effect == "clock_offset" else b
    truth = {"offset_s": b.clock_s} if effect == "clock_offset" else Truth()
    motion = package.lower(rng, sea, 1.2e9)
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / "a.000", Path(folder) / "b.000"]
        for path, head in zip(paths, (a, b), strict=True):
            path.write_bytes(package.encoded(package.stand(rng, motion, head), looks_up=head.looks_up))
        first, second = (two_heads.two_heads.record(path, {}, k) for k, path in enumerate(paths))
    moved = [two_heads.heads_motion.motion(one) for one in (first, second)]
    if effect == "heading_slip":
        late = np.arange(len(moved[1].time_s)) >= rng.uniform(0.3, 0.7) * len(moved[1].time_s)
        truth = {"offset_deg": rng.uniform(2.0, 6.0)}
        moved[1] = replace(moved[1], heading_deg=moved[1].heading_deg + truth["offset_deg"] * late)
    if effect == "compass_lag":
        time_s, truth = moved[1].time_s, {"lag_s": rng.uniform(1.0, 4.0)}
        moved[1] = replace(moved[1], heading_deg=np.interp(time_s - truth["lag_s"], time_s, moved[1].heading_deg))
    if effect == "sextantal":
        truth = {"sine_deg": rng.uniform(1.5, 3.0), "cosine_deg": 0.0}
        curve = truth["sine_deg"] * angles.sin_cos(3.0 * moved[1].heading_deg)[0]
        moved[1] = replace(moved[1], heading_deg=moved[1].heading_deg + curve)
    return two_heads.judge(*moved, farthest_s=600.0, field=None, options=OPTIONS), truth


KNOT_M_S = 1852.0 / 3600.0


def lobes(size_deg: float, phase_deg: float) -> Truth:
    """Return the parameters of a harmonic."""
    sine, cosine = angles.sin_cos(phase_deg)
    return {"sine_deg": float(size_deg * cosine), "cosine_deg": float(size_deg * sine)}


def boat(rng: np.random.Generator, effect: str) -> tuple[Boat, Truth]:
    """Return how a boat swings her compass, with one effect beside the deviation curve."""
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
    drawn: dict[str, tuple[dict[str, object], Truth]] = {
        "": ({}, {}),
        "water_drift": ({"water_kn": water}, known),
        "water_drift, one speed, ship's log": (
            {"water_kn": water, "log_scale": log_scale, "speeds_vary": False, "plan": swing.ONE_CIRCLE},
            known,
        ),
        "water_drift, one speed, one circle": (
            {"water_kn": water, "speeds_vary": False, "plan": swing.ONE_CIRCLE},
            known,
        ),
        "course_lag": ({"filter_s": late}, {"lag_s": keep / (1.0 - keep)}),
        "compass_lag": ({"lag_s": late}, {"lag_s": late}),
        "clock_offset": ({"clock_s": way * 2.0 * late}, {"offset_s": way * 2.0 * late}),
        "sextantal": ({"lobes": (3, harmonic, phase)}, lobes(harmonic, phase)),
        "octantal": ({"lobes": (4, harmonic, phase)}, lobes(harmonic, phase)),
        "heading_slip": (
            {"slip_deg": way * late, "slip_at": rng.uniform(0.3, 0.7)},
            {"offset_deg": way * late},
        ),
        "(a card that hangs)": ({"hangs_deg": way * 2.0 * late, "hangs_at_deg": phase}, {}),
        "(a while astray)": ({"astray": (way * 2.0 * late, 0.3, 0.5 + 0.2 * size)}, {}),
    }
    given, truth = drawn[effect]
    return replace(plain, **given), truth  # type: ignore[arg-type]


def swung(rng: np.random.Generator, effect: str) -> Made:
    """Return the diagnosis of a swing's log, through the table that a ship would write."""
    sailed, truth = boat(rng, effect)
    declination = float(rng.uniform(-10.0, 10.0))
    with tempfile.TemporaryDirectory() as folder:
        path = written(swing.sail(rng, sailed, declination), Path(folder) / "swing.csv")
        return kinds.diagnose("swing", [path], {"declination": declination}, OPTIONS), truth


def written(passage: Passage, path: Path) -> Path:
    """Write a swing's log as a table."""
    stamps = np.datetime_as_string((1000.0 * passage.time_s).astype("datetime64[ms]"))
    columns = {
        "compass_deg": passage.compass_deg,
        "cog_deg": passage.course_deg,
        "speed_kn": passage.speed_kn,
        "time_utc": stamps,
    }
    if np.isfinite(passage.water_speed_kn).all():
        columns["water_speed_kn"] = passage.water_speed_kn
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))
    return path
