"""Evidence of the recording under each hypothesis, with the sizes of effects and slow noise marginalized.

All columns of effects are scaled by the prior standard deviation of their parameters, which makes every prior standard
normal; products of all columns with each other and with the residual are sufficient for any hypothesis (Gaussian linear
model; Bishop, Pattern Recognition and Machine Learning, 2006, section 3.5).
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from compasslib.effects import Effect
from compasslib.effects.composed import ComposedEffect, as_current
from compasslib.effects.effect import USUAL_DEG
from compasslib.effects.forward import heading_jacobian
from compasslib.inference import design
from compasslib.inference.current import CurrentPosterior, coupled_drivers, infer_current
from compasslib.inference.design import ColumnGroup, FittedModel, Products
from compasslib.inference.grammar import Composition
from compasslib.inference.noise import SlowNoiseBasis, SlowNoiseParams
from compasslib.inference.posterior import Hypothesis
from compasslib.statistics.resampling import EVEN_BLOCKS, blocks_by_span, cluster_variance_inflation
from compasslib.statistics.whitening import whitened_basis
from compasslib.types import Floats

# Power of all evidence, since the models of effects and noise are simpler than reality (docs/background/search.md).
TEMPERATURE = 0.5
ALIKE = 4  # power of the similarity of two groups, as weight in the average of their inflations
BLOCK_S = 3 * 86400.0  # longer than the autocorrelation that the filter leaves
ANYTHING = 1e6  # prior variance of free coefficients, in units of one sample's noise
FAINT = 1e-3  # variance over that of white noise below which a column of slow noise is left out


@dataclass(frozen=True)
class HypothesisIndex:
    """Column indices of several hypotheses, grouped by their number of columns."""

    count: int
    parts: list[tuple[NDArray[np.intp], NDArray[np.intp], Floats]]  # positions, (h,); columns, (h, k); inflation, (h,)


@dataclass(frozen=True)
class Candidates:
    """Linear model of every effect in every form and at every date, with slow noise."""

    groups: list[ColumnGroup]
    parts: list[NDArray[np.intp]]  # column indices of each group
    usual: Floats  # (p,) prior standard deviation of each parameter
    information: Floats  # (p + q, p + q) products of the whitened columns, those of slow noise last
    score: Floats  # (p + q,) products with the whitened residual
    visible: Floats  # (p, p) mean products of the visible columns, square degrees
    current_visible: Floats  # the same for the columns of the current
    uneven: Floats  # (g,) variance inflation of each group's score relative to ``scatter``, at least 1
    scatter: float  # median variance inflation of the scores, by which the products are already divided
    slow: SlowNoiseBasis | None
    shares: Sequence[float]  # (g,) log share of each group in the prior odds of its effect
    currents: Mapping[int, NDArray[np.intp]] = field(default_factory=dict)  # columns of the same form in the current

    @cached_property
    def kinds(self) -> list[type[Effect]]:
        """The class of each candidate."""
        return [type(group.term) for group in self.groups if group.term is not None]

    def marginalize(self, water: SlowNoiseParams | None, absent: Collection[str] = ()) -> Products:
        """Marginalize slow noise of given parameters and the current in the products.

        Args:
            absent: drivers on which the current is assumed not to depend.
        """
        slow = self.slow.without_current(absent) if self.slow is not None and absent else self.slow
        return marginalize_slow_noise(self.information, self.score, len(self.usual), noise_variances(slow, water))

    def rivals(self, hypothesis: Hypothesis) -> set[str]:
        """Collect the drivers on which, under a hypothesis, the compass reading depends instead of the current."""
        return set().union(*(coupled_drivers(self.kinds[k].driver) for k in hypothesis if k in self.currents))

    def current(self, hypothesis: Hypothesis, water: SlowNoiseParams | None) -> CurrentPosterior | None:
        """Infer the drivers of the current under a hypothesis and slow noise; None if the noise has no current."""
        if self.slow is None or not self.slow.drivers:
            return None
        last, end = len(self.score), len(self.usual)
        current, slow = np.arange(last - len(self.slow.drivers), last), np.arange(end, last - len(self.slow.drivers))
        effects = np.concatenate([np.zeros(0, dtype=np.intp), *(self.parts[k] for k in hypothesis)])
        at = np.concatenate([current, effects, slow])
        variance = np.append(np.ones(len(effects)), noise_variances(self.slow, water)[: len(slow)])
        products = marginalize_slow_noise(
            TEMPERATURE * self.information[np.ix_(at, at)], TEMPERATURE * self.score[at], len(current), variance
        )
        return infer_current(self.slow.drivers, products.information, products.score)

    def subset(self, selection: Sequence[int]) -> Candidates:
        """Select candidates by index, with the same slow noise."""
        count = np.array([len(self.parts[k]) for k in selection], dtype=int)
        columns = np.concatenate([np.zeros(0, dtype=np.intp), *(self.parts[k] for k in selection)])
        at = np.concatenate([columns, np.arange(len(self.usual), len(self.score))])
        return replace(
            self,
            groups=[self.groups[k] for k in selection],
            parts=np.split(np.arange(len(columns)), np.cumsum(count)[:-1]) if len(count) else [],
            usual=self.usual[columns],
            information=self.information[np.ix_(at, at)],
            score=self.score[at],
            visible=self.visible[np.ix_(columns, columns)],
            uneven=self.uneven[list(selection)],
            shares=[self.shares[k] for k in selection],
            currents={},
        )

    def index(self, hypotheses: Sequence[Hypothesis]) -> HypothesisIndex:
        """Index the columns of hypotheses, grouped by their number of columns."""
        count = np.array([len(part) for part in self.parts])
        sizes = np.array([sum(count[k] for k in hypothesis) for hypothesis in hypotheses], dtype=int)
        parts = []
        for size in np.unique(sizes[sizes > 0]):
            at = np.flatnonzero(sizes == size)
            alike = [hypotheses[int(i)] for i in at]
            index = np.array([np.concatenate([self.parts[k] for k in hypothesis]) for hypothesis in alike])
            uneven = np.array([max(self.uneven[k] for k in hypothesis) for hypothesis in alike])
            parts.append((at, index, uneven))
        return HypothesisIndex(len(hypotheses), parts)

    def log_evidence(self, products: Products, hypotheses: HypothesisIndex, best: Hypothesis = ()) -> Floats:
        """Compute the log Bayes factor of each hypothesis over none, with sizes marginalized, (h,).

        Gains are divided by the variance inflation of the score: that of the best hypothesis by its own, the difference
        of another from it by the larger of the two, since inflation alone must not separate alternatives.

        Args:
            best: the most probable hypothesis so far.
        """
        gain, charge, uneven = self._gains(products, hypotheses)
        reference, _, least = (each[0] for each in self._gains(products, self.index([best])))
        return reference / least + (gain - reference) / np.maximum(uneven, least) - charge

    def _gains(self, products: Products, hypotheses: HypothesisIndex) -> tuple[Floats, Floats, Floats]:
        """Compute the gain of each hypothesis, its log Occam factor and its variance inflation, (h,) each."""
        gain, charge, inflation = (np.zeros(hypotheses.count), np.zeros(hypotheses.count), np.ones(hypotheses.count))
        for at, index, uneven in hypotheses.parts:
            information = products.information[index[:, :, None], index[:, None, :]] / uneven[:, None, None]
            lower = np.linalg.cholesky(information + np.eye(index.shape[1]))
            half = np.linalg.solve(lower, (products.score[index] / uneven[:, None])[:, :, None])[:, :, 0]
            gain[at] = 0.5 * np.sum(half**2, axis=1) * uneven
            charge[at] = np.log(np.einsum("hkk->hk", lower)).sum(axis=1)
            inflation[at] = uneven
        return gain, charge, inflation

    def terms(self, products: Products, hypothesis: Hypothesis) -> list[Effect]:
        """Build the terms of a hypothesis at their posterior means."""
        index = np.concatenate([np.zeros(0, dtype=np.intp), *(self.parts[k] for k in hypothesis)])
        uneven = self.uneven[list(hypothesis)].max(initial=1.0)
        inverse = np.linalg.inv(products.information[np.ix_(index, index)] / uneven + np.eye(len(index)))
        values = inverse @ products.score[index] / uneven  # in units of their prior standard deviations
        terms, at = [], 0
        for k in hypothesis:
            term, part = self.groups[k].term, self.parts[k]
            assert term is not None
            terms.append(term.at(values[at : at + len(part)] * self.usual[part]))
            at += len(part)
        return terms


def noise_variances(slow: SlowNoiseBasis | None, water: SlowNoiseParams | None) -> Floats:
    """Compute the prior variance of the coefficient of each column of slow noise; empty without a basis."""
    if slow is None or water is None:
        return np.zeros(0 if slow is None else slow.columns.shape[1])
    return slow.variances(water)


def marginalize_slow_noise(information: Floats, score: Floats, n: int, variance: Floats) -> Products:
    """Marginalize the coefficients of noise columns in the products of columns.

    Args:
        information: products of all columns, those of the noise last, (n + q, n + q).
        score: products with the residual, (n + q,).
        n: number of columns that are not marginalized.
        variance: prior variance of the noise's coefficients, (q,).
    """
    active = np.flatnonzero(variance * np.diag(information)[n:] > FAINT)
    if not len(active):
        return Products(information[:n, :n], score[:n], 0.0)
    root, at = np.sqrt(variance[active]), n + active
    lower = np.linalg.cholesky(np.eye(len(root)) + root[:, None] * information[np.ix_(at, at)] * root)
    both = root[:, None] * np.column_stack([information[at, :n], score[at]])
    half = solve_triangular(lower, both, lower=True, check_finite=False)
    cross, left = half[:, :-1], half[:, -1]
    gain = float(0.5 * left @ left - np.sum(np.log(np.diag(lower))))
    return Products(information[:n, :n] - cross.T @ cross, score[:n] - cross.T @ left, gain)


def build_candidates(
    view: FittedModel, slow: SlowNoiseBasis | None, columns: CandidateColumns, uneven: Floats
) -> Candidates:
    """Whiten the columns of all candidates and of slow noise, and compute their products.

    Args:
        view: model whose base contains compass and nuisances, and whose whitener does not contain slow noise.
    """
    groups, usual = columns.groups, columns.usual
    none = np.zeros((len(view.case), 0))
    rivals = [k for k, group in enumerate(groups) if slow is not None and follows_current(group.term, slow.drivers)]
    same = [design.term_columns(view, as_current(groups[k].term)) for k in rivals]  # type: ignore[arg-type]
    usual = np.concatenate([usual, *(_expected(view, group) for group in same)])
    effects = np.concatenate([none, *(group.columns for group in (*groups, *same))], axis=1, dtype=np.float32)
    effects *= usual.astype(np.float32)
    both = effects if slow is None else np.concatenate([effects, slow.columns], axis=1, dtype=np.float32)
    ends = np.cumsum([0, *(group.columns.shape[1] for group in (*groups, *same))])
    middle = max(float(np.median(uneven)), 1.0)
    sigma = view.sigma * np.sqrt(middle)
    white = view.whiten_and_project(both) * np.float32(view.response / sigma)
    innovation = (view.innovation / sigma).astype(np.float32)
    count = 0 if slow is None else len(slow.drivers)
    shown, turned = view.visible(effects), view.visible(both[:, both.shape[1] - count :])
    information, score = (white.T @ white).astype(float), (white.T @ innovation).astype(float)
    for group, a, b in zip(groups, ends, ends[1:], strict=False):
        if type(group.term) in view.case.shared:  # scores and information add
            shared_information, shared_score = view.case.shared[type(group.term)]  # type: ignore[index]
            information[a:b, a:b] += shared_information * np.outer(usual[a:b], usual[a:b])
            score[a:b] += shared_score * usual[a:b]
    return Candidates(
        groups=groups,
        parts=[np.arange(a, b) for a, b in itertools.pairwise(ends[: len(groups) + 1])],
        usual=usual,
        information=information,
        score=score,
        visible=shown.T @ shown / len(shown),
        current_visible=turned.T @ turned / len(turned),
        uneven=np.maximum(uneven / middle, 1.0),
        scatter=middle,
        slow=slow,
        shares=columns.shares,
        currents=dict(zip(rivals, (np.arange(a, b) for a, b in itertools.pairwise(ends[len(groups) :])), strict=True)),
    )


def follows_current(term: Effect | None, drivers: Collection[str]) -> bool:
    """Return whether a term makes the compass reading depend on a driver of the current, or one coupled to it."""
    if not isinstance(term, ComposedEffect) or term.composition[0] != "reading":
        return False
    return not coupled_drivers(term.driver).isdisjoint(drivers)


def score_inflation(state: FittedModel, groups: Sequence[ColumnGroup]) -> Floats:
    """Compute the variance of each group's score from blocks of days, over that of homogeneous noise, (g,).

    Real directions scatter more in some weeks and at some headings than their widths imply, which a cluster-robust
    variance includes (Liang and Zeger, Biometrika 73, 13, 1986). With few blocks it is shrunk to the median of groups.

    Args:
        state: model whose whitener contains slow noise.
    """
    ends = np.cumsum([0, *(group.columns.shape[1] for group in groups)])
    white = state.whiten_and_project(np.concatenate([group.columns for group in groups], axis=1, dtype=np.float32))
    inflation, count = np.ones(len(groups)), np.ones(len(groups))
    bases, block = [], blocks_by_span(state.case.scene.time_s, BLOCK_S)
    for k, (a, b) in enumerate(itertools.pairwise(ends)):
        bases.append(whitened_basis(white[:, a:b]))
        if bases[k].shape[1]:
            inflation[k], count[k] = cluster_variance_inflation(
                bases[k].astype(float), state.innovation, block, state.sigma**2
            )
    trust = EVEN_BLOCKS
    held = _as_neighbours(bases, count * inflation + trust * float(np.median(inflation)))
    return np.asarray(held / _as_neighbours(bases, count + trust))


def _as_neighbours(bases: Sequence[Floats], each: Floats) -> Floats:
    """Average over similar groups, (g,), since the inflations of alternatives must not differ by chance."""
    columns = np.concatenate(bases, axis=1)
    begins = np.cumsum([0, *(basis.shape[1] for basis in bases)])[:-1]
    filled = np.array([basis.shape[1] > 0 for basis in bases])
    alike = np.add.reduceat(np.add.reduceat((columns.T @ columns) ** 2, begins[filled], axis=0), begins[filled], axis=1)
    size = np.sqrt(np.diag(alike))
    weight = (alike / np.outer(size, size)) ** ALIKE
    result = each.copy()
    result[filled] = weight @ each[filled] / weight.sum(axis=1)
    return result


@dataclass(frozen=True)
class CandidateColumns:
    """Columns of every effect in every form and at every place, with prior standard deviations and shares."""

    groups: list[ColumnGroup]
    usual: Floats  # (p,) prior standard deviation of each parameter
    shares: list[float]  # (g,) log share of each group in the prior odds of its effect

    @property
    def by_kind(self) -> dict[type[Effect], Floats]:
        """Prior standard deviations of the parameters of each kind of term, (k,) each."""
        ends = np.cumsum([group.columns.shape[1] for group in self.groups])
        parts = zip(self.groups, np.split(self.usual, ends[:-1]), strict=True) if self.groups else ()
        return {type(group.term): part for group, part in parts if group.term is not None}


def enumerate_candidates(view: FittedModel, composed: Sequence[Composition]) -> CandidateColumns:
    """Enumerate every effect of the catalogue that can be tested, and compositions.

    Where physics gives no size, the prior standard deviation corresponds to a turn of ``USUAL_DEG`` in this recording.
    Priors set once are not changed when the columns are linearized again.
    """
    groups, usual, shares = [], [], []
    standing, forms = _linearized_terms(view), Counter(kind.name for kind in view.case.terms)
    for kind in view.case.terms:
        if kind.side == "water" and view.case.has_slow_noise:
            continue  # part of the noise
        always = design.term_columns(view, kind())
        steps = design.step_columns(view, kind, design.step_dates(view.case.scene.time_s)) if kind.dated() else [always]
        groups += [standing.get(group.term, group) for group in steps]
        usual += [_expected(view, always)] * len(steps)
        shares += [-float(np.log(forms[kind.name] * len(steps)))] * len(steps)
    for composition in composed:
        group = design.term_columns(view, composition.term)
        groups.append(standing.get(composition.term, group))
        usual.append(composition.usual)
        shares.append(composition.log_share)
    return CandidateColumns(groups, np.concatenate([np.zeros(0), *usual]), shares)


def _expected(view: FittedModel, group: ColumnGroup) -> Floats:
    """Compute the prior standard deviation of each parameter of a term, (k,)."""
    assert group.term is not None
    if (known := view.case.usual.get(type(group.term))) is not None:
        return known
    turn = np.sqrt(np.mean(group.columns**2, axis=0))
    with np.errstate(divide="ignore"):
        physical = type(group.term).expected() ** -0.5
        expected = np.where(np.isfinite(physical), physical, USUAL_DEG / turn)
    return np.where(turn > 0.0, expected, 0.0)


def _linearized_terms(view: FittedModel) -> dict[Effect | None, ColumnGroup]:
    """Collect the columns of the terms of a simulation, linearized at their values.

    A second term of the same kind would act on a reading that the first has already turned, and have other columns.
    """
    terms = view.simulation.terms
    if not terms:
        return {}
    derivative = np.nan_to_num(heading_jacobian(view.simulation, view.case.scene, view.heading_deg, first=5))
    parts = np.split(derivative, np.cumsum([len(term.fitted()) for term in terms])[:-1], axis=1)
    zero_terms = [term.at(0.0 * term.values) for term in terms]
    return {term: ColumnGroup(term.name, part, term) for term, part in zip(zero_terms, parts, strict=True)}
