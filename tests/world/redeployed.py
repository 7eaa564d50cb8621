"""Simulation of four deployments of one profiler: same compass, other currents, places and batteries.

Two deployments are complete, the reference of one failed early, one has none; and there is a bench calibration.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from compasslib.demo.compass import earth_field
from compasslib.demo.water import Floats
from tests.world import pairs as sea
from tests.world.pairs import Drawn, World

APART_S = 400 * 86400.0  # from the start of one deployment to that of the next
PLACES = {"R1": (65.3333, -32.955), "R2": (60.0, -40.0), "R3": (66.5, -25.0), "R4": (64.0, -30.0)}
METER_FAILED_S = 21 * 86400.0  # reference of R3, after the start; R4 has none
BENCH, BENCH_PLACE, BENCH_S = "deck", (64.15, -21.9), 1187600400.0  # 20 August 2007, before R1
BENCH_SIGMA_DEG = 0.4
EFFECT, SIZE_DEG = "octantal", 0.8
BATTERIES_NT = 120.0


def write_cruise(folder: Path | str, seed: int = 1, *, hours: int = 8000, every: int = 3) -> None:
    """Write raw tables of deployments, sampled every few hours, and of a bench; and separately the truth."""
    begins = [sea.BEGIN_S + APART_S * k for k in range(len(PLACES))]
    earth = [_earth(place, begin) for place, begin in zip(PLACES.values(), begins, strict=True)]
    drawn = _deployments(seed, earth, hours)
    for name, one, begin in zip(PLACES, drawn, begins, strict=True):
        _write_mooring(Path(folder), name, one, begin, every)
    _write_bench(Path(folder), seed, drawn[0])


def _deployments(seed: int, earth: list[tuple[float, float]], hours: int) -> list[Drawn]:
    """Simulate recordings of one compass with one effect of equal physical size; earth: horizontal and vertical nT."""
    rng = np.random.default_rng(seed)
    made = sea.iron(rng)
    soft = made["soft"].copy()
    soft[:2, 2] = rng.normal(0.0, 0.01, 2)  # induced by the vertical field
    hard_nT, worlds = 12000.0 * np.clip(made["hard"], -0.3, 0.3), []
    for k, field in enumerate(earth):
        changed_nT = np.append(rng.normal(0.0, BATTERIES_NT, 2), 0.0)
        world = sea.make(1000 * seed + k, wide=True, n=hours)
        time_s = world.time_s - world.time_s[0] + sea.BEGIN_S + APART_S * k
        worlds.append(replace(world, time_s=time_s, soft=soft, hard=(hard_nT + changed_nT) / field[0], earth=field))
    effects = [sea.effect(replace(world, rng=np.random.default_rng(seed)), EFFECT) for world in worlds]
    size = SIZE_DEG / max(sea.visible(worlds[0], effects[0], 1.0), 0.02)
    return [_with(world, part, size) for world, part in zip(worlds, effects, strict=True)]


def _with(world: World, part: sea.Effect, size: float) -> Drawn:
    """Simulate the recording with an effect of a given physical size."""
    bare = sea.planted(world, {})
    gamma, _, _ = sea.combined(world, [(part, size)])
    gamma = gamma + world.rng.normal(0.0, 0.5, gamma.size)
    upper = sea.turned(world.flow, sea.wrap(gamma - world.heading))
    pairs = replace(bare.pairs, heading_deg=gamma % 360.0, upper_east=upper.real, upper_north=upper.imag)
    return replace(bare, pairs=pairs, parts=[(part, size)])


def _earth(place: tuple[float, float], time_s: float) -> tuple[float, float]:
    _, horizontal, vertical = earth_field(*place, (time_s, time_s + sea.YEAR_H * sea.HOUR_S)).at(
        np.array([time_s + 1e7])
    )
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
    return [f"{stamp}Z" for stamp in np.datetime_as_string(np.rint(time_s).astype("datetime64[s]")).tolist()]


def _table(path: Path, stamps: list[str] | None, columns: dict[str, Floats]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    time = {} if stamps is None else {"time_utc": stamps}
    pd.DataFrame(time | columns).to_csv(path, index=False, float_format="%.4f")
