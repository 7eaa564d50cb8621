"""Simulation of repeated deployments of one profiler: same compass, other currents and places, changes of iron."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from compasslib.demo.compass import earth_field
from compasslib.demo.water import Floats
from tests.world import pairs as sea
from tests.world.pairs import Drawn, SlowWater, World

HOUR_S = 3600.0
APART_S = 400 * 86400.0  # from the start of one deployment to that of the next
SAME_SEASON_S = 2 * 365.25 * 86400.0  # the same if all deployments start in the same season


@dataclass(frozen=True)
class Iron:
    """Iron of a compass in physical units."""

    soft: Floats  # (3, 3) on the field, identity without iron
    hard_nT: Floats  # (3,) forward, starboard, down


def some_iron(rng: np.random.Generator) -> Iron:
    """Draw the iron of a profiler with random size and direction."""
    made = sea.iron(rng)
    soft = made["soft"].copy()
    soft[:2, 2] = rng.normal(0.0, 0.01, 2)  # induced by the vertical field
    return Iron(soft, 12000.0 * np.clip(made["hard"], -0.3, 0.3))


def deployments(
    seed: int,
    *,
    count: int = 3,
    between_nT: float = 100.0,
    shared: tuple[str, float] | None = None,
    season_deg: float = 0.0,
    slow_water: SlowWater | None = None,
    hours: int = 8000,
    earth: Sequence[tuple[float, float]] = (),
) -> list[Drawn]:
    """Simulate the recordings of one compass in several deployments.

    Args:
        between_nT: standard deviation of either horizontal component of the hard iron between deployments.
        shared: effect of the instrument and its visible size in the first deployment, rms degrees.
        season_deg: amplitude of a seasonal veer that recurs in every deployment; 0 for none.
        hours: length of each deployment.
        earth: horizontal and vertical field of each deployment, nT; drawn at random if empty.
    """
    rng = np.random.default_rng(seed)
    iron = some_iron(rng)
    step = APART_S if not season_deg else SAME_SEASON_S
    worlds = [
        _moored(1000 * seed + k, iron, rng.normal(0.0, between_nT, 2), begin_s=step * k, hours=hours, water=slow_water)
        for k in range(count)
    ]
    worlds = (
        [replace(w, earth=field, hard=w.hard * w.earth[0] / field[0]) for w, field in zip(worlds, earth, strict=True)]
        if earth
        else worlds
    )
    phase = float(rng.uniform(0.0, 360.0))
    if season_deg:
        worlds = [_in_season(world, season_deg, phase) for world in worlds]
    if shared is None:
        return [sea.planted(world, {}) for world in worlds]
    name, size_deg = shared
    made = [sea.effect(replace(world, rng=np.random.default_rng(seed)), name) for world in worlds]
    unit = max(sea.visible(worlds[0], made[0], 1.0), 0.02)
    return [_with(world, name, part, size_deg / unit) for world, part in zip(worlds, made, strict=True)]


def _moored(seed: int, iron: Iron, changed_nT: Floats, *, begin_s: float, hours: int, water: SlowWater | None) -> World:
    world = sea.make(seed, wide=True, n=hours, slow_water=water)
    hard = iron.hard_nT + np.append(changed_nT, 0.0)
    moved = world.time_s - world.time_s[0] + sea.BEGIN_S + begin_s
    return replace(world, time_s=moved, soft=iron.soft, hard=hard / world.earth[0])


def _in_season(world: World, veer_deg: float, phase_deg: float) -> World:
    """Add a seasonal veer of the lower current, and make the temperature follow the same season."""
    turn = np.cos(2.0 * np.pi * world.time_s / (sea.YEAR_H * HOUR_S) + phase_deg * sea.RAD)
    lower = sea.turned(world.flow + world.difference, veer_deg * turn)
    quick = world.temperature - 1.5 * np.cos(2.0 * np.pi * world.hours / sea.YEAR_H)
    calm = 4.0 + 1.5 * turn + 0.3 * (quick - quick.mean())
    return replace(world, difference=lower - world.flow, temperature=calm)


def _with(world: World, name: str, part: sea.Effect, size: float) -> Drawn:
    """Simulate the recording with an effect whose physical size is the same in every deployment."""
    bare = sea.planted(world, {})
    gamma, _, _ = sea.combined(world, [(part, size)])
    gamma = gamma + world.rng.normal(0.0, 0.5, gamma.size)
    upper = sea.turned(world.flow, sea.wrap(gamma - world.heading))
    pairs = replace(bare.pairs, heading_deg=gamma % 360.0, upper_east=upper.real, upper_north=upper.imag)
    truth = {name: {key: value * size for key, value in part.parameters.items()}}
    visible = {name: sea.visible(world, part, size)}
    return replace(bare, pairs=pairs, truth=truth, visible_deg=visible, parts=[(part, size)])


# The example cruise: two complete deployments, one whose reference failed early, one without, and a bench calibration.

PLACES = {"R1": (65.3333, -32.955), "R2": (60.0, -40.0), "R3": (66.5, -25.0), "R4": (64.0, -30.0)}
METER_FAILED_S = 21 * 86400.0  # reference of R3, after the start; R4 has none
BENCH, BENCH_PLACE, BENCH_S = "deck", (64.15, -21.9), 1187600400.0  # 20 August 2007, before R1
BENCH_SIGMA_DEG = 0.4
EFFECT, SIZE_DEG = "octantal", 0.8
BATTERIES_NT = 120.0


def write_cruise(folder: Path | str, seed: int = 1, *, hours: int = 8000, every: int = 3) -> None:
    """Write the raw tables of four deployments and of a bench calibration, and separately the truth.

    Args:
        folder: folder of the cruise; files are written to ``raw`` and ``truth``.
        seed: the same seed gives the same bytes.
        hours: length of each deployment.
        every: interval between samples, in hours.
    """
    begins = [sea.BEGIN_S + APART_S * k for k in range(len(PLACES))]
    earth = [_earth(place, begin) for place, begin in zip(PLACES.values(), begins, strict=True)]
    drawn = deployments(seed, count=4, between_nT=BATTERIES_NT, shared=(EFFECT, SIZE_DEG), hours=hours, earth=earth)
    for name, one, begin in zip(PLACES, drawn, begins, strict=True):
        _write_mooring(Path(folder), name, one, begin, every)
    _write_bench(Path(folder), seed, drawn[0])


def _earth(place: tuple[float, float], time_s: float) -> tuple[float, float]:
    _, horizontal, vertical = earth_field(*place, (time_s, time_s + sea.YEAR_H * HOUR_S)).at(np.array([time_s + 1e7]))
    return float(horizontal[0]), float(vertical[0])


def _write_mooring(folder: Path, name: str, one: Drawn, begin_s: float, every: int) -> None:
    some, pairs = slice(None, None, every), one.pairs
    stamps = _stamps(pairs.time_s[some])
    top = {"heading_deg": pairs.heading_deg, "pitch_deg": pairs.pitch_deg, "roll_deg": pairs.roll_deg,
           "temperature_c": one.covariates["temperature"], "depth_m": pairs.upper_depth_m,
           "east_m_s": pairs.upper_east, "north_m_s": pairs.upper_north}  # fmt: skip
    deep = {"depth_m": pairs.lower_depth_m, "east_m_s": pairs.lower_east, "north_m_s": pairs.lower_north}
    _table(folder / "raw" / name / "top.csv", stamps, {key: column[some] for key, column in top.items()})
    seen = pairs.time_s[some] - begin_s < (METER_FAILED_S if name == "R3" else np.inf)
    if name != "R4":
        kept = [stamp for stamp, there in zip(stamps, seen, strict=True) if there]
        _table(folder / "raw" / name / "deep.csv", kept, {key: column[some][seen] for key, column in deep.items()})
    _table(folder / "truth" / f"{name}.csv", stamps, {"heading_true_magnetic_deg": one.heading[some]})


def _write_bench(folder: Path, seed: int, first: Drawn) -> None:
    """Write a bench calibration on deck: the level sphere at 24 headings, with the batteries of the first mooring."""
    assert first.world is not None
    rng, turned = np.random.default_rng([seed, 24]), np.arange(0.0, 360.0, 15.0)
    earth = _earth(BENCH_PLACE, BENCH_S)
    zero = np.zeros((2, len(turned)))
    world = replace(first.world, earth=earth, heading=turned, tilt=zero, sensed=zero,
                    hard=first.world.hard * first.world.earth[0] / earth[0])  # fmt: skip
    recorded, _, _ = sea.combined(world, first.parts)
    columns = {
        "reference_deg": turned,
        "recorded_deg": (recorded + rng.normal(0.0, BENCH_SIGMA_DEG, len(turned))) % 360.0,
    }
    _table(folder / "raw" / f"{BENCH}.csv", None, columns)


def _stamps(time_s: Floats) -> list[str]:
    return [datetime.fromtimestamp(round(t), UTC).strftime("%Y-%m-%dT%H:%M:%SZ") for t in time_s.tolist()]


def _table(path: Path, stamps: list[str] | None, columns: dict[str, Floats]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="", encoding="utf-8") as stream:
        rows = csv.writer(stream, lineterminator="\n")
        rows.writerow([*(["time_utc"] if stamps is not None else []), *columns])
        for k, values in enumerate(zip(*columns.values(), strict=True)):
            rows.writerow([*([stamps[k]] if stamps is not None else []), *(f"{value:.4f}" for value in values)])
