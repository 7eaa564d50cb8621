"""Demonstration cruise: seven simulated moorings, written as the raw files of their instruments."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from compasslib import angles
from compasslib.demo import adcp, compass, profiler, water
from compasslib.demo.adcp import Setup, Stance
from compasslib.demo.compass import Field, Iron
from compasslib.demo.profiler import Profiler
from compasslib.demo.water import Climate, Rig, red_noise
from compasslib.types import DAY_S, HOUR_S, Floats

DEPLOYED_S, RECOVERED_S = 1188864000.0, 1223078400.0  # 4 September 2007 and 4 October 2008, 00:00 UTC
ON_DECK_S = DAY_S
SPAN_S = (DEPLOYED_S - ON_DECK_S, RECOVERED_S + ON_DECK_S + HOUR_S)


@dataclass(frozen=True)
class World:
    """Simulated environment of the instruments of one mooring."""

    spec: MooringSpec
    seed: int
    field: Field
    currents: water.Water
    motion: water.Motion

    def random(self, purpose: str) -> np.random.Generator:
        return water.stream(self.seed, self.spec.name, purpose)


def write_mooring(name: str, raw_dir: Path | str, truth_path: Path | str, seed: int = 2007) -> None:
    """Write the raw files of one mooring into ``raw_dir/name``, the same by the same seed, and the true headings."""
    world = make_world(MOORINGS[name], seed)
    folder = Path(raw_dir) / name
    folder.mkdir(parents=True, exist_ok=True)
    Path(truth_path).parent.mkdir(parents=True, exist_ok=True)
    stance, spec, currents, motion = top_stance(world), world.spec, world.currents, world.motion
    deep, site, wet = spec.deep, {"latitude_deg": spec.latitude_deg}, stance.in_water
    measured = adcp.measure(world.random("top"), spec.top, stance, currents, **site)
    adcp.write(folder / "top.000", spec.top, measured)
    current = adcp.near_bins(spec.top, stance, currents)
    stamps = np.datetime_as_string(stance.time_s[wet].astype("datetime64[s]")).tolist()
    columns = (stance.heading_deg, stance.recorded_deg, current.real, current.imag, stance.depth_m)
    rows = zip(stamps, *(column[wet].tolist() for column in columns), strict=True)
    lines = ("{}Z,{:.3f},{:.2f},{:.4f},{:.4f},{:.2f}\n".format(*row) for row in rows)
    header = "time_utc,heading_true_magnetic_deg,recorded_heading_deg,east_true_m_s,north_true_m_s,depth_m\n"
    Path(truth_path).write_text(header + "".join(lines))
    if isinstance(deep, Setup):
        measured = adcp.measure(world.random("deep"), deep, deep_stance(world, deep), currents, **site)
        adcp.write(folder / "deep.000", deep, measured)
    else:
        schedule = profiler.plan(world.random("profiler"), deep, motion, (DEPLOYED_S, RECOVERED_S))
        scans = profiler.log(world.random("acm"), schedule, currents, motion, field=world.field)
        meter = profiler.Acm(deep.serial, f"ML{deep.serial}-01D", spec.latitude_deg, spec.longitude_deg)
        write = profiler.write_binary if deep.binary else profiler.write_text
        write(folder / ("acm.dat" if deep.binary else "acm.txt"), meter, scans)
        profiler.write_engineering(folder / "engineering.csv", schedule, motion, spec.latitude_deg)


def make_world(spec: MooringSpec, seed: int) -> World:
    """Simulate the earth's field, the currents and the motion of a mooring."""
    field = compass.earth_field(spec.latitude_deg, spec.longitude_deg, SPAN_S)
    site = (spec.latitude_deg, spec.water_depth_m)
    currents = water.make_water(seed, spec.name, spec.climate, site=site, span_s=SPAN_S)
    declination = float(field.declination_deg.mean())
    motion = water.make_motion(seed, spec.name, spec.rig, currents, declination_deg=declination)
    return World(spec, seed, field, currents, motion)


def top_stance(world: World) -> Stance:
    """Simulate depth and attitude of the upper ADCP, with its heading recorded near the iron of the sphere."""
    time, motion = _hourly(world.spec.top), world.motion
    depth, heading, pitch, roll = (
        np.interp(time, motion.time_s, series)
        for series in (motion.sphere_depth_m, motion.heading_deg, motion.pitch_deg, motion.roll_deg)
    )
    return _stance(
        world.random("top compass"), time, depth, (heading, pitch, roll), iron=world.spec.iron, field=world.field
    )


def deep_stance(world: World, instrument: Setup) -> Stance:
    """Simulate depth and attitude of the lower ADCP, turning slowly on the bottom or hanging under the sphere."""
    motion, rng, time = world.motion, world.random("deep compass"), _hourly(instrument)
    sphere = np.interp(time, motion.time_s, motion.sphere_depth_m)
    if world.spec.deep_depth_m:
        depth = world.spec.deep_depth_m + water.sea_level(time)
        heading = 180.0 + red_noise(rng, time.size, memory=100.0, deviation=150.0)
    else:
        depth = sphere + 4.0
        flow = water.velocity(world.currents, motion.time_s, motion.sphere_depth_m + 4.0)
        equilibrium = water.direction(flow) - world.field.at(motion.time_s)[0] + 75.0
        hanging = water.wake_heading(rng, equilibrium, np.abs(flow), wobble_deg=25.0)
        heading = np.interp(time, motion.time_s, hanging)
    pitch, roll = (mean + red_noise(rng, time.size, memory=6.0, deviation=0.5) for mean in (1.5, -1.2))
    return _stance(rng, time, depth, (heading, pitch, roll), iron=Iron(), field=world.field)


def _hourly(instrument: Setup) -> Floats:
    hours = round((RECOVERED_S - DEPLOYED_S + 2 * ON_DECK_S) / HOUR_S)
    return DEPLOYED_S - ON_DECK_S + HOUR_S * np.arange(hours + 1, dtype=float) + instrument.sample_s


def _stance(
    rng: np.random.Generator,
    time_s: Floats,
    depth_m: Floats,
    attitude_deg: tuple[Floats, Floats, Floats],
    *,
    iron: Iron,
    field: Field,
) -> Stance:
    in_water = (time_s >= DEPLOYED_S) & (time_s <= RECOVERED_S)
    declination, *strength = field.at(time_s)
    heading, *tilt = attitude_deg
    noise, true = rng.normal(0.0, 0.05, (2, time_s.size)), (tilt[0], tilt[1])
    sensed = (tilt[0] + noise[0], tilt[1] + noise[1])
    field_nt = (strength[0], strength[1])
    recorded = compass.recorded_heading(field_nt, heading, tilt_deg=true, sensed_tilt_deg=sensed, iron=iron)
    # On deck the instrument does not move and is near other iron.
    recorded = np.where(in_water, recorded, 137.0) + rng.normal(0.0, 0.5, time_s.size)
    return Stance(
        time_s=time_s,
        depth_m=depth_m,
        heading_deg=angles.wrap360(heading),
        recorded_deg=angles.wrap360(recorded),
        tilt_deg=true,
        sensed_tilt_deg=sensed,
        declination_deg=declination,
        in_water=in_water,
    )


# The seven moorings of the demonstration cruise: positions and simulated conditions.
#
# Positions, depths and kinds of instruments are those of von Appen (2015), Table 1; currents, iron and serial numbers
# are invented. Two properties differ from the table: The bins of EG4's lower instrument begin nearer than its 114 m,
# because the means of two bins at 90 m and at 118 m would give no pair within 20 m; and no lower instrument on the
# bottom has a bin above the sphere in still water.


@dataclass(frozen=True)
class MooringSpec:
    """One mooring: position, currents, rig, iron near the upper compass, and both instruments."""

    name: str
    latitude_deg: float
    longitude_deg: float
    water_depth_m: float
    climate: Climate
    rig: Rig
    iron: Iron
    top: Setup
    deep: Setup | Profiler
    deep_depth_m: float = 0.0  # of a lower ADCP on the bottom; 0 if it hangs under the sphere


TOP = Setup(
    kilohertz=300, looks_up=True, cells=27, cell_m=4.0, blank_m=0.88, first_bin_m=5.1, pings=60,
    coordinates="earth", serial=8101,
)  # fmt: skip
WORKHORSE = replace(TOP, blank_m=4.0, first_bin_m=8.2, pings=45, noise_m_s=0.015)
LONG_RANGER = replace(TOP, kilohertz=75, pings=40, noise_m_s=0.02)


def _iron(*, hard_nt: tuple[float, float, float], soft_percent: tuple[tuple[float, float, float], ...]) -> Iron:
    return Iron(hard_nt, tuple((*row,) for row in (np.eye(3) + 0.01 * np.array(soft_percent)).tolist()))


_SPECS = (
    # On the shelf: weak flow, strong tides, headings over the full circle; iron of a third of the horizontal field.
    MooringSpec(
        "EG1", 65 + 30.0 / 60, -(33 + 8.8 / 60), 248.0,
        climate=Climate(mean_m_s=0.16, tide_m_s=0.14, cyclone_m_s=0.05),
        rig=Rig(2500.0, heading_offset_deg=40.0, wobble_deg=24.0, rest_pitch_deg=-3.6, rest_roll_deg=-3.2),
        iron=_iron(hard_nt=(3300.0, -1500.0, -1200.0),
                   soft_percent=((1.5, 0.4, 0.3), (0.2, -0.8, -0.4), (0.3, -0.2, 1.0))),
        top=TOP, deep=replace(WORKHORSE, serial=8111, cells=35, sample_s=300.0), deep_depth_m=248.0,
    ),
    # The small deviation of von Appen (2015), Fig. 6: a tenth of the horizontal field.
    MooringSpec(
        "EG2", 65 + 26.6 / 60, -(33 + 4.5 / 60), 268.0,
        climate=Climate(mean_m_s=0.18, tide_m_s=0.12, cyclone_m_s=0.08),
        rig=Rig(2500.0, heading_offset_deg=160.0, wobble_deg=22.0, rest_pitch_deg=4.0, rest_roll_deg=-2.6),
        iron=_iron(hard_nt=(-600.0, 900.0, 500.0),
                   soft_percent=((0.8, 0.2, -0.1), (0.3, -0.4, 0.2), (-0.1, 0.1, 0.5))),
        top=replace(TOP, serial=8102), deep=replace(WORKHORSE, serial=8112, cells=40, sample_s=240.0),
        deep_depth_m=268.0,
    ),
    # Half of the horizontal field; the upper instrument records in beam coordinates.
    MooringSpec(
        "EG3", 65 + 23.2 / 60, -(33 + 1.0 / 60), 524.0,
        climate=Climate(mean_m_s=0.22, cyclone_m_s=0.28),
        rig=Rig(2000.0, heading_offset_deg=-75.0, wobble_deg=20.0, rest_pitch_deg=-2.5, rest_roll_deg=3.6),
        iron=_iron(hard_nt=(4200.0, 4100.0, -2500.0),
                   soft_percent=((2.0, -0.6, 0.4), (0.5, -1.5, 0.5), (0.3, 0.4, 1.5))),
        top=replace(TOP, serial=8103, coordinates="beam"), deep_depth_m=524.0,
        deep=replace(LONG_RANGER, serial=7513, cells=52, cell_m=8.0, blank_m=2.0, first_bin_m=10.0, sample_s=420.0),
    ),
    # The large one of Fig. 7, whose fitted series folds as published: it is inverted from 29 to 84 degrees.
    # Three times the field, at headings where the reading decreases (beta near arg p + 180).
    MooringSpec(
        "EG4", 65 + 20.0 / 60, -(32 + 57.3 / 60), 894.0,
        climate=Climate(mean_m_s=0.28, cyclone_m_s=0.35),
        rig=Rig(2900.0, heading_offset_deg=-34.0, wobble_deg=18.0, rest_pitch_deg=-3.0, rest_roll_deg=3.4),
        iron=_iron(hard_nt=(21500.0, -32000.0, 2000.0),
                   soft_percent=((2.2, -1.9, 0.3), (-1.9, -2.2, -0.4), (0.2, 0.5, 1.0))),
        top=replace(TOP, serial=8104),
        deep=replace(LONG_RANGER, serial=7514, looks_up=False, cells=86, blank_m=1.6, first_bin_m=5.6, sample_s=120.0),
    ),
    # Three quarters of the horizontal field, with vertical iron that affects the heading when tilted.
    MooringSpec(
        "EG5", 65 + 16.2 / 60, -(32 + 52.7 / 60), 1163.0,
        climate=Climate(mean_m_s=0.27, cyclone_m_s=0.40),
        rig=Rig(3600.0, heading_offset_deg=110.0, wobble_deg=20.0, rest_pitch_deg=-3.0, rest_roll_deg=-3.0),
        iron=_iron(hard_nt=(-8300.0, 2500.0, 6000.0),
                   soft_percent=((2.5, 0.8, -0.5), (-0.6, -1.0, 0.4), (0.4, -0.3, 2.0))),
        top=replace(TOP, serial=8105), deep=Profiler(first_s=0.0, bottom_m=1158.0, binary=False, serial=1405),
    ),
    # 1.5 times the field, at headings where the compass turns too little (beta within 130 degrees of arg p).
    MooringSpec(
        "EG6", 65 + 12.3 / 60, -(32 + 47.0 / 60), 1378.0,
        climate=Climate(mean_m_s=0.25, cyclone_m_s=0.40),
        rig=Rig(4800.0, heading_offset_deg=150.0, wobble_deg=18.0, rest_pitch_deg=4.0, rest_roll_deg=-2.0),
        iron=_iron(hard_nt=(-4000.0, -17500.0, -2000.0),
                   soft_percent=((1.5, -0.5, 0.5), (0.8, -1.8, 0.3), (0.1, 0.4, 1.2))),
        top=replace(TOP, serial=8106), deep=Profiler(first_s=2880.0, bottom_m=1373.0, binary=True, serial=1406),
    ),
    MooringSpec(
        "EG7", 65 + 7.3 / 60, -(32 + 41.1 / 60), 1585.0,
        climate=Climate(mean_m_s=0.22, cyclone_m_s=0.38),
        rig=Rig(5200.0, heading_offset_deg=15.0, wobble_deg=22.0, rest_pitch_deg=-3.5, rest_roll_deg=2.5),
        iron=_iron(hard_nt=(2000.0, 4700.0, 1800.0),
                   soft_percent=((1.8, 0.3, 0.2), (0.4, -0.9, -0.5), (-0.2, 0.3, 1.0))),
        top=replace(TOP, serial=8107, first_number=60001),
        deep=Profiler(first_s=660.0, bottom_m=1580.0, binary=False, serial=1407),
    ),
)  # fmt: skip
MOORINGS = {spec.name: spec for spec in _SPECS}
