"""The demonstration cruise: seven simulated moorings, written as the raw files that their instruments would leave."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from compasslib.nature import adcp as sounder
from compasslib.nature import compass, mmp, mooring, pd0, profiler, water
from compasslib.nature.adcp import Adcp, Stance
from compasslib.nature.compass import Field, Iron
from compasslib.nature.fleet import DEPLOYED_S, MOORINGS, RECOVERED_S, MooringSpec
from compasslib.nature.mooring import Motion
from compasslib.nature.profiler import Profiler
from compasslib.nature.series import DAY_S, HOUR_S, Floats, circle, direction, red_noise, stream, white_vector
from compasslib.nature.water import Water

ON_DECK_S = DAY_S
SPAN_S = (DEPLOYED_S - ON_DECK_S, RECOVERED_S + ON_DECK_S + HOUR_S)
DEEP_BELOW_SPHERE_M = 4.0


@dataclass(frozen=True)
class World:
    """What surrounds the instruments of one mooring."""

    spec: MooringSpec
    seed: int
    field: Field
    currents: Water
    motion: Motion

    def random(self, purpose: str) -> np.random.Generator:
        """Return the generator of one purpose on this mooring.

        Args:
            purpose: what the numbers are for.
        """
        return stream(self.seed, self.spec.name, purpose)


def write_mooring(name: str, raw_dir: Path | str, truth_path: Path | str, seed: int = 2007) -> None:
    """Write one mooring's raw files and, elsewhere, the truth about its upper compass.

    Args:
        name: EG1 to EG7.
        raw_dir: the cruise's folder of raw files; the mooring's stand in ``raw_dir/name``.
        truth_path: CSV of what the analysis is to find.
        seed: the same seed gives the same bytes, whichever other moorings are made.
    """
    world = make_world(spec_of(name), seed)
    folder = Path(raw_dir) / name
    folder.mkdir(parents=True, exist_ok=True)
    Path(truth_path).parent.mkdir(parents=True, exist_ok=True)
    stance = top_stance(world)
    _write_adcp(folder / "top.000", world, "top", world.spec.top, stance)
    _write_truth(Path(truth_path), world, stance)
    if isinstance(world.spec.deep, Adcp):
        _write_adcp(folder / "deep.000", world, "deep", world.spec.deep, deep_stance(world, world.spec.deep))
    else:
        _write_profiler(folder, world, world.spec.deep)


def raw_files(name: str) -> tuple[str, ...]:
    """Return the files of one mooring, relative to the cruise's folder of raw files.

    Args:
        name: EG1 to EG7.
    """
    deep = spec_of(name).deep
    if isinstance(deep, Adcp):
        return f"{name}/top.000", f"{name}/deep.000"
    return f"{name}/top.000", f"{name}/{_acm_file(deep)}", f"{name}/engineering.csv"


def spec_of(name: str) -> MooringSpec:
    """Return the specification of a mooring.

    Args:
        name: EG1 to EG7.
    """
    return {spec.name: spec for spec in MOORINGS}[name]


def make_world(spec: MooringSpec, seed: int) -> World:
    """Return field, currents and motion of one mooring.

    Args:
        spec: the mooring.
        seed: seed of the cruise.
    """
    field = compass.earth_field(spec.latitude_deg, spec.longitude_deg, SPAN_S)
    site = (spec.latitude_deg, spec.water_depth_m)
    currents = water.make_water(seed, spec.name, spec.climate, site=site, span_s=SPAN_S)
    declination = float(field.declination_deg.mean())
    motion = mooring.make_motion(seed, spec.name, spec.rig, currents, declination_deg=declination)
    return World(spec, seed, field, currents, motion)


def top_stance(world: World) -> Stance:
    """Return how the upper ADCP stands, its heading recorded beside the sphere's iron.

    Args:
        world: what surrounds it.
    """
    time, motion = _hourly(world.spec.top), world.motion
    depth, heading, pitch, roll = (
        np.interp(time, motion.time_s, series)
        for series in (motion.sphere_depth_m, motion.heading_deg, motion.pitch_deg, motion.roll_deg)
    )
    rng = world.random("top compass")
    return _stance(rng, time, (depth, depth), (heading, pitch, roll), iron=world.spec.iron, field=world.field)


def deep_stance(world: World, instrument: Adcp) -> Stance:
    """Return how the lower ADCP stands: on the bottom, where it turns slowly, or hanging under the sphere.

    Args:
        world: what surrounds it.
        instrument: the lower ADCP.
    """
    motion, rng, time = world.motion, world.random("deep compass"), _hourly(instrument)
    sphere = np.interp(time, motion.time_s, motion.sphere_depth_m)
    if world.spec.deep_depth_m:
        depth = world.spec.deep_depth_m + water.sea_level(time)
        heading = 180.0 + red_noise(rng, time.size, memory=100.0, deviation=150.0)
    else:
        depth = sphere + DEEP_BELOW_SPHERE_M
        heading = np.interp(time, motion.time_s, _hanging_heading(rng, world))
    pitch, roll = (mean + red_noise(rng, time.size, memory=6.0, deviation=0.5) for mean in (1.5, -1.2))
    return _stance(rng, time, (depth, sphere), (heading, pitch, roll), iron=Iron(), field=world.field)


def _acm_file(instrument: Profiler) -> str:
    return "acm.dat" if instrument.binary else "acm.txt"


def _hourly(instrument: Adcp) -> Floats:
    hours = round((RECOVERED_S - DEPLOYED_S + 2 * ON_DECK_S) / HOUR_S)
    return DEPLOYED_S - ON_DECK_S + HOUR_S * np.arange(hours + 1, dtype=float) + instrument.sample_s


def _hanging_heading(rng: np.random.Generator, world: World) -> Floats:
    motion = world.motion
    below = motion.sphere_depth_m + DEEP_BELOW_SPHERE_M
    flow = water.velocity(world.currents, motion.time_s, below, motion.sphere_depth_m)
    rest = direction(flow) - world.field.at(motion.time_s)[0] + 75.0
    return mooring.wake_heading(rng, rest, np.abs(flow), wobble_deg=25.0)


def _stance(
    rng: np.random.Generator,
    time_s: Floats,
    depths_m: tuple[Floats, Floats],
    attitude_deg: tuple[Floats, Floats, Floats],
    *,
    iron: Iron,
    field: Field,
) -> Stance:
    """Return a stance with its compass read; depths of instrument and sphere, attitude heading, pitch and roll."""
    in_water = (time_s >= DEPLOYED_S) & (time_s <= RECOVERED_S)
    declination, *strength = field.at(time_s)
    heading, *tilt = attitude_deg
    noise = rng.normal(0.0, compass.TILT_NOISE_DEG, (2, time_s.size))
    sensed = (tilt[0] + noise[0], tilt[1] + noise[1])
    recorded = compass.recorded_heading(
        (strength[0], strength[1]), heading, tilt_deg=(tilt[0], tilt[1]), sensed_tilt_deg=sensed, iron=iron
    )
    # On deck the instrument lies still, beside other iron.
    recorded = np.where(in_water, recorded, 137.0) + rng.normal(0.0, compass.NOISE_DEG, time_s.size)
    return Stance(
        time_s=time_s,
        depth_m=depths_m[0],
        sphere_depth_m=depths_m[1],
        heading_deg=circle(heading),
        recorded_deg=circle(recorded),
        tilt_deg=(tilt[0], tilt[1]),
        sensed_tilt_deg=sensed,
        declination_deg=declination,
        in_water=in_water,
        turbulence=white_vector(rng, time_s.size, water.TURBULENCE_M_S),
    )


def _write_adcp(path: Path, world: World, purpose: str, instrument: Adcp, stance: Stance) -> None:
    rng = world.random(purpose)
    pd0.write(
        path,
        instrument.setup,
        sounder.measure(rng, instrument, stance, world.currents, latitude_deg=world.spec.latitude_deg),
    )


def _write_profiler(folder: Path, world: World, instrument: Profiler) -> None:
    spec, motion = world.spec, world.motion
    schedule = profiler.plan(world.random("profiler"), instrument, motion, (DEPLOYED_S, RECOVERED_S))
    scans = profiler.log(world.random("acm"), schedule, world.currents, motion, field=world.field)
    meter = mmp.Acm(instrument.serial, f"ML{instrument.serial}-01D", spec.latitude_deg, spec.longitude_deg)
    write = mmp.write_binary if instrument.binary else mmp.write_text
    write(folder / _acm_file(instrument), meter, scans)
    profiler.write_engineering(folder / "engineering.csv", schedule, motion, spec.latitude_deg)


def _write_truth(path: Path, world: World, stance: Stance) -> None:
    wet = stance.in_water
    current = sounder.near_bins(world.spec.top.setup, stance, world.currents)
    stamps = np.datetime_as_string(stance.time_s[wet].astype("datetime64[s]")).tolist()
    columns = (stance.heading_deg, stance.recorded_deg, current.real, current.imag, stance.depth_m)
    rows = zip(stamps, *(column[wet].tolist() for column in columns), strict=True)
    lines = ("{}Z,{:.3f},{:.2f},{:.4f},{:.4f},{:.2f}\n".format(*row) for row in rows)
    header = "time_utc,heading_true_magnetic_deg,recorded_heading_deg,east_true_m_s,north_true_m_s,depth_m\n"
    path.write_text(header + "".join(lines))
