"""How well the two instruments agree before and after, on pairs that the fit has not seen.

Von Appen 2015, section 4, judges by histograms and a scatter of the very pairs that were fitted. Here the record is cut
into contiguous blocks of ten days (hourly currents remember a day or two), the model is fitted without some of them and
tried on those.
"""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib import angles, correction, deviation
from compasslib.deviation import model
from compasslib.deviation.model import Fit
from compasslib.records import Pairs

Floats = NDArray[np.floating]

BLOCK_S = 10 * 86400.0
FOLDS = 2


def choose(pairs: Pairs, which: NDArray[Any]) -> Pairs:
    """Return some of the pairs.

    Args:
        pairs: n pairs.
        which: positions or a mask.
    """
    arrays = {f.name: getattr(pairs, f.name) for f in fields(pairs) if f.name != "warnings"}
    return Pairs(**{name: column[which] for name, column in arrays.items()}, warnings=pairs.warnings)


def held_out_headings(pairs: Pairs, fit: Fit) -> Floats:
    """Return the corrected heading of each pair by a fit that has not seen its block, (n,) degrees, NaN where none.

    Args:
        pairs: overlapping measurements.
        fit: the fit to all of them; its method is repeated.
    """
    heading = np.full(len(pairs), np.nan)
    block = np.floor((pairs.time_s - pairs.time_s[0]) / BLOCK_S).astype(int) % FOLDS
    for fold in range(FOLDS):
        left_out, kept = block == fold, choose(pairs, block != fold)
        again = deviation.fit(fit.method, kept, near=fit)
        heading[left_out] = correction.headings(pairs.time_s, pairs.heading_deg, again, kept).heading_deg[left_out]
    return heading


def assess(pairs: Pairs, fit: Fit) -> dict[str, Any]:
    """Return assessment.json: direction difference upper minus lower, before and after.

    Args:
        pairs: overlapping measurements.
        fit: the fit to all of them.
    """
    held_out = held_out_headings(pairs, fit) if fit.fitted else np.full(len(pairs), np.nan)
    known = np.isfinite(held_out)
    turned = angles.turn(pairs.upper_east, pairs.upper_north, held_out - pairs.heading_deg)
    return {
        "before": _agreement(pairs.upper_east, pairs.upper_north, pairs),
        "before_where_corrected": _agreement(pairs.upper_east[known], pairs.upper_north[known], choose(pairs, known)),
        "after": _agreement(turned[0][known], turned[1][known], choose(pairs, known)),
        "held_out": {"block_days": BLOCK_S / 86400.0, "folds": FOLDS, "n": int(known.sum())},
    }


def told(name: str, verdict: dict[str, Any]) -> str:
    """Return what the job says of its result.

    Args:
        name: the mooring.
        verdict: assessment.json.
    """
    before, after = verdict["before"], verdict["after"]
    if not after["n"]:
        return f"{name}: nothing to assess ({before['n']} pairs, none corrected)"
    return (
        f"{name}: upper minus lower direction {before['rms_deg']:.1f} degrees rms before, {after['rms_deg']:.1f} "
        f"after, on {after['n']} of {before['n']} pairs, each held out from its fit"
    )


def _agreement(east: Floats, north: Floats, pairs: Pairs) -> dict[str, Any]:
    if not len(pairs):
        return {"n": 0, "mean_deg": None, "rms_deg": None, "median_absolute_deg": None, "vector_correlation": None}
    lower = angles.direction(pairs.lower_east, pairs.lower_north)
    off = angles.difference(angles.direction(east, north), lower)
    return {
        "n": len(pairs),
        "mean_deg": float(angles.wrap180(angles.mean(off))),
        "rms_deg": angles.rms(off),
        "rms_deg_sigma": angles.rms(off) / np.sqrt(2.0 * model.effective_number(off, pairs.time_s)),
        "median_absolute_deg": float(np.median(np.abs(off))),
        "vector_correlation": _vector_correlation(east + 1j * north, pairs.lower_east + 1j * pairs.lower_north),
    }


def _vector_correlation(a: NDArray[np.complex128], b: NDArray[np.complex128]) -> dict[str, float]:
    """Return magnitude and angle of Kundu's complex correlation (J. Phys. Oceanogr. 6, 238, 1976)."""
    product = np.mean(a * np.conj(b)) / np.sqrt(np.mean(np.abs(a) ** 2) * np.mean(np.abs(b) ** 2))
    angle = -float(angles.wrap180(angles.argument(product)))  # clockwise positive: upper minus lower
    return {"magnitude": float(np.abs(product)), "angle_deg": angle}
