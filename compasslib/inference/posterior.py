"""Compute the posterior of hypotheses of up to three effects, marginalized over forms, dates and slow water."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from compasslib.effects import Effect
from compasslib.inference.finding import SURE
from compasslib.types import Floats

Hypothesis = tuple[int, ...]  # indices of candidates

LIKELIER_THAN_NOT = 0.5  # probability of a number of effects above which as many are named
MOST_TERMS = 3  # in a hypothesis; limits the run time
# Prior odds of one effect over the alarm probability, and factor for each further effect.
ODDS, FURTHER = 2.0, 0.5


@dataclass(frozen=True)
class FindingPosterior:
    """The probabilities of one finding and of its alternatives."""

    effect: str
    probability: float
    alternatives: Mapping[str, float]  # likeliest first, until they and the effect sum to ``SURE``


@dataclass(frozen=True)
class Posterior:
    """Hypotheses with their probabilities."""

    effects: Sequence[str]  # name of each candidate
    hypotheses: list[Hypothesis]  # that of no effect first
    probability: Floats  # (h,)
    prior: Floats  # (h,) log prior odds

    @cached_property
    def names(self) -> list[tuple[str, ...]]:
        """The effects of each hypothesis, in alphabetical order."""
        return [tuple(sorted(self.effects[k] for k in hypothesis)) for hypothesis in self.hypotheses]

    @cached_property
    def acting(self) -> dict[str, float]:
        """Probability that each effect acts, alone or with others."""
        each = zip(self.names, self.probability.tolist(), strict=True)
        sums = Counter(dict.fromkeys(self.effects, 0.0))
        for names, probability in each:
            sums.update(dict.fromkeys(names, probability))
        return dict(sums)

    @property
    def counts(self) -> list[int]:
        """The number of effects of each hypothesis."""
        return [len(hypothesis) for hypothesis in self.hypotheses]

    @property
    def stated_count(self) -> int:
        """Largest number of effects with a probability above ``LIKELIER_THAN_NOT``."""
        return self.count_of(LIKELIER_THAN_NOT)

    @property
    def best(self) -> Hypothesis:
        """The likeliest hypothesis with ``stated_count`` effects."""
        return self.likeliest_of(self.stated_count)

    def count_of(self, sure: float) -> int:
        """Find the largest number of effects that is reached with more than a given probability."""
        count = np.array(self.counts)
        return max((k for k in range(1, MOST_TERMS + 1) if self.probability[count >= k].sum() > sure), default=0)

    def likeliest_of(self, most: int) -> Hypothesis:
        """Choose the likeliest hypothesis with the likeliest names among those of a given number of effects."""
        sums = Counter[tuple[str, ...]]()
        for names, count, probability in zip(self.names, self.counts, self.probability.tolist(), strict=True):
            sums[names] += probability * (count == most)
        chosen = sums.most_common(1)[0][0]
        matching = [k for k, names in enumerate(self.names) if names == chosen]
        return self.hypotheses[max(matching, key=lambda k: float(self.probability[k]))]

    def finding_posteriors(
        self, chosen: Hypothesis, *, instead: str | None, alike: Callable[[int, int], float] = lambda a, b: 0.0
    ) -> list[FindingPosterior]:
        """Compute the probability of each effect of a hypothesis and of its alternatives.

        Args:
            instead: name of the alternative without any effect; None excludes such hypotheses.
            alike: function of two candidates that returns the overlap of their columns, 0 to 1.
        """
        counters: list[Counter[str]] = [Counter() for _ in chosen]
        for other, probability in zip(self.hypotheses, self.probability.tolist(), strict=True):
            for place, name in enumerate(self._filled(chosen, other, instead, alike)):
                if name is not None:
                    counters[place][name] += probability
        result = []
        for k, counter in zip(chosen, counters, strict=True):
            total, effect, others = sum(counter.values()), self.effects[k], dict[str, float]()
            probability = held = counter[effect] / total
            for name, weight in counter.most_common():
                if name != effect and held < SURE:
                    others[name] = weight / total
                    held += weight / total
            result.append(FindingPosterior(effect, probability, others))
        return result

    def _filled(
        self, chosen: Hypothesis, other: Hypothesis, instead: str | None, alike: Callable[[int, int], float]
    ) -> list[str | None]:
        """Match the effects of another hypothesis to those of the chosen one."""
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


def log_prior_odds(kinds: Sequence[type[Effect]], alarm: float) -> list[float]:
    """Compute the log prior odds of the effect of each candidate, all its forms and places together.

    Args:
        alarm: probability of a false finding from noise alone.
    """
    return [0.0 if kind.always_present else float(np.log(alarm * ODDS)) for kind in kinds]


def joint_odds(each: Sequence[float]) -> float:
    """Compute the log prior odds of several effects together, given those of each."""
    return float(sum(each) + max(len(each) - 1, 0) * np.log(FURTHER))


def _assignments(
    places: Sequence[int], come: Sequence[int], alike: Callable[[int, int], float]
) -> list[tuple[int, int]]:
    """Assign other effects to the places whose effects they overlap most."""
    if not places or not come:
        return []
    size = min(len(places), len(come))
    tries = (
        list(zip(subset, order, strict=True))
        for subset in itertools.combinations(places, size)
        for order in itertools.permutations(come, size)
    )
    return max(tries, key=lambda pairs: sum(alike(place, k) for place, k in pairs))
