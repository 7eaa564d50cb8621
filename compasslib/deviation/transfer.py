"""Coefficients carried from one place to another: a calibration at home, a deployment at sea.

B and C are (P + cZ)/(lambda H) and (Q + fZ)/(lambda H): the hard iron's part P, Q falls as 1/H, the part cZ, fZ that
the vertical field induces as tan I = Z/H. A, D and E come from horizontal induction and do not change. One calibration
shows the sum only; two at different tan I tell the parts apart (physics page, section 3; von Appen 2015, introduction).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from compasslib.types import Floats

SEMICIRCULAR = (1, 2)  # B and C
WEAKEST_NT = 5000.0  # below this horizontal field no correction is to be trusted (Le Menn et al. 2023)


@dataclass(frozen=True)
class Place:
    """The earth's field where a compass is."""

    horizontal_nT: float
    vertical_nT: float  # down positive


@dataclass(frozen=True)
class Transferred:
    """Coefficients at another place, with what is not known about them."""

    coefficients: Floats  # (5,) A..E of the exact compass, dimensionless
    covariance: Floats  # (5, 5) the ambiguity between hard and induced iron included
    if_all_hard: Floats  # (5,) the one extreme
    if_all_induced: Floats  # (5,) the other
    warning: str  # a sentence where the two differ or the field is too weak, else empty


def carry(coefficients: ArrayLike, covariance: ArrayLike, home: Place, away: Place) -> Transferred:
    """Return coefficients calibrated at one place as they are at another.

    How much of B and C hard iron makes is unknown: the middle between all and none is taken, and half their distance is
    a uniform uncertainty.

    Args:
        coefficients: A..E of the exact compass at home, dimensionless, (5,).
        covariance: their covariance, (5, 5).
        away: field at the deployment.
    """
    given, semicircular = np.asarray(coefficients, dtype=float), np.isin(np.arange(5), SEMICIRCULAR)
    as_hard, as_induced = _ratios(home, away)
    all_hard, all_induced = (np.where(semicircular, given * ratio, given) for ratio in (as_hard, as_induced))
    scale = np.where(semicircular, 0.5 * as_hard + 0.5 * as_induced, 1.0)
    spread = np.abs(all_hard - all_induced) / np.sqrt(12.0)
    carried = np.asarray(covariance, dtype=float) * np.outer(scale, scale) + np.outer(spread, spread)
    return Transferred(given * scale, carried, all_hard, all_induced, _warning(all_hard, all_induced, away))


def _ratios(home: Place, away: Place) -> tuple[float, float]:
    """Return how hard and induced parts of B and C grow from one place to the other."""
    by_strength = home.horizontal_nT / away.horizontal_nT
    return by_strength, by_strength * away.vertical_nT / home.vertical_nT


def _warning(all_hard: Floats, all_induced: Floats, away: Place) -> str:
    if away.horizontal_nT < WEAKEST_NT:
        return f"the horizontal field is {away.horizontal_nT:.0f} nT; below {WEAKEST_NT:.0f} nT no correction holds"
    apart = float(np.hypot(*(all_hard - all_induced)[list(SEMICIRCULAR)]))
    if apart < 0.01:
        return ""
    return (
        f"B and C may be {np.round(all_hard[[1, 2]], 3).tolist()} (all hard iron) or "
        f"{np.round(all_induced[[1, 2]], 3).tolist()} (all induced by the vertical field); a second calibration at "
        "another dip would tell"
    )
