"""Simulated moorings with known truth; currents, rig, magnetometer and battery are drawn by name and seed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from compasslib import angles
from compasslib.demo import adcp, compass, water
from compasslib.demo.adcp import Ensembles, Setup, Stance
from compasslib.demo.compass import Field, Magnetometer
from compasslib.demo.water import Climate, Rig, red_noise
from compasslib.types import DAY_S, HOUR_S, Floats

PINGS = 4  # in an ensemble of the simulated profiler


@dataclass(frozen=True, eq=False)
class Effect:
    """An effect planted at the n ensembles of one instrument; quantities that it does not change are None or 0."""

    body_nt: Floats | None = None  # (n, 3) field added in the body frame
    reading: Callable[[Floats], Floats] | None = None  # added to readings (n, k), degrees
    trusted: Callable[[Floats], Floats] | None = None  # added to the headings of the reference (n,), degrees
    gain: float = 0.0  # relative excess gain of the reference's forward beam pair
    bias_m_s: complex = 0.0  # starboard + i forward, added to the velocities of the reference


def read(ground: Ground, effects: Sequence[Effect], time_s: Floats, rng: np.random.Generator | None = None) -> Stance:
    """Simulate the affected compass: true attitude and readings.

    Without a random generator, a single ping without noise and quantization is simulated, else four with both.
    The tilts have twelve bits over 180 degrees, are late by 20 s, and hold three quarters of a fast wobble.
    """
    pings, tilt_step_deg = 1 if rng is None else PINGS, 180.0 / 4096.0
    times = time_s[:, None] + 90.0 * (np.arange(pings) - 0.5 * (pings - 1))
    wobble = np.zeros((2, *times.shape)) if rng is None else rng.normal(0.0, 0.35, (2, *times.shape))
    motion = ground.motion
    heading, pitch, roll, depth = (
        np.interp(at, motion.time_s, series)
        for at, series in (
            (times, motion.heading_deg), (times, motion.pitch_deg), (times, motion.roll_deg),
            (time_s, motion.sphere_depth_m),
        )
    )  # fmt: skip
    true = (pitch + wobble[0], roll + wobble[1])
    before = times if rng is None else times - 20.0
    late = [np.interp(before, motion.time_s, series) for series in (motion.pitch_deg, motion.roll_deg)]
    sensed = [slow + 0.75 * fast for slow, fast in zip(late, wobble, strict=True)]
    if rng is not None:
        sensed = [tilt_step_deg * np.rint(tilt / tilt_step_deg) for tilt in sensed]
    _, horizontal, vertical = ground.field.at(times)
    body = compass.body_field((horizontal, vertical), heading, true)
    iron = sum((effect.body_nt for effect in effects if effect.body_nt is not None), np.zeros((len(times), 3)))
    given = compass.felt(ground.meter, body, iron[:, None, :], stepped=rng is not None)
    gamma = compass.levelled_heading(given, (sensed[0], sensed[1]))
    added = [effect.reading(gamma) for effect in effects if effect.reading is not None]
    gamma = gamma + sum(added, np.zeros(gamma.shape))
    noise = 0.0 if rng is None else rng.normal(0.0, 0.4, time_s.size)
    return Stance(
        time_s=time_s,
        depth_m=depth,
        heading_deg=angles.mean(heading, axis=1),
        recorded_deg=angles.wrap360(angles.mean(gamma, axis=1) + noise),
        tilt_deg=(true[0].mean(axis=1), true[1].mean(axis=1)),
        sensed_tilt_deg=(sensed[0].mean(axis=1), sensed[1].mean(axis=1)),
        declination_deg=ground.field.at(time_s)[0],
        in_water=np.ones(time_s.size, dtype=bool),
    )


STRENGTHS = (0.05, 0.1, 0.2, 0.35, 0.55)  # field of the iron relative to the earth's horizontal field
WIDE = Climate(mean_m_s=0.12, tide_m_s=0.16, red_m_s=0.10, cyclone_m_s=0.15)
NARROW = Climate(mean_m_s=0.30, tide_m_s=0.08, red_m_s=0.06, cyclone_m_s=0.30)


@dataclass(frozen=True)
class Wish:
    """Requested properties of a mooring; those that are None are drawn at random."""

    wide: bool = False  # headings over the full circle, or over about seventy degrees of it
    hours: int = 8800
    site: tuple[float, float, float] | None = None  # latitude, longitude, water depth in metres
    begin_s: float | None = None  # of the deployment
    strength: float | None = None  # field of the iron relative to the earth's horizontal field


@dataclass(frozen=True, eq=False)
class Ground:
    """One mooring without planted effects; series on the time axis of the water, (g,)."""

    seed: int
    name: str
    latitude_deg: float
    longitude_deg: float
    water_depth_m: float
    field: Field
    currents: water.Water
    motion: water.Motion
    meter: Magnetometer
    temperature_c: Floats
    supply_counts: Floats
    stamp_s: Floats  # (n,) full hours of the deployment

    def random(self, purpose: str) -> np.random.Generator:
        return water.stream(self.seed, self.name, purpose)


def make(seed: int, name: str, wish: Wish) -> Ground:
    """Draw a mooring at random with the requested properties."""
    rng = water.stream(seed, name, "ground")
    latitude, longitude = float(rng.uniform(52.0, 68.0)), float(rng.uniform(-45.0, 5.0))
    depth = float(rng.uniform(250.0, 700.0))
    latitude, longitude, depth = wish.site or (latitude, longitude, depth)
    begin = 1.1676e9 + DAY_S * int(rng.integers(0, 4000))  # from January 2007 on
    begin = begin if wish.begin_s is None else wish.begin_s
    stamps = begin + HOUR_S * np.arange(wish.hours, dtype=float)
    span = (begin - 6 * HOUR_S, float(stamps[-1]) + 6 * HOUR_S)
    field = compass.earth_field(latitude, longitude, span)
    climate = replace(WIDE if wish.wide else NARROW, along_deg=float(rng.uniform(0, 360)))
    currents = water.make_water(seed, name, climate, site=(latitude, depth), span_s=span)
    speed = np.abs(currents.surface + currents.column)
    # The shear between depths increases with speed, as in real records.
    currents = replace(currents, layers=currents.layers.times(0.6 + speed / 0.6))
    declination, horizontal, vertical = (float(x.mean()) for x in field.at(stamps))
    lean = rng.uniform(-4.0, 4.0, 2).tolist()
    rig = Rig(500.0 + 1.7 * depth, float(rng.uniform(0, 360)), float(rng.uniform(22, 32)), *lean)
    motion = water.make_motion(seed, name, rig, currents, declination_deg=declination)
    strength = float(rng.choice(STRENGTHS)) if wish.strength is None else wish.strength
    meter = compass.build(rng, (horizontal, vertical), strength)
    rng, grid = water.stream(seed, name, "temperature"), currents.time_s
    season = 1.5 * np.cos(2 * np.pi * (grid / DAY_S / 365.25 + rng.uniform()))
    weather = red_noise(rng, grid.size, memory=10 * DAY_S / water.STEP_S, deviation=0.6)
    temperature = 4.0 + season + weather - 0.4 * (motion.sphere_depth_m - 100.0) / 100.0
    rng, used = water.stream(seed, name, "supply"), (grid - grid[0]) / (grid[-1] - grid[0])
    warm = 0.4 * (temperature - temperature.mean())
    supply = 166.0 - rng.uniform(12.0, 22.0) * used - rng.uniform(7.0, 14.0) * used**6 + warm
    return Ground(seed, name, latitude, longitude, depth, field, currents, motion, meter, temperature, supply, stamps)


def trusted_heading(ground: Ground) -> Floats:
    """Simulate the correct heading of the reference, which turns independently, at full hours, degrees, (n,)."""
    rng = ground.random("deep heading")
    return angles.wrap360(180.0 + red_noise(rng, ground.stamp_s.size, memory=30.0, deviation=120.0))


DEEP_SAMPLE_S = 180.0  # by which the samples of the simulated reference follow those of the profiler
TOP = Setup(
    kilohertz=300, looks_up=True, cells=8, cell_m=2.0, blank_m=0.88, first_bin_m=3.1, pings=PINGS,
    coordinates="earth", serial=9001,
)  # fmt: skip
DEEP = replace(TOP, looks_up=False, cells=3, pings=40, serial=7501, noise_m_s=0.02, sample_s=DEEP_SAMPLE_S)


@dataclass(frozen=True, eq=False)
class Written:
    """Correct and recorded headings of the affected compass at the samples in the file, (m,) each."""

    time_s: Floats  # as stamped in the file
    heading_deg: Floats  # correct, magnetic; NaN while the compass was stuck, where no model can predict it
    recorded_deg: Floats


def write(ground: Ground, effects: Sequence[Effect], raw: Path, setup: Setup = TOP) -> Written:
    """Write ``top.000``, with a stuck compass for nine hours and four gaps, and ``deep.000``; return the truth."""
    raw.mkdir(parents=True, exist_ok=True)
    top, count = read(ground, effects, ground.stamp_s, ground.random("readings")), ground.stamp_s.size
    begin = int(ground.random("stuck").integers(0, count - 9))
    stuck = slice(begin, begin + 9)
    top.recorded_deg[stuck] = top.recorded_deg[begin]
    rng, present = ground.random("gaps"), np.ones(count, dtype=bool)
    for gap, length in zip(rng.integers(0, count, 4), rng.integers(1, 40, 4), strict=True):
        present[gap : gap + length] = False
    rng, grid, site = ground.random("logged"), ground.currents.time_s, {"latitude_deg": ground.latitude_deg}
    warm = np.interp(top.time_s, grid, ground.temperature_c)
    volts = np.interp(top.time_s, grid, ground.supply_counts)
    recorded = replace(
        adcp.measure(ground.random("top"), setup, top, ground.currents, **site),
        temperature_c=warm + rng.normal(0.0, 0.02, count),
        supply_counts=np.rint(volts + rng.normal(0.0, 0.5, count)).astype(np.uint8),
    )
    logged = Ensembles(**{name: column[present] for name, column in vars(recorded).items()})
    adcp.write(raw / "top.000", setup, logged)
    made = adcp.measure(ground.random("deep"), DEEP, deep_stance(ground, effects), ground.currents, **site)
    adcp.write(raw / "deep.000", DEEP, made)
    heading = top.heading_deg.copy()
    heading[stuck] = np.nan
    return Written(ground.stamp_s[present], heading[present], recorded.heading_deg[present])


def deep_stance(ground: Ground, effects: Sequence[Effect]) -> Stance:
    """Simulate the reference: its depth, attitude, and recorded headings."""
    rng = ground.random("deep compass")
    time = ground.stamp_s + DEEP_SAMPLE_S
    sphere = np.interp(time, ground.motion.time_s, ground.motion.sphere_depth_m)
    heading = trusted_heading(ground)
    tilts = [mean + red_noise(rng, time.size, memory=6.0, deviation=0.5) for mean in (1.5, -1.2)]
    wrong = sum((effect.trusted(heading) for effect in effects if effect.trusted is not None), np.zeros(time.size))
    return Stance(
        time_s=time,
        depth_m=sphere + 4.0,
        heading_deg=heading,
        recorded_deg=angles.wrap360(heading + wrong + rng.normal(0.0, 0.5, time.size)),
        tilt_deg=(tilts[0], tilts[1]),
        sensed_tilt_deg=(tilts[0], tilts[1]),
        declination_deg=ground.field.at(time)[0],
        in_water=np.ones(time.size, dtype=bool),
        gain=sum(effect.gain for effect in effects),
        bias_m_s=sum(effect.bias_m_s for effect in effects),
    )
