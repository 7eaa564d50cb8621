"""How probable each hypothesis is: none, or up to three effects; forms, dates and slow water are summed over."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from compasslib.core.types import Floats
from compasslib.effects import COMPOSED, SLOW_WATER, Term, side_of
from compasslib.effects.composed import Composed
from compasslib.search.evidence import Candidates, Hypothesis, Products
from compasslib.search.noise import Water
from compasslib.stats import whitening

MOST_TERMS = 3  # that a hypothesis may have: seconds
SIDES_IN_ORDER = ("compass", "clock", "reference", "water")
SURE = 0.95  # probability that a set of names holds
# Odds beforehand of one effect, over the alarm that is asked for; they set how often records of nothing get a name.
ODDS, ODDS_OF_WATER, ODDS_OF_COMPOSED = 2.0, 20.0, 2.0  # the last of all compositions together
FURTHER = 0.5  # by how much an effect is likelier where there is another
NINE_IN_TEN = 1.28  # normal score of it
NEIGHBOURS = 3  # dates that do about as well as the right one
FAR = 8.0  # natural units below the best at which a hypothesis, or a kind of water, is left out
MOST_PAIRS, MOST_TRIPLES, JOINED, MOST_WATERS = 150, 60, 12, 40  # kept of each: seconds and memory
LIKELY = 25  # effects, in calm and in rough water, beside which every kind of water is tried


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
        return self.of_at_least(0.5)

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


@dataclass(frozen=True)
class BesideWater(Posterior):
    """Hypotheses with their probabilities, beside slow water of unknown size and memory."""

    candidates: Candidates
    waters: list[Water | None]
    by_water: Floats  # (w, h) joint, sums to 1

    @property
    def water_probability(self) -> Floats:
        """Probability of each kind of water, (w,)."""
        return np.asarray(self.by_water.sum(axis=1))

    def water_of(self, hypothesis: Hypothesis) -> Water | None:
        """Return the likeliest slow water beside a hypothesis, or beside those that hold it where it was not kept."""
        own = [k for k, one in enumerate(self.hypotheses) if one == hypothesis]
        own = own or [k for k, one in enumerate(self.hypotheses) if set(hypothesis) <= set(one)]
        return self.waters[int(np.argmax(self.by_water[:, own].sum(axis=1)))]

    def places(self, chosen: Hypothesis) -> list[Slot]:
        """Return what may stand in the place of each effect of a hypothesis, slow water where none does."""
        products = self.candidates.beside(self.water_of(chosen))
        return self.slots(chosen, instead=SLOW_WATER, alike=lambda a, b: _alike(self.candidates, products, a, b))


def _alike(candidates: Candidates, products: Products, a: int, b: int) -> float:
    """Return how much two candidates' columns have in common, 0 to 1."""
    first, second = candidates.parts[a], candidates.parts[b]
    own = [np.trace(products.information[np.ix_(part, part)]) for part in (first, second)]
    return float(np.sum(products.information[np.ix_(first, second)] ** 2) / max(own[0] * own[1], 1e-300))


def weigh(candidates: Candidates, alarm: float, waters: Sequence[Water | None]) -> BesideWater:
    """Return how probable each hypothesis is.

    Args:
        alarm: probability that noise alone is allowed to give a name.
        waters: kinds of slow water that are summed over.
    """
    odds = [log + share for log, share in zip(whole_odds(candidates.kinds, alarm), candidates.shares, strict=True)]

    def prior(hypotheses: Sequence[Hypothesis]) -> Floats:
        return np.array([joint_odds([odds[k] for k in one]) for one in hypotheses])

    best: Hypothesis = ()

    def scored(hypotheses: Sequence[Hypothesis], some: Sequence[int]) -> Floats:
        return log_joint(candidates, hypotheses, [waters[i] for i in some], best) + prior(hypotheses)

    alone: list[Hypothesis] = [(), *((k,) for k in range(len(candidates.groups)))]
    calm_and_rough = scored(alone, sorted({0, len(waters) - 1}))
    some = sorted({int(k) for row in calm_and_rough[:, 1:] for k in np.argsort(-row)[:LIKELY]})
    few: list[Hypothesis] = [(), *((k,) for k in some)]
    table = log_joint(candidates.only(some), [(), *((k,) for k in range(len(some)))], waters) + prior(few)
    kept = _nearest(table.max(axis=1), MOST_WATERS)
    modes = sorted({int(np.argmax(table.max(axis=1))), int(np.argmax(table[:, 0]))})
    best = few[int(np.argmax(table[modes].max(axis=0)))]
    near = _nearest_of(candidates, itertools.combinations(range(len(candidates.groups)), 2), MOST_PAIRS, scored, modes)
    near += _nearest_of(candidates, _joined(candidates, near[:JOINED]), MOST_TRIPLES, scored, modes)
    every = [*alone, *near]
    best = every[int(np.argmax(scored(every, modes).max(axis=0)))]
    joint = scored(every, kept)
    products = candidates.beside(waters[kept[int(np.argmax(joint.max(axis=1)))]])
    joint[:, [not all(term.plausible for term in candidates.terms(products, one)) for one in every]] = -np.inf
    joint = np.exp(joint - joint.max())
    joint /= joint.sum()
    names, beside = [group.name for group in candidates.groups], [waters[i] for i in kept]
    return BesideWater(names, every, joint.sum(axis=0), prior(every), candidates, beside, joint)


def mixed(first: BesideWater, second: BesideWater, share: float) -> BesideWater:
    """Return the mean of two posteriors of one recording, seen from where two hypotheses stand.

    Args:
        first: whose candidates are kept.
        share: weight of the first.
    """
    every = list(dict.fromkeys([*first.hypotheses, *second.hypotheses]))
    place = {one: k for k, one in enumerate(every)}
    rows, prior = [], np.zeros(len(every))
    for one, weight in ((first, share), (second, 1.0 - share)):
        at = [place[hypothesis] for hypothesis in one.hypotheses]
        rows.append(np.zeros((len(one.waters), len(every))))
        rows[-1][:, at] = weight * one.by_water
        prior[at] = one.prior
    joint = np.concatenate(rows)
    waters = [*first.waters, *second.waters]
    return BesideWater(first.effects, every, joint.sum(axis=0), prior, first.candidates, waters, joint)


def log_joint(
    candidates: Candidates, hypotheses: Sequence[Hypothesis], waters: Sequence[Water | None], best: Hypothesis = ()
) -> Floats:
    """Return the log likelihood of each hypothesis with each slow water, and what is expected of the water, (w, h).

    Args:
        best: the most probable hypothesis so far, see ``Candidates.log_evidence``.
    """
    tried, rows = candidates.tried(hypotheses), []
    for water in waters:
        products = candidates.beside(water)
        beforehand = products.log_likelihood + (0.0 if water is None else water.log_prior)
        rows.append(beforehand + candidates.log_evidence(products, tried, best))
    return np.array(rows)


def likeliest_water(candidates: Candidates, waters: Sequence[Water | None]) -> Water | None:
    """Return the slow water that makes a recording of no effect likeliest."""
    none = candidates.only([])
    scores = [0.0 if one is None else none.beside(one).log_likelihood + one.log_prior for one in waters]
    return waters[int(np.argmax(scores))]


def whole_odds(kinds: Sequence[type[Term]], alarm: float) -> list[float]:
    """Return the log odds beforehand of the effect of each candidate, all its forms and places together.

    Args:
        alarm: probability that noise alone is allowed to give a name.
    """
    return [0.0 if kind.evident else float(np.log(alarm * _odds(kind))) for kind in kinds]


def _odds(kind: type[Term]) -> float:
    if kind.name.startswith(COMPOSED):
        return ODDS_OF_COMPOSED
    return ODDS_OF_WATER if side_of(kind.name) == "water" and not issubclass(kind, Composed) else ODDS


def joint_odds(each: Sequence[float]) -> float:
    """Return the log odds beforehand of several effects together, given those of each."""
    return float(sum(each) + max(len(each) - 1, 0) * np.log(FURTHER))


def _sound(candidates: Candidates, hypothesis: Hypothesis) -> bool:
    """Tell whether no effect stands twice in a hypothesis; only water may veer in several ways at once."""
    groups, kinds = candidates.groups, candidates.kinds
    for a, b in itertools.combinations(hypothesis, 2):
        if kinds[a] is kinds[b] or (groups[a].name == groups[b].name and side_of(groups[a].name) != "water"):
            return False
    return True


def _joined(candidates: Candidates, pairs: Sequence[Hypothesis]) -> list[Hypothesis]:
    return sorted({tuple(sorted((*pair, k))) for pair in pairs for k in range(len(candidates.groups)) if k not in pair})


def _nearest(scores: Floats, most: int) -> list[int]:
    order = np.argsort(-scores)[:most]
    return [int(i) for i in order if scores[i] > scores[order[0]] - FAR]


def _nearest_of(
    candidates: Candidates,
    hypotheses: Iterable[Hypothesis],
    most: int,
    scored: Callable[[Sequence[Hypothesis], Sequence[int]], Floats],
    waters: Sequence[int],
) -> list[Hypothesis]:
    """Return the best of some hypotheses beside any of some waters."""
    sound = [one for one in hypotheses if _sound(candidates, one)]
    return [sound[i] for i in _nearest(scored(sound, waters).max(axis=0), most)] if sound else []


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


def detectable(found: BesideWater) -> dict[str, float]:
    """Return for each effect the visible size at which it would be likelier than not nine times in ten, rms degrees.

    Of an effect with several forms or dates it is the middle one.
    """
    candidates = found.candidates
    products = candidates.beside(found.water_of(found.best))
    taken = {candidates.groups[k].name for k in found.best}
    sizes: dict[str, list[float]] = {}
    for k, group in enumerate(candidates.groups):
        part = candidates.parts[k]
        information = products.information[np.ix_(part, part)] / candidates.uneven[k]
        charge = -float(found.prior[found.hypotheses.index((k,))]) - np.log(
            min(candidates.kinds.count(candidates.kinds[k]), NEIGHBOURS)
        )
        needed = np.sqrt(2.0 * (charge + 0.5 * np.linalg.slogdet(information + np.eye(len(part)))[1]))
        unit = np.trace(whitening.inverse(information) @ candidates.visible[np.ix_(part, part)]) / len(part)
        if group.name not in taken and not group.name.startswith(COMPOSED):
            sizes.setdefault(group.name, []).append((needed + NINE_IN_TEN) * float(np.sqrt(unit)))
    return {name: float(np.median(size)) for name, size in sizes.items()}
