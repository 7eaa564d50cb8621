"""How likely the recording is under each hypothesis: sizes integrated over, beside any kind of slow water.

All columns of effects are in units of the sizes that physics makes usual, so that the prior of every parameter is a
standard normal law; products of all columns with each other and with the residual hold all that any hypothesis needs
(Gaussian linear model; Bishop, Pattern Recognition and Machine Learning, 2006, section 3.5).
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from compasslib.effects import Effect
from compasslib.effects.effect import USUAL_DEG
from compasslib.effects.forward import heading_jacobian
from compasslib.inference import design
from compasslib.inference.design import ColumnGroup, FittedModel, Products
from compasslib.inference.grammar import Found
from compasslib.inference.noise import SlowNoiseBasis, SlowNoiseParams
from compasslib.inference.posterior import Hypothesis
from compasslib.statistics.resampling import EVEN_BLOCKS, blocks_by_span, cluster_variance_inflation
from compasslib.statistics.whitening import whitened_basis
from compasslib.types import Floats

ALIKE = 4  # power of what two groups have in common, by which they share their noise
BLOCK_S = 3 * 86400.0  # longer than the memory that the filter leaves
ANYTHING = 1e6  # variance of what is free, in units of one sample's
ROUNDING = 1e-6  # share of what is known of a column that single precision may lose where the base is fitted anew
FAINT = 1e-3  # of a wave of slow water: variance over that of white noise below which it is left out


@dataclass(frozen=True)
class Tried:
    """Columns of some hypotheses, those of as many columns together."""

    count: int
    parts: list[tuple[NDArray[np.intp], NDArray[np.intp], Floats]]  # positions, (h,); columns, (h, k); unevenness, (h,)


@dataclass(frozen=True)
class Candidates:
    """Every effect in every form and at every date, and slow water, on one scale."""

    groups: list[ColumnGroup]
    parts: list[NDArray[np.intp]]  # columns of each group
    usual: Floats  # (p,) standard deviation that is expected of each parameter
    information: Floats  # (p + q, p + q) products of the whitened columns, those of slow water last
    score: Floats  # (p + q,)
    visible: Floats  # (p, p) mean products of the visible columns, square degrees
    uneven: Floats  # (g,) variance of each group's score over what the fitted noise makes of it, at least 1
    scatter: float  # variance of blocks of days over that of even noise, of the middle group; it is in the products
    slow: SlowNoiseBasis | None
    white: Floats  # (n, p + q) the whitened columns
    innovation: Floats  # (n,) the whitened residual, over its standard deviation
    base: Floats  # (n, b) what was projected out of both, orthonormal
    shares: Sequence[float]  # (g,) log share of each group in the odds of its effect
    free: int = 0  # columns at the end of which anything is expected

    @cached_property
    def kinds(self) -> list[type[Effect]]:
        """The class of each candidate."""
        return [type(group.term) for group in self.groups if group.term is not None]

    def beside(self, water: SlowNoiseParams | None) -> Products:
        """Return the products beside slow water of one kind, none where absent."""
        return beside(self.information, self.score, len(self.usual), self.slow, water, free=self.free)

    def only(self, some: Sequence[int]) -> Candidates:
        """Return some of the candidates beside the same slow water."""
        count = np.array([len(self.parts[k]) for k in some], dtype=int)
        own = np.concatenate([np.zeros(0, dtype=np.intp), *(self.parts[k] for k in some)])
        at = np.concatenate([own, np.arange(len(self.usual), len(self.score))])
        return replace(
            self,
            groups=[self.groups[k] for k in some],
            parts=np.split(np.arange(len(own)), np.cumsum(count)[:-1]) if len(count) else [],
            usual=self.usual[own],
            information=self.information[np.ix_(at, at)],
            score=self.score[at],
            visible=self.visible[np.ix_(own, own)],
            uneven=self.uneven[list(some)],
            white=self.white[:, at],
            shares=[self.shares[k] for k in some],
        )

    def on(self, some: NDArray[np.bool_]) -> Candidates:
        """Return the same by some of the samples only, (n,), the base fitted anew."""
        white = np.concatenate([self.white[some], self.base[some].astype(np.float32)], axis=1)
        information = (white.T @ white).astype(float)
        own = np.arange(len(self.score))
        information[own, own] += ROUNDING * np.diag(self.information)
        score = (white.T @ self.innovation[some]).astype(float)
        return replace(self, information=information, score=score, free=self.base.shape[1])

    def tried(self, hypotheses: Sequence[Hypothesis]) -> Tried:
        """Return the columns of hypotheses, those of as many columns together."""
        count = np.array([len(part) for part in self.parts])
        sizes = np.array([sum(count[k] for k in one) for one in hypotheses], dtype=int)
        parts = []
        for size in np.unique(sizes[sizes > 0]):
            at = np.flatnonzero(sizes == size)
            own = [hypotheses[int(i)] for i in at]
            index = np.array([np.concatenate([self.parts[k] for k in one]) for one in own])
            uneven = np.array([max(self.uneven[k] for k in one) for one in own])
            parts.append((at, index, uneven))
        return Tried(len(hypotheses), parts)

    def log_evidence(self, products: Products, tried: Tried, best: Hypothesis = ()) -> Floats:
        """Return the log of how much likelier each hypothesis makes the residual than none, (h,).

        What a hypothesis gains is divided by how uneven its noise is: against none all of it, against the best only
        what it gains more or less. Rivals of a strong effect would else be told apart by their unevenness alone.

        Args:
            best: the hypothesis that is the most probable so far.
        """
        gain, charge, uneven = self._gains(products, tried)
        own, _, least = (each[0] for each in self._gains(products, self.tried([best])))
        return own / least + (gain - own) / np.maximum(uneven, least) - charge

    def _gains(self, products: Products, tried: Tried) -> tuple[Floats, Floats, Floats]:
        """Return what each hypothesis gains, what it pays for its possible sizes, and its unevenness, (h,) each."""
        gain, charge, every = (np.zeros(tried.count), np.zeros(tried.count), np.ones(tried.count))
        for at, index, uneven in tried.parts:
            information = products.information[index[:, :, None], index[:, None, :]] / uneven[:, None, None]
            lower = np.linalg.cholesky(information + np.eye(index.shape[1]))
            half = np.linalg.solve(lower, (products.score[index] / uneven[:, None])[:, :, None])[:, :, 0]
            gain[at] = 0.5 * np.sum(half**2, axis=1) * uneven
            charge[at] = np.log(np.einsum("hkk->hk", lower)).sum(axis=1)
            every[at] = uneven
        return gain, charge, every

    def terms(self, products: Products, hypothesis: Hypothesis) -> list[Effect]:
        """Return the terms of a hypothesis at their likeliest values."""
        values = self._values(products, hypothesis)
        found, at = [], 0
        for k in hypothesis:
            term, part = self.groups[k].term, self.parts[k]
            assert term is not None
            found.append(term.at(values[at : at + len(part)] * self.usual[part]))
            at += len(part)
        return found

    def _values(self, products: Products, hypothesis: Hypothesis) -> Floats:
        """Return the likeliest values of a hypothesis's columns, in units of what is usual."""
        index = np.concatenate([np.zeros(0, dtype=np.intp), *(self.parts[k] for k in hypothesis)])
        uneven = self.uneven[list(hypothesis)].max(initial=1.0)
        inverse = np.linalg.inv(products.information[np.ix_(index, index)] / uneven + np.eye(len(index)))
        return np.asarray(inverse @ products.score[index] / uneven)


def beside(
    information: Floats,
    score: Floats,
    own: int,
    slow: SlowNoiseBasis | None,
    water: SlowNoiseParams | None,
    *,
    free: int = 0,
) -> Products:
    """Return products of columns with what slow water of one kind may do to them integrated over.

    Args:
        information: products of all columns, those of slow water and then the free ones last.
        score: products with the residual.
        own: columns that are kept.
        water: none where absent.
        free: columns at the end that may be of any size.
    """
    variance = np.zeros(len(information) - own)
    if slow is not None and water is not None:
        variance[: len(variance) - free] = slow.variances(water)
    variance[len(variance) - free :] = ANYTHING
    some = np.flatnonzero(variance * np.diag(information)[own:] > FAINT)
    if not len(some):
        return Products(information[:own, :own], score[:own], 0.0)
    root, at = np.sqrt(variance[some]), own + some
    lower = np.linalg.cholesky(np.eye(len(root)) + root[:, None] * information[np.ix_(at, at)] * root)
    both = root[:, None] * np.column_stack([information[at, :own], score[at]])
    half = solve_triangular(lower, both, lower=True, check_finite=False)
    cross, left = half[:, :-1], half[:, -1]
    gain = float(0.5 * left @ left - np.sum(np.log(np.diag(lower))))
    return Products(information[:own, :own] - cross.T @ cross, score[:own] - cross.T @ left, gain)


def gathered(view: FittedModel, slow: SlowNoiseBasis | None, drawn: Groups, uneven: Floats) -> Candidates:
    """Return all candidates on one scale.

    Args:
        view: whose base holds the compass and the nuisances, and no slow water.
    """
    groups, usual = drawn.groups, drawn.usual
    ends = np.cumsum([0, *(group.columns.shape[1] for group in groups)])
    none = np.zeros((len(view.case), 0))
    own = np.concatenate([none, *(group.columns for group in groups)], axis=1, dtype=np.float32)
    own *= usual.astype(np.float32)
    every = own if slow is None else np.concatenate([own, slow.columns], axis=1, dtype=np.float32)
    middle = max(float(np.median(uneven)), 1.0)
    sigma = view.sigma * np.sqrt(middle)
    white = view.whiten_and_project(every) * np.float32(view.response / sigma)
    innovation = (view.innovation / sigma).astype(np.float32)
    seen = view.visible(own)
    information, score = (white.T @ white).astype(float), (white.T @ innovation).astype(float)
    for group, a, b in zip(groups, ends[:-1], ends[1:], strict=True):
        if type(group.term) in view.case.shared:  # scores and information add
            told, pulled = view.case.shared[type(group.term)]  # type: ignore[index]
            information[a:b, a:b] += told * np.outer(usual[a:b], usual[a:b])
            score[a:b] += pulled * usual[a:b]
    return Candidates(
        groups=groups,
        parts=[np.arange(a, b) for a, b in itertools.pairwise(ends)],
        usual=usual,
        information=information,
        score=score,
        visible=seen.T @ seen / len(seen),
        uneven=np.maximum(uneven / middle, 1.0),
        scatter=middle,
        slow=slow,
        white=white,
        innovation=innovation,
        base=view.basis,
        shares=drawn.shares,
    )


def unevenness(state: FittedModel, groups: Sequence[ColumnGroup]) -> Floats:
    """Return what blocks of days make of each group's score, over what even noise would (a sandwich by clusters), (g,).

    Real water scatters more in some weeks and at some headings than speeds tell (Liang and Zeger, Biometrika 73, 13,
    1986). What few blocks tell is drawn towards what all groups do.

    Args:
        state: with slow water in its noise.
    """
    ends = np.cumsum([0, *(group.columns.shape[1] for group in groups)])
    white = state.whiten_and_project(np.concatenate([group.columns for group in groups], axis=1, dtype=np.float32))
    own, count = np.ones(len(groups)), np.ones(len(groups))
    bases, block = [], blocks_by_span(state.case.scene.time_s, BLOCK_S)
    for k, (a, b) in enumerate(itertools.pairwise(ends)):
        bases.append(whitened_basis(white[:, a:b]))
        if bases[k].shape[1]:
            own[k], count[k] = cluster_variance_inflation(
                bases[k].astype(float), state.innovation, block, state.sigma**2
            )
    trust = EVEN_BLOCKS
    held = _as_neighbours(bases, count * own + trust * float(np.median(own)))
    return np.asarray(held / _as_neighbours(bases, count + trust))


def _as_neighbours(bases: Sequence[Floats], each: Floats) -> Floats:
    """Return the mean of something over the groups that are alike, (g,): rivals must not differ by chance in it."""
    every = np.concatenate(bases, axis=1)
    begins = np.cumsum([0, *(basis.shape[1] for basis in bases)])[:-1]
    some = np.array([basis.shape[1] > 0 for basis in bases])
    alike = np.add.reduceat(np.add.reduceat((every.T @ every) ** 2, begins[some], axis=0), begins[some], axis=1)
    size = np.sqrt(np.diag(alike))
    weight = (alike / np.outer(size, size)) ** ALIKE
    result = each.copy()
    result[some] = weight @ each[some] / weight.sum(axis=1)
    return result


@dataclass(frozen=True)
class Groups:
    """Columns of every effect in every form and at every place, what is expected of them, and their shares."""

    groups: list[ColumnGroup]
    usual: Floats  # (p,) standard deviation that is expected of each parameter
    shares: list[float]  # (g,) log share of each in the odds of its effect

    @property
    def by_kind(self) -> dict[type[Effect], Floats]:
        """What is expected of each kind of term, (k,) each."""
        ends = np.cumsum([group.columns.shape[1] for group in self.groups])
        parts = zip(self.groups, np.split(self.usual, ends[:-1]), strict=True) if self.groups else ()
        return {type(group.term): part for group, part in parts if group.term is not None}


def drawn(view: FittedModel, composed: Sequence[Found]) -> Groups:
    """Return every effect of the catalogue that can be tested, and compositions.

    Where physics sets no size, an effect turns headings by some degrees, whatever its cause does in this recording.
    What was expected once stays so, wherever the columns are taken.
    """
    groups, usual, shares = [], [], []
    standing, forms = _standing(view), Counter(kind.name for kind in view.case.terms)
    for kind in view.case.terms:
        always = design.term_columns(view, kind())
        some = design.step_columns(view, kind, design.step_dates(view.case.scene.time_s)) if kind.dated() else [always]
        groups += [standing.get(group.term, group) for group in some]
        usual += [_expected(view, always)] * len(some)
        shares += [-float(np.log(forms[kind.name] * len(some)))] * len(some)
    for one in composed:
        group = design.term_columns(view, one.term)
        groups.append(standing.get(one.term, group))
        usual.append(one.usual)
        shares.append(one.log_share)
    return Groups(groups, np.concatenate([np.zeros(0), *usual]), shares)


def _expected(view: FittedModel, group: ColumnGroup) -> Floats:
    """Return the standard deviation that is expected of each parameter of a term, (k,)."""
    assert group.term is not None
    if (known := view.case.usual.get(type(group.term))) is not None:
        return known
    turn = np.sqrt(np.mean(group.columns**2, axis=0))
    with np.errstate(divide="ignore"):
        physical = type(group.term).expected() ** -0.5
        expected = np.where(np.isfinite(physical), physical, USUAL_DEG / turn)
    return np.where(turn > 0.0, expected, 0.0)


def _standing(view: FittedModel) -> dict[Effect | None, ColumnGroup]:
    """Return the groups of the terms that stand in a simulation, with the slopes of what stands there.

    A second harmonic laid over a first of many degrees begins at a reading that is bent already: it is not the first
    one growing, and would be given its effect wrongly.
    """
    terms = view.simulation.terms
    if not terms:
        return {}
    derivative = np.nan_to_num(heading_jacobian(view.simulation, view.case.scene, view.heading_deg, first=5))
    parts = np.split(derivative, np.cumsum([len(term.fitted()) for term in terms])[:-1], axis=1)
    bare = [term.at(0.0 * term.values) for term in terms]
    return {term: ColumnGroup(term.name, part, term) for term, part in zip(bare, parts, strict=True)}
