"""How probable each hypothesis is: none, or up to three effects; forms, dates and slow water are summed over."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from compasslib.effects import COMPOSED, Effect, side_of
from compasslib.effects.composed import ComposedEffect
from compasslib.types import Floats

Hypothesis = tuple[int, ...]  # numbers of candidates

LIKELIER_THAN_NOT = 0.5  # probability that there are so many effects, from which so many are named
MOST_TERMS = 3  # that a hypothesis may have: seconds
SIDES_IN_ORDER = ("compass", "clock", "reference", "water")
SURE = 0.95  # probability that a set of names holds
# Odds beforehand of one effect, over the alarm that is asked for; they set how often records of nothing get a name.
ODDS, ODDS_OF_WATER, ODDS_OF_COMPOSED = 2.0, 20.0, 2.0  # the last of all compositions together
FURTHER = 0.5  # by which the odds of an effect are multiplied where there is another
FAR = 8.0  # natural units below the best at which a hypothesis, or a kind of water, is left out


@dataclass(frozen=True)
class Slot:
    """One place in the findings: what may fill it, with probabilities that sum to 1."""

    effect: str
    probability: float
    alternatives: Mapping[str, float]  # likeliest first, as many as make it sure


@dataclass(frozen=True)
class Posterior:
    """Hypotheses with their probabilities."""

    effects: Sequence[str]  # name of each candidate
    hypotheses: list[Hypothesis]  # none first
    probability: Floats  # (h,)
    prior: Floats  # (h,) log odds beforehand

    @cached_property
    def names(self) -> list[tuple[str, ...]]:
        """The effects of each hypothesis, in alphabetical order."""
        return [tuple(sorted(self.effects[k] for k in one)) for one in self.hypotheses]

    @cached_property
    def acting(self) -> dict[str, float]:
        """Probability that each effect acts, alone or with others."""
        each = zip(self.names, self.probability.tolist(), strict=True)
        sums = Counter(dict.fromkeys(self.effects, 0.0))
        for names, probability in each:
            sums.update(dict.fromkeys(names, probability))
        return dict(sums)

    def sides(self, dropped: Collection[str] = ()) -> dict[str, float]:
        """Return the probability of each side; a hypothesis of several is put on the first of SIDES_IN_ORDER.

        Args:
            dropped: names of effects that count as nothing.
        """
        sums = dict.fromkeys(("none", *SIDES_IN_ORDER), 0.0)
        for names, probability in zip(self.names, self.probability.tolist(), strict=True):
            own = {side_of(name) for name in names if name not in dropped}
            sums[next((side for side in SIDES_IN_ORDER if side in own), "none")] += probability
        return sums

    @property
    def best(self) -> Hypothesis:
        """The likeliest hypothesis of as many effects as there are at least as probably as not."""
        return self.of_at_least(LIKELIER_THAN_NOT)

    def of_at_least(self, sure: float) -> Hypothesis:
        """Return the likeliest hypothesis of as many effects as there are at least.

        Args:
            sure: probability that there are so many.
        """
        count = np.array([len(one) for one in self.hypotheses])
        most = max(k for k in range(MOST_TERMS + 1) if k == 0 or self.probability[count >= k].sum() > sure)
        sums: Counter[tuple[str, ...]] = Counter()
        for names, probability in zip(self.names, self.probability.tolist(), strict=True):
            sums[names] += probability * (len(names) == most)
        chosen = sums.most_common(1)[0][0]
        own = [k for k, names in enumerate(self.names) if names == chosen]
        return self.hypotheses[max(own, key=lambda k: float(self.probability[k]))]

    def slots(
        self, chosen: Hypothesis, *, instead: str | None, alike: Callable[[int, int], float] = lambda a, b: 0.0
    ) -> list[Slot]:
        """Return what may stand in the place of each effect of a hypothesis.

        Args:
            instead: what else a place holds in which no effect stands; None leaves those hypotheses out.
            alike: how much two candidates' columns have in common, 0 to 1.
        """
        found: list[Counter[str]] = [Counter() for _ in chosen]
        for other, probability in zip(self.hypotheses, self.probability.tolist(), strict=True):
            for place, name in enumerate(self._filled(chosen, other, instead, alike)):
                if name is not None:
                    found[place][name] += probability
        return [_slot(self.effects[k], counter) for k, counter in zip(chosen, found, strict=True)]

    def _filled(
        self, chosen: Hypothesis, other: Hypothesis, instead: str | None, alike: Callable[[int, int], float]
    ) -> list[str | None]:
        """Return which effect of another hypothesis is in the place of each chosen one."""
        left, free = list(other), []
        names = [instead] * len(chosen)
        for place, k in enumerate(chosen):
            same = next((j for j in left if self.effects[j] == self.effects[k]), None)
            if same is None:
                free.append(place)
            else:
                left.remove(same)
                names[place] = self.effects[k]
        come = left[: len(free)] if len(left) <= len(free) else left
        for places in _assignments(free, come, lambda p, j: alike(chosen[p], j)):
            names[places[0]] = self.effects[places[1]]
        return names


def whole_odds(kinds: Sequence[type[Effect]], alarm: float) -> list[float]:
    """Return the log odds beforehand of the effect of each candidate, all its forms and places together.

    Args:
        alarm: probability that noise alone is allowed to give a name.
    """
    return [0.0 if kind.always_present else float(np.log(alarm * _odds(kind))) for kind in kinds]


def _odds(kind: type[Effect]) -> float:
    if kind.name.startswith(COMPOSED):
        return ODDS_OF_COMPOSED
    return ODDS_OF_WATER if side_of(kind.name) == "water" and not issubclass(kind, ComposedEffect) else ODDS


def joint_odds(each: Sequence[float]) -> float:
    """Return the log odds beforehand of several effects together, given those of each."""
    return float(sum(each) + max(len(each) - 1, 0) * np.log(FURTHER))


def _assignments(
    places: Sequence[int], come: Sequence[int], alike: Callable[[int, int], float]
) -> list[tuple[int, int]]:
    """Return which newcomer stands in which place: those that are most alike."""
    if not places or not come:
        return []
    size = min(len(places), len(come))
    tries = (
        list(zip(some, order, strict=True))
        for some in itertools.combinations(places, size)
        for order in itertools.permutations(come, size)
    )
    return max(tries, key=lambda pairs: sum(alike(place, k) for place, k in pairs))


def _slot(effect: str, counter: Counter[str]) -> Slot:
    total = sum(counter.values())
    own, others, held = counter[effect] / total, {}, counter[effect] / total
    for name, weight in counter.most_common():
        if name != effect and held < SURE:
            others[name] = weight / total
            held += weight / total
    return Slot(effect, own, others)
