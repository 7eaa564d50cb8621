"""What a recording tells: the posterior where the likeliest hypothesis stands, refitted in the forward model.

Columns of effects are slopes, and widths, filter and slow water those of what is left: both are taken anew where the
likeliest hypothesis has been refitted, until it stays what it is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from compasslib.effects import COMPOSED, Term, composition
from compasslib.effects.composed import Composed
from compasslib.effects.term import HOUR_S
from compasslib.inference import baseline, columns, evidence, grammar, model, noise, weighing
from compasslib.inference.baseline import State
from compasslib.inference.evidence import Candidates
from compasslib.inference.grammar import Found
from compasslib.inference.model import Estimate
from compasslib.inference.noise import Slow, Water
from compasslib.inference.posterior import Hypothesis, Slot
from compasslib.inference.weighing import BesideWater
from compasslib.statistics import whitening
from compasslib.types import Floats

SLOW: Mapping[str, Callable[[Water], float]] = {
    "slow_rms_deg": lambda water: water.veer.size,
    "slow_memory_days": lambda water: water.veer.memory_days,
    "slow_shear_m_s": lambda water: water.shear.size,
}
STEADY = 1e-8  # share of what is known of a column that keeps its inverse steady
MUCH_VEER_DEG, PLAIN = 1.4, 50.0  # slow veer that may hide an effect; its log evidence but for it: water feigns half
MOST_BEGINNINGS, CHARGE = 4, 5.0  # effects that are tried so, and what each of their parameters must gain
MOST_SURE = 1.4  # log odds of one of two views that contradict each other: neither counts for less than a fifth
MOST_ROUNDS = 5  # of standing elsewhere and looking again: seconds
LEAST_WEIGHT = 0.05  # probability below which a hypothesis does not enter the product
# Share of a hypothesis's weight that goes to the compass fitted together with what is named of water or reference. Real
# water has shear that no noise here knows: such a name made headings better and worse about as often as not.
BELIEVED = 0.5


@dataclass(frozen=True)
class Inference:
    """The likeliest hypothesis refitted, and how probable it and the others are."""

    state: State  # with its terms, slow water in the noise
    posterior: BesideWater
    chosen: Hypothesis  # the terms' candidates, in their order
    slots: tuple[Slot, ...]

    def estimate(self, state: State) -> Estimate:
        """Return how sure everything is that a state was refitted with, slow water of every kind being averaged over.

        Args:
            state: of this recording, with any terms.
        """
        found, slow = self.posterior, self.posterior.candidates.slow
        quiet = baseline.examine(replace(state.case, louder=None), state.simulation, state.nuisance)
        columns = quiet.base if slow is None else np.concatenate([quiet.base, slow.columns], axis=1)
        scale = np.linalg.norm(quiet.base, axis=0)
        scale = np.where(scale > 0.0, scale, 1.0)
        white = quiet.whitener(columns) * quiet.response / quiet.sigma / np.sqrt(found.candidates.scatter)
        white[:, : len(scale)] /= scale
        information = white.T @ white
        score = white.T @ quiet.innovation / quiet.sigma / np.sqrt(found.candidates.scatter)
        known = STEADY * np.diag(information)[: len(scale)]
        ridge = np.diag(quiet.base_ridge * (quiet.response / quiet.sigma / scale) ** 2 + known)
        ridge += quiet.told()[0] / np.outer(scale, scale)
        steps, covariances = [], []
        for water in found.waters:
            products = evidence.beside(information, score, len(scale), slow, water)
            covariances.append(whitening.inverse(products.information + ridge))
            steps.append(covariances[-1] @ products.score)
        weight = found.water_probability
        step = np.array(steps) - weight @ np.array(steps)
        covariance = np.einsum("w,wij->ij", weight, np.array(covariances)) + (weight[:, None] * step).T @ step
        return Estimate(state, covariance / np.outer(scale, scale))

    def said(self, effect: str) -> str:
        """Return the name of an effect as a diagnosis writes it: of a composed field its larger part is told.

        Args:
            effect: name of a candidate.
        """
        if not effect.startswith(COMPOSED):
            return effect
        found = self.posterior
        some = [i for i, names in enumerate(found.names) if effect in names]
        best = found.hypotheses[max(some, key=lambda i: float(found.probability[i]))]
        terms = found.candidates.terms(found.candidates.beside(found.water_of(best)), best)
        term = next(one for one in terms if one.name == effect)
        assert isinstance(term, Composed)
        return COMPOSED + "/".join(term.said())

    def only(self, kept: Sequence[bool]) -> Inference:
        """Return the same with some of the terms only, refitted.

        Args:
            kept: of each term whether it stays.
        """
        if all(kept):
            return self
        terms = [term for term, stays in zip(self.state.simulation.terms, kept, strict=True) if stays]
        chosen = tuple(k for k, stays in zip(self.chosen, kept, strict=True) if stays)
        slots = tuple(slot for slot, stays in zip(self.slots, kept, strict=True) if stays)
        return replace(self, state=model.refit(self.state, terms), chosen=chosen, slots=slots)

    @property
    def weighted(self) -> list[tuple[float, State]]:
        """The states that correct the record, with weights that sum to less than 1 by what was dropped.

        Of hypotheses that differ by a date only, the likeliest stands for all. What is named beside a mooring's compass
        is believed by half only, see BELIEVED: the other half of the weight is that of the compass without it.
        """
        groups, every = self.posterior.candidates.groups, self.posterior
        own = _kinds(self.state.simulation.terms)
        told = list(zip(every.hypotheses, every.probability.tolist(), strict=True))
        if len(own) < len(every.best):  # names were taken back: nothing is known of the others' weights
            told = [(self.chosen, 1.0)]
        weights: dict[frozenset[type], float] = {}
        best: dict[frozenset[type], tuple[float, Hypothesis]] = {}
        for one, p in told:
            compass = tuple(k for k in one if not self.state.case.in_water or _of_compass(groups[k].term))
            half = p if compass == one else p * BELIEVED
            for hypothesis, weight in ((one, half), (compass, p - half)):
                kinds = _kinds([groups[k].term for k in hypothesis])
                weights[kinds] = weights.get(kinds, 0.0) + weight
                best[kinds] = max(best.get(kinds, (0.0, hypothesis)), (weight, hypothesis), key=lambda x: x[0])
        found = [
            (weight, self.state if kinds == own else self._refitted(best[kinds][1]))
            for kinds, weight in weights.items()
            if weight >= LEAST_WEIGHT or kinds == own
        ]
        return sorted(found, key=lambda one: (one[1] is not self.state, -one[0]))

    def _refitted(self, hypothesis: Hypothesis) -> State:
        products = self.posterior.candidates.beside(self.posterior.water_of(hypothesis))
        return model.refit(self.state, self.posterior.candidates.terms(products, hypothesis))


def infer(empty: State, alarm: float) -> Inference:
    """Return what the recording tells.

    Args:
        empty: the simulation without terms.
        alarm: probability that noise alone is allowed to give a name.
    """
    slow = noise.of(empty.case)
    waters: Sequence[Water | None] = [None] if slow is None else slow.waters()
    listed = evidence.drawn(empty, [])
    state = replace(empty, case=replace(empty.case, usual=listed.by_kind))
    whole = evidence.gathered(state, slow, listed, np.ones(len(listed.groups)))
    state = _begun(state, whole, waters)
    composed = grammar.screen(state)
    state = _expecting(state, composed)
    stood = {_kinds(state.simulation.terms): state}
    for _ in range(MOST_ROUNDS):
        candidates, view = _gathered(state, slow, composed)
        found = weighing.weigh(candidates, alarm, waters)
        best = found.best
        kinds = _kinds([candidates.groups[k].term for k in best])
        if _same_terms(state, candidates, best):
            break
        if kinds in stood and kinds and kinds != _kinds(state.simulation.terms):
            # Each looks better from where the other stands: both views count, by what each leaves.
            other, state = state, stood[kinds]
            candidates, _ = _gathered(state, slow, composed)
            likelier = (model.gained(other, state) - model.gained(state, other)) / 2.0 / candidates.scatter
            share = 1.0 / (1.0 + np.exp(-np.clip(likelier, -MOST_SURE, MOST_SURE)))
            found = weighing.mixed(weighing.weigh(candidates, alarm, waters), found, share)
            best = found.best
            if not _same_terms(state, candidates, best):
                state = model.refit(state, candidates.terms(candidates.beside(found.water_of(best)), best))
            break
        water = found.water_of(best)
        state = _beside(state, view, slow, water)
        state = model.refit(state, candidates.terms(candidates.beside(water), best))
        state, composed = _moved(state, composed)
        stood[kinds] = state
        if best:
            composed = grammar.with_more(composed, grammar.screen(state))
            state = _expecting(state, composed)
    return Inference(model.dated(state), found, best, tuple(found.places(best)))


def _moved(state: State, composed: Sequence[Found]) -> tuple[State, list[Found]]:
    """Return the state with its compositions at their best places between those that were tried, refitted.

    Rivals that have the same driver are moved to their own best places, or the one that stands would look surer.
    """
    kept, terms = list(composed), list(state.simulation.terms)
    for k, term in enumerate(terms):
        if not isinstance(term, Composed) or not term.name.startswith(COMPOSED):
            continue
        free = model.refit(state, [other for j, other in enumerate(terms) if j != k])
        for rival in grammar.rivals(term, kept):
            around = grammar.near(rival.term, state.case.scene)
            gains = model.gains(free, [columns.of_term(free, one) for one in around])
            best = around[int(np.argmax(gains))]
            kept = grammar.with_more(kept, [replace(rival, term=best, moved=True)])
            terms[k] = best.at(term.values) if type(best) is type(term) else terms[k]
    return (state, kept) if terms == list(state.simulation.terms) else (model.refit(state, terms), kept)


def _expecting(state: State, composed: Sequence[Found]) -> State:
    """Return the state with what is expected of compositions among what is expected."""
    usual: dict[type[Term], Floats] = {type(one.term): one.usual for one in composed}
    return replace(state, case=replace(state.case, usual={**usual, **state.case.usual}))


def _kinds(terms: Sequence[Term | None]) -> frozenset[type]:
    return frozenset(map(type, terms))


def _of_compass(term: Term | None) -> bool:
    return term is not None and term.side not in ("water", "reference")


def _same_terms(state: State, candidates: Candidates, hypothesis: Hypothesis) -> bool:
    bare = [term.at(0.0 * term.values) for term in state.simulation.terms]
    return [candidates.groups[k].term for k in hypothesis] == bare  # in the order of the catalogue, both


def _begun(state: State, whole: Candidates, waters: Sequence[Water | None]) -> State:
    """Return the state from which the search begins: without terms, or with one that hides in the noise it makes.

    A step of many degrees widens the scatter that it is held against, and looks like much slow water. What would be
    plain without slow water is therefore refitted, width, filter and water are learnt anew beside it, and what makes
    the recording likeliest is begun with.
    """
    slow, quiet = whole.slow, whole.beside(None)
    water = weighing.likeliest_water(whole, waters)
    if slow is not None and (water is None or water.veer.size < MUCH_VEER_DEG):
        return _beside(state, state, slow, water)
    alone = whole.log_evidence(quiet, whole.tried([(k,) for k in range(len(whole.groups))]))
    best: dict[str, int] = {}
    for k in np.argsort(-alone):
        best.setdefault(whole.groups[int(k)].name, int(k))
    tried: list[tuple[float, State, Water | None]] = [(_likelihood(state, slow, water), state, water)]
    for k in [k for k in best.values() if alone[k] > PLAIN][:MOST_BEGINNINGS]:
        grown = model.refit(state, whole.terms(quiet, (k,)))
        own = None if slow is None else weighing.likeliest_water(_only_water(grown, slow), waters)
        charge = CHARGE * len(whole.parts[k]) + np.log(
            sum(group.name == whole.groups[k].name for group in whole.groups)
        )
        tried.append((_likelihood(grown, slow, own) - charge, grown, own))
    _, begun, water = max(tried, key=lambda one: one[0])
    return _beside(begun, begun, slow, water)


def _only_water(state: State, slow: Slow) -> Candidates:
    """Return slow water beside a state, and no candidates."""
    return evidence.gathered(state, slow, evidence.Groups([], np.zeros(0), []), np.ones(1))


def _likelihood(state: State, slow: Slow | None, water: Water | None) -> float:
    """Return the log likelihood of a state with slow water, up to a constant of the recording."""
    width = state.whitener.width_deg
    known = np.isfinite(width)
    gain = 0.0
    if slow is not None and water is not None:
        gain = _only_water(state, slow).beside(water).log_likelihood + water.log_prior
    return gain - float(np.sum(np.log(width[known]))) - int(known.sum()) * float(np.log(state.sigma))


def _beside(state: State, view: State, slow: Slow | None, water: Water | None) -> State:
    """Return the state with slow water of one kind in its noise.

    Args:
        view: whose whitener knows no slow water.
    """
    louder = None if slow is None or water is None else noise.louder(view, slow, water)
    return baseline.examine(replace(state.case, louder=louder), state.simulation, state.nuisance)


def _gathered(state: State, slow: Slow | None, composed: Sequence[Found]) -> tuple[Candidates, State]:
    """Return all candidates where a hypothesis stands, and its state without slow water."""
    view, half = viewed(state)
    groups = evidence.drawn(half, composed)
    return evidence.gathered(view, slow, groups, evidence.unevenness(state, groups.groups)), view


def viewed(state: State) -> tuple[State, State]:
    """Return a state without slow water and with its terms given back to the residual, and one for slopes half way."""
    quiet, half = replace(state.case, louder=None), baseline.halfway(state)
    slopes = composition.derivative(half.simulation, quiet.scene, half.heading_deg, first=5)
    effect = np.nan_to_num(slopes) @ state.simulation.parameters[5:]
    return baseline.examine(quiet, state.simulation, state.nuisance, freed_deg=effect), half


def noise_of(found: Inference) -> dict[str, tuple[float, float]]:
    """Return what the noise was found to be, each number with its standard error."""
    state, weight = found.state, found.posterior.water_probability
    time_s = state.case.scene.time_s
    hours, step = float(np.ptp(time_s)) / HOUR_S, whitening.step_s(time_s) / HOUR_S
    short = whitening.memory(state.whitener) * step
    width = state.whitener.width_deg
    white = float(np.median(width[np.isfinite(width)]))
    result = {
        "white_deg": (white, white * float(np.sqrt((step + 2.0 * short) / (2.0 * hours)))),
        "short_hours": (short, short * float(np.sqrt(2.0 * (step + short) / hours))),
    }
    for name, of in SLOW.items():
        each = np.array([0.0 if water is None else of(water) for water in found.posterior.waters])
        mean = float(weight @ each)
        result[name] = (mean, float(np.sqrt(weight @ (each - mean) ** 2)))
    return result
