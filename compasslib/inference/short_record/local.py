"""Where and when a term acts: dates that are tried, and errors without a name at a few headings or for a while only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from compasslib.effects.composed import hat
from compasslib.effects.term import Scene, Term, parameter, place
from compasslib.inference.short_record import fitting
from compasslib.inference.short_record.channel import Channel
from compasslib.inference.short_record.fitting import FittedTerms
from compasslib.types import Floats

DATES, MARGIN = 150, 0.06  # of steps that are tried, and how near to the ends
FINER = 24  # dates around the best of those that were tried
EDGES, NEAR_EDGES = (40, 120), 9  # begins and ends of a while, in a long recording and a short; around the best
SHORT = 250  # samples

SECTORS, REACHES_DEG = 36, (15.0, 25.0, 40.0)  # where an error at a few headings is tried, and how far it reaches
FINER_DEG = (-8.0, -4.0, 0.0, 4.0, 8.0)  # about the best sector
FEWEST = 3  # samples in either


@dataclass(frozen=True)
class _Astray(Term):
    """The reading is off by a constant somewhere; no physics."""

    stage: ClassVar = "readout"
    acts_on: ClassVar = "reading"
    literature: ClassVar[str] = "none: what no term of the catalogue is and some of them imitate"
    along: ClassVar[tuple[str, ...]]  # covariates of which one is needed

    offset_deg: float = parameter("degrees", "recorded minus what the compass would have recorded", 1.0)

    @classmethod
    def fits(cls, channel: Channel) -> bool:
        """Tell whether a comparison shows a reading along one of the covariates."""
        return channel.reads and any(name in channel.covariates for name in cls.along)

    def undone(self, reading_deg: Floats, scene: Scene) -> Floats:
        """Return the reading without the error, which is counted along the reading itself."""
        return 2.0 * reading_deg - self.act(reading_deg, scene)


@dataclass(frozen=True)
class SectorAstray(_Astray):
    """The reading is off at some headings only: a card that is pulled or hangs."""

    name: ClassVar[str] = "composed:reading/heading/bump"
    along: ClassVar[tuple[str, ...]] = ("heading",)

    centre_deg: float = place("degrees")
    reach_deg: float = place("degrees")

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the reading with the error."""
        return x + self.offset_deg * self.share(x)

    def share(self, x: Floats) -> Floats:
        """Return how much of the error acts at some readings, (n,) 0 to 1.

        Args:
            x: readings, (n,) degrees.
        """
        return hat(x, self.centre_deg, self.reach_deg)


@dataclass(frozen=True)
class WhileAstray(_Astray):
    """The reading is off for a while: nothing goes astray and comes back by as much of itself."""

    name: ClassVar[str] = "composed:reading/time/box"
    along: ClassVar[tuple[str, ...]] = ("time", "reading")

    begin_s: float = place("s")
    end_s: float = place("s")

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the reading with the error."""
        return x + self.offset_deg * self.share(scene.time_s)

    def share(self, x: Floats) -> Floats:
        """Return 1 while the error acts, (n,).

        Args:
            x: time, or number of the reading, (n,).
        """
        return ((x >= self.begin_s) & (x < self.end_s)).astype(float)


LOCAL = (SectorAstray, WhileAstray)


def places(fitted: FittedTerms, kind: type[Term], near: Term | None = None) -> list[Term]:
    """Return a kind of term at zero size at every place and date that is tried, one that has none once.

    Args:
        fitted: the hypothesis beside which it is tried.
        near: the term where it did best; places between those tried before.
    """
    channel = fitted.channel
    if kind is SectorAstray:
        made = [kind(0.0, centre, reach) for centre, reach in _sectors(near)]
        return [one for one in made if np.count_nonzero(one.share(channel.covariates["heading"])) >= FEWEST]
    if kind is WhileAstray:
        return [kind(0.0, begin, end) for begin, end in _whiles(channel, near)]
    if kind.dated():
        return [_placed(near or kind(), date_s=date) for date in _dates(channel, near)]
    return [kind()] if near is None else []


def columns(fitted: FittedTerms, terms: Sequence[Term]) -> Floats:
    """Return the derivative of the simulated heading by the parameters of a term at each of its places, (n, g, p).

    Args:
        terms: of one kind.
    """
    channel, first = fitted.channel, terms[0]
    if isinstance(first, LOCAL):
        always = fitting.columns(fitted, WhileAstray(0.0, -np.inf, np.inf))
        x = channel.time_s if isinstance(first, WhileAstray) else channel.covariates["heading"]
        acting = np.stack([one.share(x) for one in terms if isinstance(one, LOCAL)], axis=1)
    elif first.dated():
        always = fitting.columns(fitted, _placed(first, date_s=-np.inf))
        acting = (channel.time_s[:, None] >= np.array([one.date for one in terms])).astype(float)
    else:
        always, acting = fitting.columns(fitted, first), np.ones((len(channel), 1))
    return always[:, None, :] * acting[:, :, None]


def _placed(term: Term, **places_: Any) -> Term:
    return replace(term, **places_)


def _sectors(near: Term | None) -> list[tuple[float, float]]:
    if isinstance(near, SectorAstray):
        return [(near.centre_deg + away, near.reach_deg) for away in FINER_DEG]
    return [(360.0 / SECTORS * k, reach) for k in range(SECTORS) for reach in REACHES_DEG]


def _whiles(channel: Channel, near: Term | None) -> list[tuple[float, float]]:
    n = len(channel)
    most = EDGES[n < SHORT]
    if isinstance(near, WhileAstray):
        reach = -(-n // most)
        middle = [int(np.searchsorted(channel.time_s, edge)) for edge in (near.begin_s, near.end_s)]
        edges = [np.unique(np.linspace(m - reach, m + reach, NEAR_EDGES).astype(int).clip(1, n - 1)) for m in middle]
    else:
        edges = [np.unique(np.linspace(1, n - 1, min(n - 1, most)).astype(int))] * 2
    both = [(int(a), int(b)) for a in edges[0] for b in edges[1] if b - a >= FEWEST]
    return [(_between(channel, a), _between(channel, b)) for a, b in both]


def _dates(channel: Channel, near: Term | None) -> list[float]:
    """Return the dates that are tried, between samples."""
    n = len(channel)
    if near is None:
        first = max(2, int(MARGIN * n))
        at = np.unique(np.linspace(first, n - first, min(DATES, n - 2 * first + 1)).astype(int))
    else:
        inside = np.flatnonzero(np.abs(channel.time_s - near.date) <= float(np.ptp(channel.time_s)) / DATES)
        inside = inside[(inside > 0) & (inside < n - 1)]
        at = inside[np.unique(np.linspace(0, len(inside) - 1, FINER).astype(int))] if len(inside) else inside
    return [_between(channel, int(k)) for k in at]


def _between(channel: Channel, k: int) -> float:
    return float((channel.time_s[k - 1] + channel.time_s[k]) / 2.0)
