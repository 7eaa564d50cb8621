"""Two calibrations of one compass: before and after its batteries were demagnetised, or an accessory fixed beside it.

Le Menn et al. 2023, sections 3 and 4, compare curves by eye and by their phase shift. Here each coefficient's
difference stands beside its uncertainty. Rows of the budget that both share are left out: they cancel.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.calibration.result import LETTERS, Calibration

Floats = NDArray[np.floating]

SURE = 0.05  # a difference as large as this would come about by chance once in twenty
LEAST_CHANCE = 0.001  # smaller ones are not worth telling apart
SEEN = 3.0  # standard deviations of an amplitude under which it has no phase


def compare(after: Calibration, before: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return how a calibration differs from an earlier one.

    Args:
        after: this calibration.
        before: calibration.json of the earlier one.
        name: of the earlier one.
    """
    earlier = _known(before["coefficients"], before["covariance"])
    if not after.coefficients.size or earlier is None:
        return {"with": name, "why": f"{'this calibration' if earlier else name} has no coefficients", "differ": None}
    now, past = (after.coefficients, after.covariance), earlier
    both = np.isfinite(now[0]) & np.isfinite(past[0])
    off, covariance = now[0] - past[0], now[1] + past[1]
    p_value = _chance(off[both], covariance[np.ix_(both, both)])
    cycle = {"amplitude_deg": _amplitude(now, past), "phase_deg": _phase(now, past)}
    return {
        "with": name,
        "one_cycle": cycle,
        "difference": {LETTERS[k]: _difference(off[k], covariance[k, k]) for k in np.flatnonzero(both)},
        "p_value": p_value,
        "differ": p_value < SURE,
        "text": _sentence(name, cycle, p_value),
    }


def _known(coefficients: Mapping[str, float | None] | None, covariance: Any) -> tuple[Floats, Floats] | None:
    if coefficients is None:
        return None
    return np.array([coefficients[k] for k in LETTERS], dtype=float), np.array(covariance, dtype=float)


def _difference(off: float, variance: float) -> dict[str, float]:
    sigma = float(np.sqrt(variance))
    return {"value_deg": float(off), "sigma_deg": sigma, "z": float(off) / sigma if sigma > 0 else float("nan")}


def _chance(off: Floats, covariance: Floats) -> float:
    """Return the probability of so large a difference where there is none (chi square)."""
    from scipy.special import chdtrc  # only where two calibrations are compared

    return float(chdtrc(len(off), off @ np.linalg.pinv(covariance) @ off))


def _amplitude(now: tuple[Floats, Floats], past: tuple[Floats, Floats]) -> dict[str, float]:
    (here, here_sigma), (there, there_sigma) = _polar(*now)[:2], _polar(*past)[:2]
    sigma = float(np.hypot(here_sigma, there_sigma))
    return {"after": here, "before": there, "difference": here - there, "sigma": sigma}


def _phase(now: tuple[Floats, Floats], past: tuple[Floats, Floats]) -> dict[str, float] | None:
    """Return the recorded headings at which B sin + C cos is largest, and by how much that moved; None without one."""
    here, there = _polar(*now), _polar(*past)
    if min(here[0] / here[1], there[0] / there[1]) < SEEN:
        return None
    shift = float(angles.difference(here[2], there[2]))
    return {"after": here[2], "before": there[2], "shift": shift, "sigma": float(np.hypot(here[3], there[3]))}


def _polar(coefficients: Floats, covariance: Floats) -> tuple[float, float, float, float]:
    """Return amplitude, its sigma, phase and its sigma of the one-cycle part, degrees."""
    pair, spread = coefficients[1:3], covariance[1:3, 1:3]
    amplitude = max(float(np.hypot(*pair)), 1e-12)
    along = pair / amplitude
    across = np.array([along[1], -along[0]])
    sigmas = [max(float(np.sqrt(x @ spread @ x)), 1e-12) for x in (along, across)]
    return amplitude, sigmas[0], float(angles.direction(*pair)), sigmas[1] / amplitude / angles.DEGREE


def _sentence(name: str, cycle: Mapping[str, Any], p_value: float) -> str:
    size, phase = cycle["amplitude_deg"], cycle["phase_deg"]
    moved = (
        f"its phase moves by {phase['shift']:+.0f} ± {2 * phase['sigma']:.0f} degrees"
        if phase
        else "it is too small on one side to have a phase"
    )
    chance = f"p = {p_value:.2g}" if p_value >= LEAST_CHANCE else f"p < {LEAST_CHANCE}"
    told = "differ" if p_value < SURE else "are not told apart"
    return (
        f"This calibration and {name} {told} ({chance}). The one-cycle part goes from {size['before']:.2f} to "
        f"{size['after']:.2f} degrees, by {size['difference']:+.2f} ± {2 * size['sigma']:.2f} (k = 2); {moved}."
    )
