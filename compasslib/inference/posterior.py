"""How probable each hypothesis is: none, or up to three effects; forms, dates and slow water are summed over."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import factorial

import numpy as np

from compasslib.effects import COMPOSED, Effect, side_of
from compasslib.inference.finding import SURE
from compasslib.types import Floats

Hypothesis = tuple[int, ...]  # numbers of candidates

LIKELIER_THAN_NOT = 0.5  # probability that there are so many effects, from which so many are named
MOST_TERMS = 3  # that a hypothesis may have: seconds
SIDES_IN_ORDER = ("compass", "clock", "reference", "water")
# Of short records: odds beforehand of one effect, over the alarm that is asked for, and by what another is less likely.
ODDS, FURTHER = 2.0, 0.5
UNLISTED = 1.0 / 3.0  # of the odds of a fault: that of what no catalogue lists
AGAIN = 0.25  # probability that what has a fault has another one
LOG_EVIDENCE_CUTOFF = 8.0  # natural units below the best at which a hypothesis, or a kind of water, is left out


@dataclass(frozen=True)
class FindingPosterior:
    """What may stand in the place of one finding, with probabilities that sum to 1."""

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
        return [tuple(sorted(self.effects[k] for k in hypothesis)) for hypothesis in self.hypotheses]

    @cached_property
    def acting(self) -> dict[str, float]:
        """Probability that each effect acts, alone or with others."""
        each = zip(self.names, self.probability.tolist(), strict=True)
        sums = Counter(dict.fromkeys(self.effects, 0.0))
        for names, probability in each:
            sums.update(dict.fromkeys(names, probability))
        return dict(sums)

    def sides(self, dropped: Collection[str] = ()) -> dict[str, float]:
        """Compute the probability of each side; a hypothesis of several counts for the first of SIDES_IN_ORDER.

        Args:
            dropped: names of effects that count as nothing.
        """
        sums = dict.fromkeys(("none", *SIDES_IN_ORDER), 0.0)
        for names, probability in zip(self.names, self.probability.tolist(), strict=True):
            present = {side_of(name) for name in names if name not in dropped}
            sums[next((side for side in SIDES_IN_ORDER if side in present), "none")] += probability
        return sums

    @property
    def counts(self) -> list[int]:
        """The number of effects of each hypothesis."""
        return [len(hypothesis) for hypothesis in self.hypotheses]

    @property
    def stated_count(self) -> int:
        """The number of effects that there are at least as probably as not."""
        return self.count_of(LIKELIER_THAN_NOT)

    @property
    def best(self) -> Hypothesis:
        """The likeliest hypothesis of as many effects as are stated."""
        return self.likeliest_of(self.stated_count)

    def count_of(self, sure: float) -> int:
        """Count the effects that there are at least with some probability."""
        count = np.array(self.counts)
        return max((k for k in range(1, MOST_TERMS + 1) if self.probability[count >= k].sum() > sure), default=0)

    def likeliest_of(self, most: int) -> Hypothesis:
        """Choose the likeliest hypothesis of the likeliest names among those of so many effects."""
        sums = Counter[tuple[str, ...]]()
        for names, count, probability in zip(self.names, self.counts, self.probability.tolist(), strict=True):
            sums[names] += probability * (count == most)
        chosen = sums.most_common(1)[0][0]
        matching = [k for k, names in enumerate(self.names) if names == chosen]
        return self.hypotheses[max(matching, key=lambda k: float(self.probability[k]))]

    def finding_posteriors(
        self, chosen: Hypothesis, *, instead: str | None, alike: Callable[[int, int], float] = lambda a, b: 0.0
    ) -> list[FindingPosterior]:
        """Weigh what may stand in the place of each effect of a hypothesis.

        Args:
            instead: what else a place holds in which no effect stands; None leaves those hypotheses out.
            alike: how much two candidates' columns have in common, 0 to 1.
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
        """Match the effects of another hypothesis to the places of the chosen ones."""
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
        alarm: probability that noise alone is allowed to give a name.
    """
    return [0.0 if kind.always_present else float(np.log(alarm * ODDS)) for kind in kinds]


def log_shares(kinds: Sequence[type[Effect]]) -> list[float]:
    """Divide the odds of a fault over the names that a record can test: the log share of each candidate's name.

    Listed faults of compass and clock share alike what compositions leave; one of the reference is as likely as one
    of them. What is always present has odds of one.
    """
    listed = {kind.name for kind in kinds if not (kind.always_present or kind.name.startswith(COMPOSED))}
    faults = [name for name in listed if side_of(name) in ("compass", "clock")]
    unlisted = any(kind.name.startswith(COMPOSED) for kind in kinds)
    each = (1.0 - UNLISTED * unlisted) / max(len(faults), 1)
    composed, other = (float(np.log(share)) for share in (UNLISTED, each))
    return [0.0 if kind.always_present else composed if kind.name.startswith(COMPOSED) else other for kind in kinds]


def log_prior(hypotheses: Sequence[Hypothesis], always: Sequence[bool], shares: Sequence[float], odds: float) -> Floats:
    """Compute the log odds beforehand of hypotheses against none, (h,).

    The shares of one effect sum to the odds of a fault; further ones come with the probability ``AGAIN`` each.

    Args:
        always: of each candidate whether it is always present.
        shares: log share of each candidate.
        odds: of any fault of compass or clock.
    """
    result = []
    for hypothesis in hypotheses:
        n = sum(not always[k] for k in hypothesis)
        several = np.log(odds * (1.0 - AGAIN) * factorial(n)) + (n - 1) * np.log(AGAIN) if n else 0.0
        result.append(float(several) + sum(shares[k] for k in hypothesis))
    return np.array(result)


def joint_odds(each: Sequence[float]) -> float:
    """Compute the log prior odds of several effects together, given those of each."""
    return float(sum(each) + max(len(each) - 1, 0) * np.log(FURTHER))


def _assignments(
    places: Sequence[int], come: Sequence[int], alike: Callable[[int, int], float]
) -> list[tuple[int, int]]:
    """Assign other effects to the places of those that they are most alike."""
    if not places or not come:
        return []
    size = min(len(places), len(come))
    tries = (
        list(zip(subset, order, strict=True))
        for subset in itertools.combinations(places, size)
        for order in itertools.permutations(come, size)
    )
    return max(tries, key=lambda pairs: sum(alike(place, k) for place, k in pairs))
