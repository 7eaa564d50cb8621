"""True conditions at a mooring, and actions of effects on its recordings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

HOUR_S, DAY_S, YEAR_S = 3600.0, 86400.0, 365.25 * 86400.0


@dataclass(frozen=True, eq=False)
class Scene:
    """Ensembles of a mooring; directions are true, headings magnetic, the m bins sorted from the nearest."""

    time_s: Floats  # (n,) true, UTC seconds since 1970
    heading_deg: Floats  # (n,) correct, of the affected instrument
    pitch_deg: Floats  # (n,) forward up
    roll_deg: Floats  # (n,) starboard down
    depth_m: Floats  # (n,) of the affected instrument
    temperature_c: Floats  # (n,)
    supply: Floats  # (n,) counts
    flow: Complexes  # (n, m) east + i north, m/s, NaN if not measured
    lower: Complexes  # (n,) the same at the reference
    declination_deg: Floats  # (n,)
    horizontal_nt: Floats  # (n,)
    vertical_nt: Floats  # (n,) down
    range_m: Floats  # (m,) of the bins
    place: tuple[float, float, float]  # latitude and longitude in degrees, water depth in metres
    looks_up: bool = True
    below_m: float | Floats = 10.0  # depth of the reference minus that of the affected instrument, (n,) if it varies
    step_s: float = HOUR_S
    real: bool = False  # whether currents, headings and tilts are those of a real record

    def at(self, time_s: Floats) -> Scene:
        """Interpolate the scene linearly to other times."""
        turning = np.rad2deg(np.unwrap(np.deg2rad(self.heading_deg)))
        rows = replace(self, heading_deg=turning)
        moved = {
            one.name: _between(getattr(rows, one.name), self.time_s, time_s)
            for one in fields(self)
            if np.shape(getattr(self, one.name))[:1] == self.time_s.shape and one.name not in ("time_s", "range_m")
        }
        return replace(self, time_s=time_s, **moved)

    @property
    def near(self) -> Complexes:
        """Current in the nearest bin of the affected instrument, (n,)."""
        return self.flow[:, 0]

    @property
    def speed(self) -> Floats:
        """Speed in the nearest bin, interpolated over gaps, m/s, (n,)."""
        return bridged(np.abs(self.near))

    @property
    def years(self) -> Floats:
        """Years since the first ensemble, (n,)."""
        return (self.time_s - self.time_s[0]) / YEAR_S

    @property
    def share(self) -> Floats:
        """Elapsed share of the record, 0 to 1, (n,)."""
        return (self.time_s - self.time_s[0]) / np.ptp(self.time_s)


@dataclass(frozen=True, eq=False)
class Acts:
    """Actions of one effect in all ensembles; quantities that are None or 0 are not changed."""

    body_nt: Floats | None = None  # (n, 3) added to the field in the body frame: forward, starboard, down
    warp: Callable[[Floats], Floats] | None = None  # transforms the output of the three sensors, nT, (n, 3)
    tilts: Callable[[Floats, Floats], tuple[Floats, Floats]] | None = None  # transforms sensed pitch and roll, (n,)
    unlevelled: float = 0.0  # share of the levelling that is omitted
    late_s: tuple[float, ...] = ()  # lags, over which the heading is averaged
    reading: Callable[[Floats], Floats] | None = None  # degrees, added to the readings (n,)
    north_deg: Floats | None = None  # (n,) eastward displacement of magnetic north
    veer_deg: Floats | None = None  # (n,) clockwise rotation of the current at the reference
    ahead_s: Floats | None = None  # (n,) by which the clock of the affected instrument is ahead


@dataclass(frozen=True)
class Family:
    """A family of effects: one kind of error of a recording."""

    name: str
    make: Callable[[np.random.Generator, Scene], Callable[[float], Acts]]  # draws the effect in a scene, as f(size)
    right: tuple[str, ...] = ()  # correct names in the catalogue, empty if it is not listed
    side: str = "compass"
    most: float = np.inf  # largest plausible size
    sized: bool = True  # whether its size can be chosen
    needs: tuple[str, ...] = ()  # requirements: observatory, battery


def bridged(series: Floats) -> Floats:
    """Interpolate a series, (n,), linearly over gaps; at least one value must be finite."""
    known, at = np.isfinite(series), np.arange(series.size)
    return series if known.all() else np.interp(at, at[known], series[known])


def wrap(angle_deg: Floats) -> Floats:
    """Wrap angles to [-180, 180), degrees, any shape."""
    return np.asarray((angle_deg + 180.0) % 360.0 - 180.0)


def towards(flow: Complexes) -> Floats:
    """Compute the direction towards which water flows, degrees clockwise from north, any shape."""
    return np.asarray(90.0 - np.rad2deg(np.angle(flow)))


def turned(flow: Complexes, by_deg: Floats) -> Complexes:
    """Rotate currents clockwise, any shape."""
    return np.asarray(flow * np.exp(-1j * np.deg2rad(by_deg)))


def unit(series: Floats) -> Floats:
    """Standardize a series to zero mean and unit standard deviation, (n,)."""
    return np.asarray((series - series.mean()) / max(float(series.std()), 1e-9))


def _between(series: NDArray, own: Floats, wanted: Floats) -> NDArray:
    at = np.clip(np.interp(wanted, own, np.arange(own.size)), 0, own.size - 1)
    first = np.minimum(at.astype(int), own.size - 2)
    share = (at - first).reshape(-1, *(1,) * (series.ndim - 1))
    return np.where(share == 0.0, series[first], (1.0 - share) * series[first] + share * series[first + 1])
