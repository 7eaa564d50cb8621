"""Real records as scenes: currents, headings and tilts of a real mooring, split into two instruments, or extended.

A record is described by a YAML file: ``format``, ``files`` (relative to the folder of recordings) and ``settings`` as
for an instrument of a mooring, ``latitude``, ``longitude``, ``water_depth``, ``depth``, ``start``, ``end``,
``looks_up``. For a profile, ``bins`` are the bins used and ``gaps`` the number of cells between the bin used as the
reference and the nearest affected bin; for a point meter, the samples ``stands_in_hours`` before and after serve as the
reference. ``every`` is the step of the samples used, ``supply_counts`` counts per volt; with ``follows_pressure`` the
depth is the recorded pressure. The bins share one compass, so they differ by the water only.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks.proof.world import seas
from benchmarks.proof.world.scene import DAY_S, HOUR_S, Complexes, Floats, Scene, bridged, turned
from compasslib import readers

OURS = Path(__file__).resolve().parents[1] / "records"
SUPPLY = 150.0  # counts, if a record has none
FADE = 8  # samples over which one segment fades into the next
MOST_BINS = 8
BESIDE_M = 4.0  # nominal distance of the bins and the reference of a point meter
FELT_M, FELT_S = 16.0, 3 * HOUR_S  # range of bins and time over which the noise of a profiler is averaged out
BLOCK_DAYS = (4.0, 20.0)


@dataclass(frozen=True)
class Described:
    """A real record and how it is split."""

    name: str
    keys: dict[str, Any]
    data: Path

    @property
    def stands_in(self) -> bool:
        """Whether it is a single point meter, whose own samples serve as the reference."""
        return "stands_in_hours" in self.keys

    @property
    def there(self) -> bool:
        """Whether its file exists in the folder of recordings."""
        return (self.data / str(self.keys["files"])).exists()


def described(data: Path) -> list[Described]:
    """List the described records, whose files may be in a folder of recordings."""
    return [Described(path.stem, yaml.safe_load(path.read_text()), data) for path in sorted(OURS.glob("*.yaml"))]


@cache
def whole(name: str, data: Path) -> Scene:
    """Read a real record with all bins used, before the reference is split from it."""
    one = next(each for each in described(data) if each.name == name)
    keys = one.keys
    record = readers.read(keys["format"], [data / keys["files"]], keys.get("settings", {}))
    # A modem may send an ensemble twice, and out of order.
    stamps, first_sent = np.unique(np.rint(record.time_s), return_index=True)
    ends = [datetime.fromisoformat(str(keys[end])).timestamp() for end in ("start", "end")]
    inside = first_sent[(stamps >= ends[0]) & (stamps < ends[1])][:: keys.get("every", 1)]
    first, last = keys.get("bins", (0, 1))
    time, place = np.rint(record.time_s[inside]), (keys["latitude"], keys["longitude"], keys["water_depth"])
    declination, horizontal, vertical = seas.earth(time, place)
    good = record.quality[inside, first:last] == 1
    flow = np.where(good, record.east[inside, first:last] + 1j * record.north[inside, first:last], np.nan)
    if record.direction_reference == "magnetic":
        flow = turned(flow, declination[:, None])
    follows = keys.get("follows_pressure", False)
    depth = bridged(record.pressure_dbar[inside]) if follows else np.full(time.size, float(keys["depth"]))
    heading, pitch, roll = (_logged(x[inside], 0.0) for x in (record.heading_deg, record.pitch_deg, record.roll_deg))
    warm = _logged(record.temperature_c[inside], 5.0)
    supply = keys.get("supply_counts", 1.0) * _logged(record.supply_voltage[inside], SUPPLY)
    ranges = np.nanmedian(np.abs(record.bin_range_m), axis=0)[first:last]
    return Scene(
        time, heading, pitch, roll, depth, warm, supply, flow, flow[:, 0], declination, horizontal, vertical, ranges,
        place, looks_up=keys["looks_up"], step_s=float(np.median(np.diff(time))), real=True,
    )  # fmt: skip


def cut(rng: np.random.Generator, one: Described, scene: Scene, *, mirrored: bool = False) -> Scene:
    """Split a record, mirrored if asked: one bin is the reference, those beyond a gap are the affected instrument."""
    if mirrored:
        scene = _mirrored(scene)
    if one.stands_in:
        span = HOUR_S * one.keys["stands_in_hours"]
        lower = 0.5 * (scene.at(scene.time_s - span).lower + scene.at(scene.time_s + span).lower)
        return replace(scene, lower=lower, below_m=BESIDE_M, range_m=np.array([BESIDE_M]))
    gap = int(rng.choice(one.keys["gaps"]))
    trusted = int(rng.integers(0, scene.range_m.size - gap - 3))
    bins = slice(trusted + gap, trusted + gap + MOST_BINS)
    away = float(scene.range_m[trusted])
    return replace(
        scene,
        flow=scene.flow[:, bins],
        lower=scene.flow[:, trusted],
        range_m=scene.range_m[bins],
        below_m=-away if scene.looks_up else away,
    )


def longer(rng: np.random.Generator, scene: Scene, weather: seas.Weather) -> Scene:
    """Construct a scene with the statistics of a record: its segments permuted, or a longer one by random phases.

    Segments keep headings and tilts with their currents, and none is repeated, as real currents never repeat exactly.
    With random phases (the same for all bins, to preserve their coherence), the motion of the sphere is simulated.
    Temperature and battery are simulated.
    """
    step = HOUR_S * max(1.0, np.ceil(scene.step_s / HOUR_S))
    even = scene.at(np.arange(scene.time_s[0], scene.time_s[-1], step))
    columns = np.column_stack([*(bridged_flow(x) for x in even.flow.T), bridged_flow(even.lower)])
    count = int(weather.hours * HOUR_S / step)
    begin_s = even.time_s[0] + DAY_S * int(rng.integers(0, 3000))
    stance = np.column_stack([np.exp(1j * np.deg2rad(even.heading_deg)), even.pitch_deg + 1j * even.roll_deg])
    by_phase = weather.spinning or rng.random() < 0.5
    if by_phase:
        made = chained([_surrogate(rng, columns) for _ in range(1 + count // (len(columns) - FADE) + 1)], count)
    else:
        parts = _stretches(rng, np.column_stack([columns, stance]), step)
        made = chained(parts, min(count, sum(len(part) - FADE for part in parts) - FADE))
    flow = made[:, : columns.shape[1]]
    water = seas.Water(
        begin_s + step * np.arange(len(made)), flow[:, :-1], flow[:, -1], scene.range_m, scene.place, scene.looks_up,
        scene.below_m, float(np.median(scene.depth_m)),
    )  # fmt: skip
    moved = seas.settled(rng, water, weather, _felt(water, step))
    if by_phase:
        return moved
    heading, tilt = np.rad2deg(np.angle(made[:, -2])) % 360.0, made[:, -1]
    return replace(moved, heading_deg=heading, pitch_deg=tilt.real, roll_deg=tilt.imag)


def chained(parts: Sequence[Complexes], count: int) -> Complexes:
    """Concatenate parts, each fading into the next, (count, k)."""
    ramp = (np.arange(FADE) + 0.5)[:, None] / FADE
    made = np.zeros((count + 2 * max(map(len, parts)), parts[0].shape[1]), dtype=complex)
    at = 0
    for part in parts:
        faded = part.copy()
        faded[:FADE] *= ramp
        faded[-FADE:] *= ramp[::-1]
        made[at : at + len(part)] += faded
        at += len(part) - FADE
        if at >= count + FADE:
            break
    return made[FADE : FADE + count]


def bridged_flow(flow: Complexes) -> Complexes:
    """Interpolate a current linearly over gaps, (n,)."""
    return np.asarray(bridged(flow.real) + 1j * bridged(flow.imag))


def _felt(water: seas.Water, step_s: float) -> Complexes:
    """Compute the current that a sphere feels, (n,), averaged over near bins and time to remove instrument noise."""
    near = water.flow[:, water.range_m <= water.range_m.min() + FELT_M].mean(axis=1)
    ones = np.ones(max(int(FELT_S / step_s), 1))
    return np.asarray(np.convolve(near, ones, "same") / np.convolve(np.ones(near.size), ones, "same"))


def _stretches(rng: np.random.Generator, columns: Complexes, step_s: float) -> list[Complexes]:
    """Split a record into segments of some days and permute them."""
    shortest, longest = (int(days * DAY_S / step_s) for days in BLOCK_DAYS)
    ends = [0]
    while len(columns) - ends[-1] >= shortest + longest:
        ends.append(ends[-1] + int(rng.integers(shortest, longest)))
    parts = np.split(columns, ends[1:])
    return [parts[k] for k in rng.permutation(len(parts))]


def _surrogate(rng: np.random.Generator, columns: Complexes) -> Complexes:
    """Draw surrogates with the same spectra and coherences and random phases, (n, k) (Prichard and Theiler 1994)."""
    mean = columns.mean(axis=0)
    turn = np.exp(2j * np.pi * rng.random(len(columns)))[:, None]
    return np.asarray(np.fft.ifft(np.fft.fft(columns - mean, axis=0) * turn, axis=0) + mean)


def _mirrored(scene: Scene) -> Scene:
    """Mirror a scene about magnetic north and reverse its bins: east becomes west, the far bin the near one."""
    flow = -np.conj(turned(scene.flow, -scene.declination_deg[:, None]))[:, ::-1]
    return replace(
        scene,
        heading_deg=-scene.heading_deg % 360.0,
        roll_deg=-scene.roll_deg,
        flow=turned(flow, scene.declination_deg[:, None]),
        lower=turned(-np.conj(turned(scene.lower, -scene.declination_deg)), scene.declination_deg),
    )


def _logged(series: Floats, otherwise: float) -> Floats:
    known = np.isfinite(series)
    return bridged(series) if known.any() else np.full(series.size, otherwise)
