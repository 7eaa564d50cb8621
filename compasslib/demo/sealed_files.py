"""Writes a mooring with known truth: raw exports of both instruments, and apart from them the correct headings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compasslib.demo import adcp, pd0, readings, sealed
from compasslib.demo.adcp import Adcp, Stance
from compasslib.demo.effects import Effect
from compasslib.demo.pd0 import Ensembles, Setup
from compasslib.demo.sealed import Ground
from compasslib.demo.series import Floats, circle, clockwise, red_noise, white_vector

DEEP_BELOW_M, DEEP_SAMPLE_S = 4.0, 180.0
TOP_NOISE_M_S, DEEP_NOISE_M_S, SOURCE_NOISE_COUNTS, TEMPERATURE_NOISE_K = 0.014, 0.02, 0.5, 0.02
GAPS, LONGEST_GAP_H = 4, 40
STUCK_H = 9  # hours for which the compass gave one value


@dataclass(frozen=True)
class Export:
    """In which form a mooring's files are."""

    deep: str = "pd0"  # pd0 or table
    coordinates: str = "earth"


@dataclass(frozen=True, eq=False)
class Written:
    """What the affected compass should have given at the samples that were kept, (m,) each."""

    time_s: Floats  # as it was stamped
    heading_deg: Floats  # correct, magnetic; NaN where the compass was stuck and no model can know it
    recorded_deg: Floats


def write(ground: Ground, effects: Sequence[Effect], raw: Path, export: Export) -> Written:
    """Write the raw files ``top.000``, ``deep.000`` or ``deep.csv``, and return the truth."""
    raw.mkdir(parents=True, exist_ok=True)
    top = _top_stance(ground, effects)
    kept = _kept(ground)
    recorded = _as_logged(ground, top, adcp.measure(
        ground.random("top"), _top(export.coordinates), top, ground.currents, latitude_deg=ground.latitude_deg
    ))  # fmt: skip
    stamped = replace(recorded, time_s=ground.stamp_s)
    pd0.write(raw / "top.000", _top(export.coordinates).setup, _only(stamped, kept))
    _write_deep(ground, effects, raw, export)
    heading = top.heading_deg.copy()
    heading[_stuck(ground)] = np.nan
    return Written(ground.stamp_s[kept], heading[kept], recorded.heading_deg[kept])


def _top_stance(ground: Ground, effects: Sequence[Effect]) -> Stance:
    time = ground.stamp_s
    made = readings.read(ground, effects, time, ground.random("readings"))
    recorded = made.recorded_deg.copy()
    recorded[_stuck(ground)] = recorded[_stuck(ground)][0]
    return Stance(
        time_s=time,
        depth_m=np.interp(time, ground.motion.time_s, ground.motion.sphere_depth_m),
        heading_deg=made.heading_deg,
        recorded_deg=recorded,
        tilt_deg=made.tilt_deg,
        sensed_tilt_deg=made.sensed_deg,
        declination_deg=ground.field.at(time)[0],
        in_water=np.ones(time.size, dtype=bool),
    )


def _deep_stance(ground: Ground, effects: Sequence[Effect]) -> Stance:
    """Return how the reference hangs under the sphere: its compass is clean."""
    rng = ground.random("deep compass")
    time = ground.stamp_s + DEEP_SAMPLE_S
    sphere = np.interp(time, ground.motion.time_s, ground.motion.sphere_depth_m)
    heading = sealed.trusted_heading(ground)
    tilts = [mean + red_noise(rng, time.size, memory=6.0, deviation=0.5) for mean in (1.5, -1.2)]
    wrong = sum((one.trusted(heading) for one in effects if one.trusted is not None), np.zeros(time.size))
    return Stance(
        time_s=time,
        depth_m=sphere + DEEP_BELOW_M,
        heading_deg=heading,
        recorded_deg=circle(heading + wrong + rng.normal(0.0, 0.5, time.size)),
        tilt_deg=(tilts[0], tilts[1]),
        sensed_tilt_deg=(tilts[0], tilts[1]),
        declination_deg=ground.field.at(time)[0],
        in_water=np.ones(time.size, dtype=bool),
        gain=sum(one.gain for one in effects),
        bias_m_s=sum(one.bias_m_s for one in effects),
    )


def _stuck(ground: Ground) -> slice:
    begin = int(ground.random("stuck").integers(0, ground.stamp_s.size - STUCK_H))
    return slice(begin, begin + STUCK_H)


def _top(coordinates: str) -> Adcp:
    setup = Setup(
        kilohertz=300, looks_up=True, cells=8, cell_m=2.0, blank_m=0.88, first_bin_m=3.1, pings=readings.PINGS,
        coordinates=coordinates, serial=9001,
    )  # fmt: skip
    return Adcp(setup, noise_m_s=TOP_NOISE_M_S)


def _deep() -> Adcp:
    setup = Setup(
        kilohertz=300, looks_up=False, cells=3, cell_m=2.0, blank_m=0.88, first_bin_m=3.1, pings=40,
        coordinates="earth", serial=7501,
    )  # fmt: skip
    return Adcp(setup, noise_m_s=DEEP_NOISE_M_S, sample_s=DEEP_SAMPLE_S)


def _as_logged(ground: Ground, stance: Stance, recorded: Ensembles) -> Ensembles:
    """Return the ensembles with the temperature and voltage of this mooring."""
    rng, grid = ground.random("logged"), ground.currents.time_s
    count = stance.time_s.size
    warm = np.interp(stance.time_s, grid, ground.temperature_c)
    volts = np.interp(stance.time_s, grid, ground.supply_counts)
    return replace(
        recorded,
        temperature_c=warm + rng.normal(0.0, TEMPERATURE_NOISE_K, count),
        supply_counts=np.rint(volts + rng.normal(0.0, SOURCE_NOISE_COUNTS, count)).astype(np.uint8),
    )


def _kept(ground: Ground) -> NDArray[np.bool_]:
    """Return which ensembles are in the file: a few gaps of hours to days, (n,)."""
    rng, count = ground.random("gaps"), ground.stamp_s.size
    kept = np.ones(count, dtype=bool)
    for begin, length in zip(rng.integers(0, count, GAPS), rng.integers(1, LONGEST_GAP_H, GAPS), strict=True):
        kept[begin : begin + length] = False
    return kept


def _only(ensembles: Ensembles, kept: NDArray[np.bool_]) -> Ensembles:
    return Ensembles(**{name: column[kept] for name, column in vars(ensembles).items()})


def _write_deep(ground: Ground, effects: Sequence[Effect], raw: Path, export: Export) -> None:
    stance, instrument = _deep_stance(ground, effects), _deep()
    stamps = ground.stamp_s + DEEP_SAMPLE_S
    if export.deep == "pd0":
        rng = ground.random("deep")
        made = adcp.measure(rng, instrument, stance, ground.currents, latitude_deg=ground.latitude_deg)
        pd0.write(raw / "deep.000", instrument.setup, replace(made, time_s=stamps))
        return
    flow = adcp.near_bins(instrument.setup, stance, ground.currents)
    flow = flow + white_vector(ground.random("deep"), flow.size, instrument.noise_m_s / np.sqrt(2.0))
    flow = clockwise(flow, stance.recorded_deg - stance.heading_deg - stance.declination_deg)
    depth = stance.depth_m + adcp.ranges(instrument.setup)[:2].mean()
    texts = np.datetime_as_string(stamps.astype("datetime64[s]")).tolist()
    rows = zip(texts, depth.tolist(), (100 * flow.real).tolist(), (100 * flow.imag).tolist(), strict=True)
    lines = ["time_utc,depth_m,u_cm_s,v_cm_s\n", *("{}Z,{:.2f},{:.2f},{:.2f}\n".format(*row) for row in rows)]
    (raw / "deep.csv").write_text("".join(lines))
