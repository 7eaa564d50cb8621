"""What can be planted in a mooring: one record an effect, by what it does to field, reading or reference.

An effect stands at the ensembles of one instrument; it has unit size until it is scaled.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from compasslib.demo.series import Floats

AS_THEY_ARE = ("date_s",)  # parameters that do not grow with the size


@dataclass(frozen=True, eq=False)
class Circumstances:
    """In what an instrument stands at its ensembles; (n,) each."""

    time_s: Floats  # true
    heading_deg: Floats  # correct, magnetic
    pitch_deg: Floats
    roll_deg: Floats
    temperature_c: Floats


@dataclass(frozen=True, eq=False)
class Effect:
    """One effect; what it does not touch stays None or 0."""

    name: str
    parameters: dict[str, float] = field(default_factory=dict)
    body_nt: Floats | None = None  # (n, 3) added in the body frame
    reading: Callable[[Floats], Floats] | None = None  # added to readings (n, k), degrees
    trusted: Callable[[Floats], Floats] | None = None  # added to the reference's compass's headings (n,), degrees
    gain: float = 0.0  # of the reference's forward beam pair, beyond the other's
    bias_m_s: complex = 0.0  # starboard + i forward, in what the reference measures
    size: float = 1.0


def scaled(effect: Effect, size: float) -> Effect:
    """Scale an effect by a factor."""
    plain, trusted = effect.reading, effect.trusted
    return replace(
        effect,
        parameters={k: v if k in AS_THEY_ARE else size * v for k, v in effect.parameters.items()},
        body_nt=None if effect.body_nt is None else size * effect.body_nt,
        reading=None if plain is None else lambda gamma: size * plain(gamma),
        trusted=None if trusted is None else lambda heading: size * trusted(heading),
        gain=size * effect.gain,
        bias_m_s=size * effect.bias_m_s,
        size=size,
    )


def total(effects: Sequence[Effect], part: str, empty: Floats) -> Floats:
    """Sum one part of several effects, ``empty`` where there is none."""
    return sum((getattr(one, part) for one in effects if getattr(one, part) is not None), empty)


def steps(time_s: Floats, date_s: float) -> NDArray[np.bool_]:
    """Tell whether an ensemble lies on or after a date, (n,)."""
    return np.asarray(time_s >= date_s)
