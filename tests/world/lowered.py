"""Simulated station of a lowered profiler whose compass is disturbed by iron, and of the ship's profiler.

The ship drifts with the wind. Either instrument measures the current relative to itself; the frame follows the ship
except for swaying on the wire, and both measure nearly the same. Numbers are invented, with the orders of magnitude of
a 2000 m cast.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from compasslib import angles
from compasslib.demo import adcp, compass
from compasslib.demo import water as sea
from compasslib.demo.compass import Field, Iron
from compasslib.demo.water import (
    Climate,
    Complexes,
    Floats,
    Water,
    clockwise,
    pressure,
    red_vector,
    stream,
    towards,
    white_vector,
)
from tests.world import package
from tests.world.package import Head, Motion, Posture, Sea

NAME, LATITUDE_DEG, LONGITUDE_DEG, WATER_DEPTH_M = "LADCP1", 36.5, -13.2, 2300.0
START_S = 1273233600.0  # 7 May 2010, 12:00 UTC: the frame enters the water
CELLS, PING_S, PING_NOISE_M_S = 16, 2.0, 0.05
SHIP_EVERY_S, SHIP_CELL_M, SHIP_DEEPEST_M, SHIP_NOISE_M_S = 60.0, 16.0, 700.0, 0.02
MARGIN_S = 600.0
DRIFT_M_S, SWAY_M_S, SWAY_S = 0.5, 0.03, 40.0  # one knot of drift, which keeps the wire clear
HEAD = Head(
    ping_s=PING_S,
    iron=Iron(hard_nt=(6000.0, -4000.0, 1500.0), soft=((1.03, 0.02, 0.0), (0.02, 0.98, 0.0), (0.0, 0.0, 1.0))),
)
CLIMATE = Climate(mean_m_s=0.12, along_deg=110.0, tide_m_s=0.06, red_m_s=0.08)


def write_station(folder: Path | str, seed: int = 1) -> None:
    """Write the PD0 file of the lowered profiler, the table of the ship's profiler, and separately the truth."""
    raw, truth = Path(folder) / "raw" / NAME, Path(folder) / "truth" / f"{NAME}.csv"
    raw.mkdir(parents=True, exist_ok=True)
    truth.parent.mkdir(parents=True, exist_ok=True)
    motion = package.lower(stream(seed, NAME, "motion"), Sea(turns=5.0, wander_deg=60.0), START_S)
    span = (START_S - MARGIN_S, float(motion.time_s[-1]) + MARGIN_S)
    field = compass.earth_field(LATITUDE_DEG, LONGITUDE_DEG, span)
    water = sea.make_water(seed, NAME, CLIMATE, site=(LATITUDE_DEG, WATER_DEPTH_M), span_s=span)
    _, *strength = (float(x.mean()) for x in field.at(np.array(span)))
    posture = package.stand(stream(seed, NAME, "head"), motion, HEAD, (strength[0], strength[1]))
    _write_lowered(raw / "lowered.000", posture, _seen(seed, motion, posture, water, field))
    _write_ship(raw / "vessel.csv", stream(seed, NAME, "vessel"), water, span)
    _write_truth(truth, posture)


def relative(water: Water, time_s: Floats, depth_m: Floats) -> Complexes:
    """Compute the current relative to the drifting ship at times (n,) and depths, (n,) or (n, m), east + i north."""
    return sea.velocity(water, time_s, depth_m) - DRIFT_M_S * towards(250.0)


def _seen(seed: int, motion: Motion, posture: Posture, water: Water, field: Field) -> Floats:
    """Simulate the four components recorded by the lowered head in earth coordinates, (n, CELLS, 4)."""
    rng = stream(seed, NAME, "pings")
    away = package.setup(looks_up=False, cells=CELLS)
    depth = posture.depth_m[:, None] + away.first_bin_m + away.cell_m * np.arange(CELLS)
    sway = red_vector(rng, motion.time_s.size, memory=SWAY_S / package.STEP_S, deviation=SWAY_M_S)
    flow = relative(water, posture.time_s, depth) - np.interp(posture.time_s, motion.time_s, sway)[:, None]
    flow = flow + white_vector(rng, depth.shape, PING_NOISE_M_S)
    declination = field.at(posture.time_s)[0]
    turned = clockwise(flow, (posture.recorded_deg - posture.heading_deg - declination)[:, None])
    below = np.where(depth > WATER_DEPTH_M, np.nan, 1.0)
    rising = np.gradient(posture.depth_m, posture.time_s)[:, None] * np.ones(depth.shape)
    return np.stack([turned.real * below, turned.imag * below, rising * below, 0.0 * below], axis=-1)


def _write_lowered(path: Path, posture: Posture, velocity: Floats) -> None:
    recorded = package.ensembles(posture, looks_up=False, velocity_m_s=velocity)
    recorded = replace(recorded, pressure_dbar=pressure(posture.depth_m, LATITUDE_DEG))
    adcp.write(path, package.setup(looks_up=False, cells=CELLS), recorded)


def _write_ship(path: Path, rng: np.random.Generator, water: Water, span_s: tuple[float, float]) -> None:
    """Write the ship's profiles, one row per time and depth, relative to the ship and to true north (by its gyros)."""
    time = np.arange(span_s[0], span_s[1], SHIP_EVERY_S)
    depth = np.arange(24.0, SHIP_DEEPEST_M, SHIP_CELL_M)
    grid = np.broadcast_to(depth, (time.size, depth.size))
    flow = 100.0 * (relative(water, time, grid) + white_vector(rng, grid.shape, SHIP_NOISE_M_S))
    columns = {"depth_m": grid.ravel(), "u_cm_s": flow.real.ravel(), "v_cm_s": flow.imag.ravel()}
    _write_table(path, np.repeat(time, depth.size), columns, "%.1f")


def _write_truth(path: Path, posture: Posture) -> None:
    columns = {"heading_true_magnetic_deg": angles.wrap360(posture.heading_deg)}
    columns |= {"recorded_heading_deg": posture.recorded_deg, "depth_m": posture.depth_m}
    _write_table(path, posture.time_s, columns, "%.3f")


def _write_table(path: Path, time_s: Floats, columns: dict[str, Floats], form: str) -> None:
    stamps = np.char.add(np.datetime_as_string(time_s.astype("datetime64[s]")), "Z")
    pd.DataFrame({"time_utc": stamps} | columns).to_csv(path, index=False, float_format=form)
