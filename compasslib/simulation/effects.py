"""What can be planted in a mooring: one record an effect, by what it does to field, reading, water or clock.

An effect stands at the ensembles of one instrument; it has unit size until it is scaled.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from compasslib.simulation.series import Floats

YEAR_S = 365.25 * 86400.0
AS_THEY_ARE = ("date_s", "share_of_observatory", "across", "along")  # parameters that do not grow with the size


@dataclass(frozen=True, eq=False)
class Circumstances:
    """In what an instrument stands at its ensembles; (n,) each."""

    time_s: Floats  # true
    heading_deg: Floats  # correct, magnetic
    pitch_deg: Floats
    roll_deg: Floats
    depth_m: Floats
    temperature_c: Floats
    supply_counts: Floats
    speed_m_s: Floats
    flow_deg: Floats  # direction towards which the water flows

    @property
    def years(self) -> Floats:
        """Years since the first ensemble."""
        return (self.time_s - self.time_s[0]) / YEAR_S


@dataclass(frozen=True, eq=False)
class Effect:
    """One effect; what it does not touch stays None or 0."""

    name: str
    parameters: dict[str, float] = field(default_factory=dict)
    body_nt: Floats | None = None  # (n, 3) added in the body frame
    reading: Callable[[Floats], Floats] | None = None  # added to readings (n, k), degrees
    veer_deg: Floats | None = None  # (n,) lower minus upper direction, clockwise
    ahead_s: Floats | None = None  # (n,) by which the affected clock is ahead of the reference
    wrong_clock: str = "top"  # whose clock that is
    trusted: Callable[[Floats], Floats] | None = None  # added to the reference's compass's headings (n,), degrees
    gain: float = 0.0  # of the reference's forward beam pair, beyond the other's
    bias_m_s: complex = 0.0  # starboard + i forward, in what the reference measures
    north_deg: Floats | None = None  # (n,) by which magnetic north lies east of where it should
    observed_nt: Floats | None = None  # (n, 2) what an observatory saw across and along magnetic north; else as here
    tilts_deg: Floats | None = None  # (n, 2) added to the pitch and roll that the sensors give
    lag_s: float = 0.0
    unlevelled: float = 0.0  # share of the levelling that is left out
    stuck_from_s: float | None = None  # date from which the inclinometers stick
    size: float = 1.0

    @property
    def grows(self) -> bool:
        """Whether its size can be chosen; clocks, stuck sensors and a missing levelling are as they are."""
        return self.ahead_s is None and self.stuck_from_s is None and self.unlevelled == 0.0


def scaled(effect: Effect, size: float) -> Effect:
    """Return an effect so many times as large.

    Args:
        size: factor.
    """
    if not effect.grows:
        return effect
    plain, trusted = effect.reading, effect.trusted
    return replace(
        effect,
        parameters={k: v if k in AS_THEY_ARE else size * v for k, v in effect.parameters.items()},
        body_nt=_times(effect.body_nt, size),
        reading=None if plain is None else lambda gamma: size * plain(gamma),
        veer_deg=_times(effect.veer_deg, size),
        north_deg=_times(effect.north_deg, size),
        observed_nt=_times(effect.observed_nt, size),
        tilts_deg=_times(effect.tilts_deg, size),
        trusted=None if trusted is None else lambda heading: size * trusted(heading),
        gain=size * effect.gain,
        bias_m_s=size * effect.bias_m_s,
        lag_s=size * effect.lag_s,
        size=size,
    )


def total(effects: Sequence[Effect], part: str, empty: Floats) -> Floats:
    """Return the sum of one part of several effects.

    Args:
        empty: the sum of none.
    """
    return sum((getattr(one, part) for one in effects if getattr(one, part) is not None), empty)


def steps(time_s: Floats, date_s: float) -> NDArray[np.bool_]:
    """Return whether an ensemble lies on or after a date, (n,).

    Args:
        time_s: UTC seconds, (n,).
    """
    return np.asarray(time_s >= date_s)


def _times(series: Floats | None, size: float) -> Floats | None:
    return None if series is None else size * series
