"""Short records made by hand, sampled hourly."""

from dataclasses import replace

import numpy as np

from compasslib.records import Record
from tests.world.sea import plain_record

HOUR = 3600.0


def record(times, *, depth=100.0, ranges=(10.0, 14.0, 18.0), east=0.2, north=0.1, up=True, heading=30.0) -> Record:
    times = np.asarray(times, dtype=float)
    flow, headings = np.full((len(times), len(ranges)), east + 1j * north), np.full(len(times), heading)
    depths = np.broadcast_to(depth, times.shape).astype(float)
    return plain_record(times, flow, ranges, heading_deg=headings, depth_m=depths, looks_up=up)


def turning(n: int = 60, seed: int = 1):
    rng = np.random.default_rng(seed)
    given = record(HOUR * np.arange(n), heading=0.0)
    east = given.east + rng.normal(0.0, 0.1, given.east.shape)
    noise = [rng.normal(0.0, 3.0, n).round(2) for _ in range(2)]
    heading = rng.uniform(0, 360, n).round(2)
    north = given.north + 0.1 * east
    return replace(given, east=east, north=north, heading_deg=heading, pitch_deg=noise[0], roll_deg=noise[1])
