"""What truly was at a mooring, and what an effect does there."""

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
    """A mooring ensemble by ensemble; directions true, headings magnetic, m bins from the nearest on."""

    time_s: Floats  # (n,) true, UTC seconds since 1970
    heading_deg: Floats  # (n,) correct, of the compromised instrument
    pitch_deg: Floats  # (n,) forward up
    roll_deg: Floats  # (n,) starboard down
    depth_m: Floats  # (n,) of the compromised instrument
    temperature_c: Floats  # (n,)
    supply: Floats  # (n,) counts
    flow: Complexes  # (n, m) east + i north, m/s, NaN where nothing was measured
    lower: Complexes  # (n,) the same at the trusted instrument
    declination_deg: Floats  # (n,)
    horizontal_nt: Floats  # (n,)
    vertical_nt: Floats  # (n,) down
    range_m: Floats  # (m,) of the bins
    place: tuple[float, float, float]  # latitude and longitude in degrees, depth of the water in metres
    looks_up: bool = True
    below_m: float | Floats = 10.0  # the trusted depth minus the compromised instrument's, (n,) where it varies
    step_s: float = HOUR_S
    real: bool = False  # whether water, headings and tilts are those of a record

    def at(self, time_s: Floats) -> Scene:
        """Return the scene at other instants, linear between its own.

        Args:
            time_s: (k,) UTC seconds.
        """
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
        """The water at the instrument: its nearest bin, (n,)."""
        return self.flow[:, 0]

    @property
    def speed(self) -> Floats:
        """Speed of that water, gaps bridged, m/s, (n,)."""
        return bridged(np.abs(self.near))

    @property
    def years(self) -> Floats:
        """Since the first ensemble, (n,)."""
        return (self.time_s - self.time_s[0]) / YEAR_S

    @property
    def share(self) -> Floats:
        """Of the record that has gone by, 0 to 1, (n,)."""
        return (self.time_s - self.time_s[0]) / np.ptp(self.time_s)


@dataclass(frozen=True, eq=False)
class Acts:
    """What one effect does, ensemble by ensemble; what it does not touch stays as it is."""

    body_nt: Floats | None = None  # (n, 3) added to the field in the body: forward, starboard, down
    warp: Callable[[Floats], Floats] | None = None  # of what the three sensors give, nT, (n, 3)
    tilts: Callable[[Floats, Floats], tuple[Floats, Floats]] | None = None  # of sensed pitch and roll, (n,)
    unlevelled: float = 0.0  # share of the levelling that is left out
    late_s: tuple[float, ...] = ()  # the heading is the mean of those so long ago
    reading: Callable[[Floats], Floats] | None = None  # degrees, added to the readings (n,)
    north_deg: Floats | None = None  # (n,) by which magnetic north lies east of where it should
    veer_deg: Floats | None = None  # (n,) by which the trusted instrument's water is turned clockwise
    ahead_s: Floats | None = None  # (n,) by which the compromised clock is ahead
    reference: Callable[[Floats], Floats] | None = None  # degrees, added to the trusted compass's headings (n,)


@dataclass(frozen=True)
class Family:
    """One way in which a recording may go wrong."""

    name: str
    make: Callable[[np.random.Generator, Scene], Callable[[float], Acts]]  # of a mooring; then of a size
    right: tuple[str, ...] = ()  # names of the catalogue that say it; none where nobody listed it
    side: str = "compass"
    most: float = np.inf  # size beyond which nobody would believe it
    sized: bool = True  # whether a size can be chosen
    needs: tuple[str, ...] = ()  # observatory, battery


def bridged(series: Floats) -> Floats:
    """Return a series with its gaps bridged by lines.

    Args:
        series: (n,), some of it finite.
    """
    known, at = np.isfinite(series), np.arange(series.size)
    return series if known.all() else np.interp(at, at[known], series[known])


def wrap(angle_deg: Floats) -> Floats:
    """Return angles in [-180, 180), degrees, any shape."""
    return np.asarray((angle_deg + 180.0) % 360.0 - 180.0)


def towards(flow: Complexes) -> Floats:
    """Return the direction towards which water flows, degrees clockwise from north, any shape."""
    return np.asarray(90.0 - np.rad2deg(np.angle(flow)))


def turned(flow: Complexes, by_deg: Floats) -> Complexes:
    """Return water that is turned clockwise, any shape.

    Args:
        by_deg: that broadcasts with it.
    """
    return np.asarray(flow * np.exp(-1j * np.deg2rad(by_deg)))


def unit(series: Floats) -> Floats:
    """Return a series about its mean in its own standard deviations, (n,)."""
    return np.asarray((series - series.mean()) / max(float(series.std()), 1e-9))


def _between(series: NDArray, own: Floats, wanted: Floats) -> NDArray:
    at = np.clip(np.interp(wanted, own, np.arange(own.size)), 0, own.size - 1)
    first = np.minimum(at.astype(int), own.size - 2)
    share = (at - first).reshape(-1, *(1,) * (series.ndim - 1))
    return np.where(share == 0.0, series[first], (1.0 - share) * series[first] + share * series[first + 1])
