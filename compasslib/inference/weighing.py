"""Every hypothesis of a long record weighed beside slow water of every kind: none, or up to three effects."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from compasslib.effects import COMPOSED, SLOW_WATER, side_of
from compasslib.inference.evidence import Candidates, Products
from compasslib.inference.noise import Water
from compasslib.inference.posterior import FAR, Hypothesis, Posterior, Slot, joint_odds, whole_odds
from compasslib.statistics import whitening
from compasslib.types import Floats

NINE_IN_TEN = 1.28  # normal score of it
NEIGHBOURS = 3  # dates that do about as well as the right one
MOST_PAIRS, MOST_TRIPLES, JOINED, MOST_WATERS = 150, 60, 12, 40  # kept of each: seconds and memory
LIKELY = 25  # effects, in calm and in rough water, beside which every kind of water is tried


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


def _alike(candidates: Candidates, products: Products, a: int, b: int) -> float:
    """Return how much two candidates' columns have in common, 0 to 1."""
    first, second = candidates.parts[a], candidates.parts[b]
    own = [np.trace(products.information[np.ix_(part, part)]) for part in (first, second)]
    return float(np.sum(products.information[np.ix_(first, second)] ** 2) / max(own[0] * own[1], 1e-300))


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
