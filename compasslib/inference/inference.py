"""What a recording shows: the posterior where the likeliest hypothesis stands, refitted in the forward model.

Every hypothesis, none or up to three effects, is weighed beside slow water of every kind. Columns of effects are
slopes, and widths, filter and slow water those of what is left: both are taken anew where the likeliest hypothesis has
been refitted, until it stays what it is.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from compasslib.effects import COMPOSED, SLOW_WATER, Effect, side_of
from compasslib.effects.composed import ComposedEffect
from compasslib.effects.effect import HOUR_S
from compasslib.effects.forward import heading_jacobian
from compasslib.inference import design, evidence, grammar, noise
from compasslib.inference.design import Estimate, FittedModel, Products
from compasslib.inference.evidence import Candidates
from compasslib.inference.grammar import Found
from compasslib.inference.noise import SlowNoiseBasis, SlowNoiseParams
from compasslib.inference.posterior import FAR, Hypothesis, Posterior, Slot, joint_odds, whole_odds
from compasslib.statistics.whitening import correlation_time, sampling_interval_s, scaled_inverse
from compasslib.types import Floats

NINE_IN_TEN = 1.28  # normal score of it
NEIGHBOURS = 3  # dates that do about as well as the right one
MOST_PAIRS, MOST_TRIPLES, JOINED, MOST_WATERS = 150, 60, 12, 40  # kept of each: seconds and memory
LIKELY = 25  # effects, in calm and in rough water, beside which every kind of water is tried

SLOW: Mapping[str, Callable[[SlowNoiseParams], float]] = {
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
class BesideWater(Posterior):
    """Hypotheses with their probabilities, beside slow water of unknown size and memory."""

    candidates: Candidates
    waters: list[SlowNoiseParams | None]
    by_water: Floats  # (w, h) joint, sums to 1

    @property
    def water_probability(self) -> Floats:
        """Probability of each kind of water, (w,)."""
        return np.asarray(self.by_water.sum(axis=1))

    def water_of(self, hypothesis: Hypothesis) -> SlowNoiseParams | None:
        """Return the likeliest slow water beside a hypothesis, or beside those that hold it where it was not kept."""
        own = [k for k, one in enumerate(self.hypotheses) if one == hypothesis]
        own = own or [k for k, one in enumerate(self.hypotheses) if set(hypothesis) <= set(one)]
        return self.waters[int(np.argmax(self.by_water[:, own].sum(axis=1)))]

    def places(self, chosen: Hypothesis) -> list[Slot]:
        """Return what may stand in the place of each effect of a hypothesis, slow water where none does."""
        products = self.candidates.beside(self.water_of(chosen))
        return self.slots(chosen, instead=SLOW_WATER, alike=lambda a, b: _alike(self.candidates, products, a, b))


def weigh(candidates: Candidates, alarm: float, waters: Sequence[SlowNoiseParams | None]) -> BesideWater:
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
    candidates: Candidates,
    hypotheses: Sequence[Hypothesis],
    waters: Sequence[SlowNoiseParams | None],
    best: Hypothesis = (),
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


def likeliest_water(candidates: Candidates, waters: Sequence[SlowNoiseParams | None]) -> SlowNoiseParams | None:
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
        unit = np.trace(scaled_inverse(information) @ candidates.visible[np.ix_(part, part)]) / len(part)
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


@dataclass(frozen=True)
class Inference:
    """The likeliest hypothesis refitted, and how probable it and the others are."""

    state: FittedModel  # with its terms, slow water in the noise
    posterior: BesideWater
    chosen: Hypothesis  # the terms' candidates, in their order
    slots: tuple[Slot, ...]

    def estimate(self, state: FittedModel) -> Estimate:
        """Return how sure everything is that a state was refitted with, slow water of every kind being averaged over.

        Args:
            state: of this recording, with any terms.
        """
        found, slow = self.posterior, self.posterior.candidates.slow
        quiet = design.evaluate_model(replace(state.case, louder=None), state.simulation, state.nuisance)
        columns = quiet.base if slow is None else np.concatenate([quiet.base, slow.columns], axis=1)
        scale = np.linalg.norm(quiet.base, axis=0)
        scale = np.where(scale > 0.0, scale, 1.0)
        white = quiet.whitener(columns) * quiet.response / quiet.sigma / np.sqrt(found.candidates.scatter)
        white[:, : len(scale)] /= scale
        information = white.T @ white
        score = white.T @ quiet.innovation / quiet.sigma / np.sqrt(found.candidates.scatter)
        known = STEADY * np.diag(information)[: len(scale)]
        ridge = np.diag(quiet.base_ridge * (quiet.response / quiet.sigma / scale) ** 2 + known)
        ridge += quiet.external_information()[0] / np.outer(scale, scale)
        steps, covariances = [], []
        for water in found.waters:
            products = evidence.beside(information, score, len(scale), slow, water)
            covariances.append(scaled_inverse(products.information + ridge))
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
        assert isinstance(term, ComposedEffect)
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
        return replace(self, state=design.refit(self.state, terms), chosen=chosen, slots=slots)

    @property
    def weighted(self) -> list[tuple[float, FittedModel]]:
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
            compass = tuple(k for k in one if not self.state.case.has_slow_noise or _of_compass(groups[k].term))
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

    def _refitted(self, hypothesis: Hypothesis) -> FittedModel:
        products = self.posterior.candidates.beside(self.posterior.water_of(hypothesis))
        return design.refit(self.state, self.posterior.candidates.terms(products, hypothesis))


def infer(empty: FittedModel, alarm: float) -> Inference:
    """Return what the recording tells.

    Args:
        empty: the simulation without terms.
        alarm: probability that noise alone is allowed to give a name.
    """
    slow = noise.slow_noise_basis(empty.case)
    waters: Sequence[SlowNoiseParams | None] = [None] if slow is None else slow.waters()
    listed = evidence.drawn(empty, [])
    state = replace(empty, case=replace(empty.case, usual=listed.by_kind))
    whole = evidence.gathered(state, slow, listed, np.ones(len(listed.groups)))
    state = _begun(state, whole, waters)
    composed = grammar.screen(state)
    state = _expecting(state, composed)
    stood = {_kinds(state.simulation.terms): state}
    for _ in range(MOST_ROUNDS):
        candidates, view = _gathered(state, slow, composed)
        found = weigh(candidates, alarm, waters)
        best = found.best
        kinds = _kinds([candidates.groups[k].term for k in best])
        if _same_terms(state, candidates, best):
            break
        if kinds in stood and kinds and kinds != _kinds(state.simulation.terms):
            # Each looks better from where the other stands: both views count, by what each leaves.
            other, state = state, stood[kinds]
            candidates, _ = _gathered(state, slow, composed)
            likelier = (
                (design.log_likelihood_gain(other, state) - design.log_likelihood_gain(state, other))
                / 2.0
                / candidates.scatter
            )
            share = 1.0 / (1.0 + np.exp(-np.clip(likelier, -MOST_SURE, MOST_SURE)))
            found = mixed(weigh(candidates, alarm, waters), found, share)
            best = found.best
            if not _same_terms(state, candidates, best):
                state = design.refit(state, candidates.terms(candidates.beside(found.water_of(best)), best))
            break
        water = found.water_of(best)
        state = _beside(state, view, slow, water)
        state = design.refit(state, candidates.terms(candidates.beside(water), best))
        state, composed = _moved(state, composed)
        stood[kinds] = state
        if best:
            composed = grammar.with_more(composed, grammar.screen(state))
            state = _expecting(state, composed)
    return Inference(design.refine_dates(state), found, best, tuple(found.places(best)))


def _moved(state: FittedModel, composed: Sequence[Found]) -> tuple[FittedModel, list[Found]]:
    """Return the state with its compositions at their best places between those that were tried, refitted.

    Rivals that have the same driver are moved to their own best places, or the one that stands would look surer.
    """
    kept, terms = list(composed), list(state.simulation.terms)
    for k, term in enumerate(terms):
        if not isinstance(term, ComposedEffect) or not term.name.startswith(COMPOSED):
            continue
        free = design.refit(state, [other for j, other in enumerate(terms) if j != k])
        for rival in grammar.rivals(term, kept):
            around = grammar.near(rival.term, state.case.scene)
            gains = design.score_gains(free, [design.term_columns(free, one) for one in around])
            best = around[int(np.argmax(gains))]
            kept = grammar.with_more(kept, [replace(rival, term=best, moved=True)])
            terms[k] = best.at(term.values) if type(best) is type(term) else terms[k]
    return (state, kept) if terms == list(state.simulation.terms) else (design.refit(state, terms), kept)


def _expecting(state: FittedModel, composed: Sequence[Found]) -> FittedModel:
    """Return the state with what is expected of compositions among what is expected."""
    usual: dict[type[Effect], Floats] = {type(one.term): one.usual for one in composed}
    return replace(state, case=replace(state.case, usual={**usual, **state.case.usual}))


def _kinds(terms: Sequence[Effect | None]) -> frozenset[type]:
    return frozenset(map(type, terms))


def _of_compass(term: Effect | None) -> bool:
    return term is not None and term.side not in ("water", "reference")


def _same_terms(state: FittedModel, candidates: Candidates, hypothesis: Hypothesis) -> bool:
    bare = [term.at(0.0 * term.values) for term in state.simulation.terms]
    return [candidates.groups[k].term for k in hypothesis] == bare  # in the order of the catalogue, both


def _begun(state: FittedModel, whole: Candidates, waters: Sequence[SlowNoiseParams | None]) -> FittedModel:
    """Return the state from which the search begins: without terms, or with one that hides in the noise it makes.

    A step of many degrees widens the scatter that it is held against, and looks like much slow water. What would be
    plain without slow water is therefore refitted, width, filter and water are learnt anew beside it, and what makes
    the recording likeliest is begun with.
    """
    slow, quiet = whole.slow, whole.beside(None)
    water = likeliest_water(whole, waters)
    if slow is not None and (water is None or water.veer.size < MUCH_VEER_DEG):
        return _beside(state, state, slow, water)
    alone = whole.log_evidence(quiet, whole.tried([(k,) for k in range(len(whole.groups))]))
    best: dict[str, int] = {}
    for k in np.argsort(-alone):
        best.setdefault(whole.groups[int(k)].name, int(k))
    tried: list[tuple[float, FittedModel, SlowNoiseParams | None]] = [(_likelihood(state, slow, water), state, water)]
    for k in [k for k in best.values() if alone[k] > PLAIN][:MOST_BEGINNINGS]:
        grown = design.refit(state, whole.terms(quiet, (k,)))
        own = None if slow is None else likeliest_water(_only_water(grown, slow), waters)
        charge = CHARGE * len(whole.parts[k]) + np.log(
            sum(group.name == whole.groups[k].name for group in whole.groups)
        )
        tried.append((_likelihood(grown, slow, own) - charge, grown, own))
    _, begun, water = max(tried, key=lambda one: one[0])
    return _beside(begun, begun, slow, water)


def _only_water(state: FittedModel, slow: SlowNoiseBasis) -> Candidates:
    """Return slow water beside a state, and no candidates."""
    return evidence.gathered(state, slow, evidence.Groups([], np.zeros(0), []), np.ones(1))


def _likelihood(state: FittedModel, slow: SlowNoiseBasis | None, water: SlowNoiseParams | None) -> float:
    """Return the log likelihood of a state with slow water, up to a constant of the recording."""
    width = state.whitener.width_deg
    known = np.isfinite(width)
    gain = 0.0
    if slow is not None and water is not None:
        gain = _only_water(state, slow).beside(water).log_likelihood + water.log_prior
    return gain - float(np.sum(np.log(width[known]))) - int(known.sum()) * float(np.log(state.sigma))


def _beside(
    state: FittedModel, view: FittedModel, slow: SlowNoiseBasis | None, water: SlowNoiseParams | None
) -> FittedModel:
    """Return the state with slow water of one kind in its noise.

    Args:
        view: whose whitener knows no slow water.
    """
    louder = None if slow is None or water is None else noise.low_rank_noise(view, slow, water)
    return design.evaluate_model(replace(state.case, louder=louder), state.simulation, state.nuisance)


def _gathered(
    state: FittedModel, slow: SlowNoiseBasis | None, composed: Sequence[Found]
) -> tuple[Candidates, FittedModel]:
    """Return all candidates where a hypothesis stands, and its state without slow water."""
    view, half = viewed(state)
    groups = evidence.drawn(half, composed)
    return evidence.gathered(view, slow, groups, evidence.unevenness(state, groups.groups)), view


def viewed(state: FittedModel) -> tuple[FittedModel, FittedModel]:
    """Return a state without slow water and with its terms given back to the residual, and one for slopes half way."""
    quiet, half = replace(state.case, louder=None), design.midpoint_linearization(state)
    slopes = heading_jacobian(half.simulation, quiet.scene, half.heading_deg, first=5)
    effect = np.nan_to_num(slopes) @ state.simulation.parameters[5:]
    return design.evaluate_model(quiet, state.simulation, state.nuisance, freed_deg=effect), half


def noise_of(found: Inference) -> dict[str, tuple[float, float]]:
    """Return what the noise was found to be, each number with its standard error."""
    state, weight = found.state, found.posterior.water_probability
    time_s = state.case.scene.time_s
    hours, step = float(np.ptp(time_s)) / HOUR_S, sampling_interval_s(time_s) / HOUR_S
    short = correlation_time(state.whitener) * step
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
