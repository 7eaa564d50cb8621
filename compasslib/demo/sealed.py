"""Moorings with known truth: a sea, a rig, a magnetometer and a battery, drawn anew for each name and seed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from compasslib.demo import compass, magnetometer, mooring
from compasslib.demo import water as sea
from compasslib.demo.compass import Field
from compasslib.demo.effects import Circumstances
from compasslib.demo.magnetometer import Magnetometer
from compasslib.demo.mooring import Motion, Rig
from compasslib.demo.series import DAY_S, HOUR_S, Floats, circle, red_noise, stream
from compasslib.demo.water import Climate, Water

FIRST_S = 1.1676e9  # January 2007
MARGIN_S = 6 * HOUR_S
STRENGTHS = (0.05, 0.1, 0.2, 0.35, 0.55)  # of the iron, over the earth's horizontal field
WIDE = Climate(mean_m_s=0.12, tide_m_s=0.16, red_m_s=0.10, cyclone_m_s=0.15)
NARROW = Climate(mean_m_s=0.30, tide_m_s=0.08, red_m_s=0.06, cyclone_m_s=0.30)


@dataclass(frozen=True)
class Wish:
    """What a mooring is to be like."""

    wide: bool = False  # headings round the circle, or some seventy degrees of it
    hours: int = 8800


@dataclass(frozen=True, eq=False)
class Ground:
    """One mooring before anything is planted in it; series along the water's axis of time, (g,)."""

    seed: int
    name: str
    wish: Wish
    latitude_deg: float
    longitude_deg: float
    water_depth_m: float
    field: Field
    currents: Water
    motion: Motion
    meter: Magnetometer
    temperature_c: Floats
    supply_counts: Floats
    stamp_s: Floats  # (n,) full hours of the deployment

    def random(self, purpose: str) -> np.random.Generator:
        """Return the generator of one purpose on this mooring."""
        return stream(self.seed, self.name, purpose)


def make(seed: int, name: str, wish: Wish) -> Ground:
    """Return a mooring."""
    rng = stream(seed, name, "ground")
    latitude, longitude = float(rng.uniform(52.0, 68.0)), float(rng.uniform(-45.0, 5.0))
    depth = float(rng.uniform(250.0, 700.0))
    begin = FIRST_S + DAY_S * int(rng.integers(0, 4000))
    stamps = begin + HOUR_S * np.arange(wish.hours, dtype=float)
    span = (begin - MARGIN_S, float(stamps[-1]) + MARGIN_S)
    field = compass.earth_field(latitude, longitude, span)
    currents = _currents(seed, name, wish, site=(latitude, depth), span_s=span, along_deg=float(rng.uniform(0, 360)))
    declination, horizontal, vertical = (float(x.mean()) for x in field.at(stamps))
    motion = mooring.make_motion(seed, name, _rig(rng, depth), currents, declination_deg=declination)
    meter = magnetometer.build(rng, (horizontal, vertical), float(rng.choice(STRENGTHS)))
    temperature = _temperature(stream(seed, name, "temperature"), motion)
    supply = _supply(stream(seed, name, "supply"), currents.time_s, temperature)
    return Ground(
        seed, name, wish, latitude, longitude, depth, field, currents, motion, meter, temperature, supply, stamps
    )  # fmt: skip


def circumstances(ground: Ground) -> Circumstances:
    """Return in what the affected instrument stands at the full hours."""
    motion = ground.motion
    columns = motion.heading_deg, motion.pitch_deg, motion.roll_deg, ground.temperature_c
    return Circumstances(ground.stamp_s, *(np.interp(ground.stamp_s, motion.time_s, x) for x in columns))


def trusted_heading(ground: Ground) -> Floats:
    """Return the correct heading of the reference at the full hours: it turns by itself, degrees, (n,)."""
    rng = ground.random("deep heading")
    return circle(180.0 + red_noise(rng, ground.stamp_s.size, memory=30.0, deviation=120.0))


def _currents(
    seed: int, name: str, wish: Wish, *, site: tuple[float, float], span_s: tuple[float, float], along_deg: float
) -> Water:
    """Return the water; what shears between the depths grows with the speed, as it does in real records."""
    climate = replace(WIDE if wish.wide else NARROW, along_deg=along_deg)
    made = sea.make_water(seed, name, climate, site=site, span_s=span_s)
    speed = np.abs(made.surface + made.column)
    return replace(made, layers=made.layers.times(0.6 + speed / 0.6))


def _rig(rng: np.random.Generator, depth_m: float) -> Rig:
    lean = rng.uniform(-4.0, 4.0, 2)
    return Rig(500.0 + 1.7 * depth_m, float(rng.uniform(0, 360)), float(rng.uniform(22, 32)), *lean.tolist())


def _temperature(rng: np.random.Generator, motion: Motion) -> Floats:
    count = motion.time_s.size
    season = 1.5 * np.cos(2 * np.pi * (motion.time_s / DAY_S / 365.25 + rng.uniform()))
    weather = red_noise(rng, count, memory=10 * DAY_S / sea.STEP_S, deviation=0.6)
    return np.asarray(4.0 + season + weather - 0.4 * (motion.sphere_depth_m - 100.0) / 100.0)


def _supply(rng: np.random.Generator, time_s: Floats, temperature_c: Floats) -> Floats:
    """Return the transmit voltage in counts: falling in a line, with an end of discharge."""
    used = (time_s - time_s[0]) / (time_s[-1] - time_s[0])
    drain = rng.uniform(12.0, 22.0)
    warm = 0.4 * (temperature_c - temperature_c.mean())
    return np.asarray(166.0 - drain * used - rng.uniform(7.0, 14.0) * used**6 + warm)
