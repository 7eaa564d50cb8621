"""Identification of the affected one of two compasses: a compass error is a function of its own heading.

The difference of the directions that two instruments measure is fitted with harmonics of one heading, and the fit is
evaluated on held-out blocks. Harmonics of the current direction are always included in the fit: headings follow the
current, so current shear would otherwise be mistaken for a deviation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.preparation.pairs import PairRules, find_pairs
from compasslib.records import EarthField, Pairs, Record
from compasslib.statistics.resampling import blocks_by_span
from compasslib.types import DAY_S, Floats

HARMONICS = (1, 2)  # of the deviation
LEAST_SHARE, LEAST_SIGMAS = 0.02, 5.0  # least share of the misfit that a heading must explain, also in standard errors


@dataclass(frozen=True)
class ExplainedShare:
    """Share of the misfit between two directions that a heading explains on held-out data, with standard error."""

    share: float = 0.0
    sigma: float = np.inf

    @property
    def significant(self) -> bool:
        """Whether the share is relevant and statistically significant."""
        return self.share > max(LEAST_SHARE, LEAST_SIGMAS * self.sigma)


def compare_headings(record: Record, other: Record) -> tuple[ExplainedShare, ExplainedShare] | None:
    """Compute the share of the difference of directions explained by each heading; None without suitable pairs.

    Both records must be cut to the deployment and have known depths.
    """
    empty = np.zeros(2)
    field = EarthField(np.array([0.0, 1.0]), empty, empty, empty, empty)  # a constant declination has no effect
    for upper, lower in ((record, other), (other, record)):
        pairs = find_pairs(upper, [lower], field, PairRules())
        if not len(pairs) or pairs.lower_heading_deg is None:
            continue
        shares = explained_share(pairs, pairs.heading_deg), explained_share(pairs, pairs.lower_heading_deg)
        return shares if upper is record else shares[::-1]
    return None


def is_affected(explained: ExplainedShare, other_explained: ExplainedShare) -> bool:
    """Decide whether the first of two compasses is the affected one."""
    return explained.significant and explained.share > 4.0 * max(other_explained.share, 0.0)


def explained_share(pairs: Pairs, heading_deg: Floats) -> ExplainedShare:
    """Compute the share of the misfit explained by harmonics of a recorded heading, (n,) degrees.

    The weight of a direction is its speed over the median speed, at most 2.
    """
    upper, lower = pairs.flows
    turned = angles.argument(upper * np.conj(lower))
    turned = angles.difference(turned, angles.mean(turned))
    slower = np.minimum(np.abs(upper), np.abs(lower))
    weight = np.minimum(slower / np.median(slower), 2.0)
    known = np.isfinite(turned) & np.isfinite(heading_deg) & (slower > 0.0)
    block = blocks_by_span(pairs.time_s[known], 5 * DAY_S)  # eddies and tides decorrelate in less
    if len(np.unique(block)) < 12:
        return ExplainedShare()
    middle = angles.argument((upper / np.abs(upper) + lower / np.abs(lower))[known])
    current = np.column_stack([np.ones(known.sum()), _harmonics(middle)])
    both = np.column_stack([current, _harmonics(heading_deg[known])])
    misfits = [_misfit(columns, turned[known], weight[known], block) for columns in (current, both)]
    gain = 1.0 - misfits[1] / misfits[0]
    return ExplainedShare(float(gain.mean()), float(gain.std(ddof=1) / np.sqrt(len(gain))))


def _harmonics(angle_deg: Floats) -> Floats:
    return np.column_stack([part for order in HARMONICS for part in angles.sin_cos(order * angle_deg)])


def _misfit(columns: Floats, turned: Floats, weight: Floats, block: NDArray[np.intp]) -> Floats:
    """Compute the weighted mean misfit of each block under a fit to the other folds, degrees."""
    left = np.empty(len(turned))
    for fold in range(8):
        out = block % 8 == fold
        rows = weight[~out, None]
        coefficients = np.linalg.lstsq(rows * columns[~out], weight[~out] * turned[~out], rcond=1e-6)[0]
        left[out] = weight[out] * np.abs(turned[out] - columns[out] @ coefficients)
    _, place = np.unique(block, return_inverse=True)
    return np.asarray(np.bincount(place, left) / np.bincount(place))
