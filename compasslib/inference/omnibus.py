"""Columns that are tested together, and how far noise alone lets their scores go: what has no name shows in them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from compasslib import angles
from compasslib.effects import Term
from compasslib.types import Floats

KNOTS = 8  # of a covariate's splines: what the omnibus sees


@dataclass(frozen=True)
class Group:
    """Columns that are tested together, (n, k) degrees a unit."""

    name: str  # effect, or covariates joined by x
    columns: Floats
    term: Term | None = None  # at zero size, its date set
    covariates: tuple[str, ...] = ()


@dataclass(frozen=True)
class Tested:
    """Groups of columns with their statistics under the data and under the record's own noise."""

    groups: list[Group]
    freedom: Floats  # (g,) directions of each group
    inflation: Floats  # (g,) mean statistic of the noise over the freedom
    score: Floats  # (g,) normal score of each group's statistic
    highest: Floats  # (r,) highest normal score of each draw of the noise

    def threshold(self, alarm: float) -> float:
        """Return the score that noise exceeds anywhere with a given probability, as the highest of some normal scores.

        To how many independent ones the draws of the noise amount is fitted by likelihood. Gumbel's law, the limit
        of very many, is reached too slowly: it lets 2 in 1000 pass where it says 6.
        """
        from scipy.special import log_ndtr, ndtri_exp  # 0.2 s that jobs which only correct do not pay

        return float(ndtri_exp(np.log1p(-alarm) * -np.mean(log_ndtr(self.highest))))


@dataclass(frozen=True)
class Rest:
    """What the omnibus tests find: groups that are significant with their visible sizes, the strongest first."""

    threshold: float  # score that noise alone hardly exceeds
    strong: tuple[tuple[Group, float], ...]
    min_effect_deg: float

    @property
    def curve(self) -> Group:
        """All that is significant along the covariates of the strongest."""
        first = self.strong[0][0]
        alike = [group.columns for group, _ in self.strong if group.covariates == first.covariates]
        return replace(first, columns=np.concatenate(alike, axis=1))

    @property
    def worth(self) -> list[tuple[Group, float]]:
        """Those that matter."""
        return [one for one in self.strong if one[1] >= self.min_effect_deg]

    @property
    def small(self) -> tuple[tuple[str, float], ...]:
        """Those that do not, one of a name."""
        return tuple({group.name: size for group, size in self.strong if size < self.min_effect_deg}.items())


def rest(tested: Tested, alarm: float, size_deg: Callable[[Group, float], float], min_effect_deg: float) -> Rest:
    """Return what is significant.

    Args:
        alarm: probability that noise alone is anywhere.
        size_deg: visible size of a group, rms, given its inflation.
    """
    if not tested.groups:
        return Rest(float("inf"), (), min_effect_deg)
    threshold = tested.threshold(alarm)
    strong = [int(k) for k in np.argsort(-tested.score) if tested.score[k] > threshold]
    sized = [(tested.groups[k], size_deg(tested.groups[k], float(tested.inflation[k]))) for k in strong]
    return Rest(threshold, tuple(sized), min_effect_deg)


def normal_score(statistic: Floats, freedom: Floats) -> Floats:
    """Return the normal score of a chi-squared statistic (Wilson and Hilferty, PNAS 17, 684, 1931).

    Args:
        statistic: (..., g).
        freedom: (g,).
    """
    spread = 2.0 / (9.0 * freedom)
    return (np.cbrt(np.maximum(statistic, 0.0) / freedom) - 1.0 + spread) / np.sqrt(spread)


def heading_hats(heading_deg: Floats, width_deg: float, fewest: float) -> Floats:
    """Return hats over the sectors that occur, (n, k).

    Args:
        width_deg: of a sector.
        fewest: readings in one.
    """
    centres = np.arange(0.0, 360.0, width_deg)
    away = np.abs(angles.difference(heading_deg[:, None], centres)) / width_deg
    hats = np.maximum(1.0 - away, 0.0)
    return hats[:, hats.sum(axis=0) >= fewest]


def periodic(angle_deg: Floats, harmonics: range) -> Floats:
    """Return sine and cosine of some multiples of an angle, (n, 2 k)."""
    return np.column_stack([x for k in harmonics for x in angles.sin_cos(k * angle_deg)])


def hats(x: Floats, count: int) -> Floats:
    """Return hat functions on knots at even quantiles, (n, k)."""
    knots = np.unique(np.quantile(x, np.linspace(0.0, 1.0, count)))
    if len(knots) < 2:
        return np.zeros((len(x), 0))
    eye = np.eye(len(knots))
    return np.column_stack([np.interp(x, knots, row) for row in eye])


def standard(x: Floats) -> Floats:
    """Return a series over its standard deviation, without far outliers, (n,)."""
    return np.clip((x - np.mean(x)) / np.std(x), -4.0, 4.0)
