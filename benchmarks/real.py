"""Real records under a simulated compass: bins of two moored profiles, and a point meter that stands in for two.

The bins of eh2 and papa share their compass, so they differ by the water only: one bin is the reference, the affected
instrument is those beyond a gap. Of aqd9330, a point meter, the mean of the hours before and after is the second
instrument. The files are in ../shared/data, and are not part of the project.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from runs import DATA

from compasslib import angles, readers
from compasslib.inference import covariates
from compasslib.preparation.deployment import apply_deployment
from compasslib.preparation.pairs import PairRules, find_pairs
from compasslib.records import EarthField, Pairs, Record, take
from tests.world import pairs as sea

FILES = {
    "eh2": DATA / "pd0/eh2_20060530_20060717_0007m.000",
    "papa": DATA / "moored/papa_node59p1.npz",
    "aqd9330": DATA / "moored/aqd9330.npz",
}
STANDS_IN = "aqd9330"
DEPTHS = range(8)  # bins used as the reference
GAPS = {"eh2": (2, 4), "papa": (1, 2), STANDS_IN: (0,)}  # cells between the reference bin and the nearest other
PARTS = {"eh2": (1, 2), "papa": (1, 2), STANDS_IN: (4,)}  # windows: the whole, halves, quarters
LOGGED = ("as logged", "backwards", "of other weeks")
HOUR_S, SIDE_H, DEEP_DBAR = 3600.0, 3, 200.0  # SIDE_H: hours before and after that serve as the second instrument
EARTH_NT = (18900.0, 49800.0)


def available() -> list[str]:
    """List the records whose file exists."""
    return [name for name, path in FILES.items() if path.exists()]


@cache
def profile(name: str) -> Record:
    """Read a real moored profile, with its depth set constant."""
    if name == "eh2":
        record = readers.read("pd0", [FILES[name]], {})
        span = {"start_s": record.time_s[0], "end_s": record.time_s[-1], "latitude": 47.6}
        record = apply_deployment(record, **span, water_depth=45.5, nominal_depth=7.0)
        return replace(record, depth_m=np.full(len(record.time_s), 7.0), direction_reference="magnetic")
    file = np.load(FILES[name])
    velocity = file["vel"].astype(float)
    n, bins = velocity.shape[:2]
    flat, usable = np.full(n, np.nan), np.isfinite(velocity[:, :, :2]).all(axis=2)
    return Record(
        time_s=file["time"].astype("datetime64[s]").astype(float),
        east=velocity[:, :, 0],
        north=velocity[:, :, 1],
        bin_range_m=np.tile(30.0 + 20.0 * np.arange(bins), (n, 1)),
        heading_deg=file["heading"],
        pitch_deg=file["pitch"],
        roll_deg=file["roll"],
        pressure_dbar=flat,
        depth_m=np.full(n, 490.0),
        temperature_c=file["temperature"],
        supply_voltage=flat,
        quality=np.where(usable, 1, 9).astype(np.int8),
        heading_quality=np.ones(n, dtype=np.int8),
    )


def bins_of(record: Record, which: slice) -> Record:
    """Select some bins of a record."""
    columns = {name: getattr(record, name)[:, which] for name in ("east", "north", "bin_range_m", "quality")}
    return replace(record, **columns)


def as_trusted(record: Record, depth: int) -> Record:
    """Convert one bin of a record to a point meter at its depth."""
    one = bins_of(record, slice(depth, depth + 1))
    return replace(one, depth_m=one.bin_depth_m()[:, 0], bin_range_m=0.0 * one.bin_range_m, serial_number=None)


@dataclass(frozen=True)
class Seen:
    """Pairs of a real record, logged covariates, and the same pairs by the mean of two bins."""

    pairs: Pairs
    logged: dict[str, np.ndarray]
    published: Pairs


@dataclass(frozen=True)
class Case:
    """One pair of bins of one record in one window."""

    record: str
    depth: int
    gap: int
    part: int  # index of the window among ``of``
    of: int
    logged: str

    @property
    def water(self) -> str:
        """Name of the window, whose cases share their water."""
        return f"{self.record} {self.part + 1}/{self.of}"


@cache
def cases(record: str) -> list[Case]:
    """List all cases of a record in random order."""
    windows = [(part, of) for of in PARTS[record] for part in range(of)]
    every = [
        Case(record, depth, gap, *window, logged)
        for depth, gap, window, logged in itertools.product(
            (0,) if record == STANDS_IN else DEPTHS, GAPS[record], windows, LOGGED
        )
    ]
    return [every[k] for k in np.random.default_rng(0).permutation(len(every))]


def seen(case: Case) -> Seen:
    """Select the pairs of a case, with covariates as logged, reversed or shifted."""
    every = _whole(case.record, case.depth, case.gap)
    first, last = np.linspace(every.pairs.time_s[0], every.pairs.time_s[-1] + 1.0, case.of + 1)[case.part :][:2]
    own, published = ((x.time_s >= first) & (x.time_s < last) for x in (every.pairs, every.published))
    logged = {name: column[own] for name, column in every.logged.items()}
    for name in logged.keys() - {"depth", "speed"} if case.logged != LOGGED[0] else ():
        backwards = case.logged == LOGGED[1]
        logged[name] = logged[name][::-1] if backwards else np.roll(logged[name], own.sum() // 3)
    return Seen(take(every.pairs, own), logged, take(every.published, published))


@cache
def _whole(record: str, depth: int, gap: int) -> Seen:
    """Compute pairs of one bin with those beyond a gap of ``gap`` cells; of a point meter with neighbours in time."""
    if record == STANDS_IN:
        return _stood_in()
    own = profile(record)
    trusted, top = as_trusted(own, depth), bins_of(own, slice(depth + gap, None))
    field = EarthField(own.time_s[[0, -1]], *np.zeros((4, 2)))
    rules = [PairRules(max_metres=1000.0, predict=predict) for predict in (True, False)]
    predicted, published = (find_pairs(top, [trusted], field, one) for one in rules)
    return Seen(predicted, covariates.logged_series(top, (), predicted), published)


def _stood_in() -> Seen:
    """Compute pairs of hourly means of the point meter with the mean of those ``SIDE_H`` hours before and after."""
    file = np.load(FILES[STANDS_IN])
    deep = file["pressure"] > DEEP_DBAR
    time_s = file["time"].astype("datetime64[s]").astype(float)[deep]
    hour, begins = np.unique(np.floor(time_s / HOUR_S), return_index=True)
    count = np.diff(np.append(begins, len(time_s)))

    def hourly(series: np.ndarray) -> np.ndarray:
        return np.add.reduceat(series[deep].astype(float), begins) / count

    turns = np.add.reduceat(angles.phasor(file["heading"][deep]), begins)
    flow = hourly(file["vel"][:, 0]) + 1j * hourly(file["vel"][:, 1])
    inner = np.arange(SIDE_H, len(hour) - SIDE_H)
    inner = inner[hour[inner + SIDE_H] - hour[inner - SIDE_H] == 2 * SIDE_H]
    second, flow, none = (flow[inner - SIDE_H] + flow[inner + SIDE_H]) / 2.0, flow[inner], np.zeros(len(inner))
    names = ("pressure", "pitch", "roll", "temperature", "volts")
    depth, pitch, roll, temperature, volts = (hourly(file[name])[inner] for name in names)
    pairs = Pairs(
        (hour[inner] + 0.5) * HOUR_S, angles.wrap360(angles.argument(turns[inner])), pitch, roll,
        flow.real, flow.imag, second.real, second.imag, depth, depth, none, none,
    )  # fmt: skip
    logged = {"temperature": temperature, "supply_voltage": volts, "depth": depth, "speed": np.abs(flow)}
    return Seen(pairs, logged, pairs)


def world(own: Seen, seed: int) -> sea.World:
    """Convert the real record to a simulated world with a compass near iron."""
    pairs, rng = own.pairs, np.random.default_rng(seed)
    upper, lower = pairs.upper_east + 1j * pairs.upper_north, pairs.lower_east + 1j * pairs.lower_north
    tilt, none = np.nan_to_num(np.stack([pairs.pitch_deg, pairs.roll_deg])), np.zeros(len(pairs))
    return sea.World(
        rng=rng, time_s=pairs.time_s, heading=pairs.heading_deg, flow=upper, difference=lower - upper, tilt=tilt,
        sensed=tilt + rng.normal(0, 0.02, tilt.shape), depth=pairs.upper_depth_m,
        separation=pairs.lower_depth_m - pairs.upper_depth_m,
        temperature=covariates.fill_gaps(own.logged.get("temperature", none)),
        voltage=covariates.fill_gaps(own.logged.get("supply_voltage", none)), earth=EARTH_NT, **sea.iron(rng),
    )  # fmt: skip


def in_water_of(drawn: sea.Drawn, own: Seen) -> sea.Drawn:
    """State the slow water of the real record, and its logged covariates."""
    pairs = replace(drawn.pairs, veer_deg=own.pairs.veer_deg, slow_shear=own.pairs.slow_shear)
    return replace(drawn, pairs=pairs, covariates=own.logged)
