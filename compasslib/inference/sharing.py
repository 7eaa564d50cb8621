"""What one record tells of its compass, as others of the same compass need it: scores and information, no samples.

The coefficients are the mean over the posterior with its covariance. Of every effect that belongs to the instrument
stand the products of its whitened columns, beside each kind of slow water that the record may have had, and with them
those of a season of the water, which may recur at every deployment.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from compasslib import angles
from compasslib.deviation import spread
from compasslib.deviation.model import Fit
from compasslib.effects import Term, all_terms, composition
from compasslib.effects.term import YEAR_S
from compasslib.inference import evidence, inference, noise
from compasslib.inference.case import Case
from compasslib.inference.evidence import Products
from compasslib.inference.inference import Inference
from compasslib.statistics import robust
from compasslib.types import Floats

MOST_WATERS, LEAST = 8, 1e-3  # kinds of slow water that are told, and their least probability
HARMONICS = (1, 2, 3, 4)  # of a season of the water; of its shear half as many
SHEAR_M_S_DEG = 0.007  # shear beside a degree of veer
SEASONS = 2 * len(HARMONICS) * 2


@dataclass(frozen=True)
class Effects:
    """The effects of the instrument in one record; p columns in physical units, then those of the season."""

    forms: tuple[str, ...]  # class of each
    parts: tuple[int, ...]  # columns of each
    usual: Floats  # (p,) what is expected of each parameter beforehand
    uneven: Floats  # (p,) by how much the noise of each is uneven, at least 1
    visible: Floats  # (p, p) mean products of the visible columns, square degrees
    beside: tuple[Products, ...]  # (p + s) beside each kind of slow water
    residual_deg: float
    n: int

    def to_json(self) -> dict[str, Any]:
        """Return it for the record's summary."""
        products = [
            {"information": one.information.tolist(), "score": one.score.tolist(), "log_likelihood": one.log_likelihood}
            for one in self.beside
        ]
        arrays = {name: getattr(self, name).tolist() for name in ("usual", "uneven", "visible")}
        plain = {"forms": self.forms, "parts": self.parts, "residual_deg": self.residual_deg, "n": self.n}
        return {**plain, **arrays, "beside": products}


def from_json(content: Mapping[str, Any]) -> Effects:
    """Return the effects that a summary holds."""
    products = tuple(
        Products(np.array(one["information"]), np.array(one["score"]), one["log_likelihood"])
        for one in content["beside"]
    )
    return Effects(
        forms=tuple(content["forms"]),
        parts=tuple(content["parts"]),
        usual=np.array(content["usual"]),
        uneven=np.array(content["uneven"]),
        visible=np.array(content["visible"]),
        beside=products,
        residual_deg=content["residual_deg"],
        n=content["n"],
    )


@dataclass(frozen=True)
class Told:
    """What a record tells of its compass."""

    coefficients: Floats  # (5,) A..E of the exact compass
    covariance: Floats  # (5, 5)
    effects: Effects | None  # None where nothing was searched

    def to_json(self) -> dict[str, Any]:
        """Return the record's summary."""
        return {
            "coefficients": self.coefficients.tolist(),
            "covariance": self.covariance.tolist(),
            "effects": None if self.effects is None else self.effects.to_json(),
        }


def of(found: Inference, fit: Fit) -> Told:
    """Return what was inferred of a record.

    Args:
        fit: the exact compass; what days do not show of its uncertainty is in its covariance.
    """
    each = [(weight, *_compass(found, state)) for weight, state in found.weighted]
    weights = np.array([weight for weight, _, _ in each])
    weights /= weights.sum()
    centres = np.array([centre for _, centre, _ in each])
    mean = weights @ centres
    inner = np.einsum("h,hij->ij", weights, np.array([covariance for _, _, covariance in each]))
    covariance = inner + (weights[:, None] * (centres - mean)).T @ (centres - mean)
    covariance += spread.positive_part(fit.covariance[:5, :5] - covariance)
    return Told(mean, covariance, _effects(found))


def of_fit(fit: Fit) -> Told | None:
    """Return what a fit tells where nothing was searched, None where nothing was fitted."""
    known = fit.fitted and fit.method == "exact"
    return Told(fit.coefficients, fit.covariance[:5, :5], None) if known else None


def _compass(found: Inference, state: Any) -> tuple[Floats, Floats]:
    return state.simulation.coefficients, found.estimate(state).covariance[:5, :5]


def _effects(found: Inference) -> Effects:
    state, candidates = found.state, found.posterior.candidates
    view, half = inference.viewed(state)
    kinds = tuple(kind for kind in state.case.terms if kind.instrument)
    drawn = evidence.drawn(replace(half, case=replace(half.case, terms=kinds)), [])
    listed = [group.columns for group in drawn.groups]
    shared = np.concatenate([np.zeros((len(state.case), 0)), *listed], axis=1)
    season, own, slow = seasons(view.case), _own(half), candidates.slow
    waves = np.zeros((len(state.case), 0)) if slow is None else slow.columns
    sigma = view.sigma * np.sqrt(candidates.scatter)
    every = np.concatenate([shared * drawn.usual, season, waves, own], axis=1, dtype=np.float32)
    white = view.projected(every) * np.float32(view.response / sigma)
    information = (white.T @ white).astype(float)
    score = (white.T @ (view.innovation / sigma).astype(np.float32)).astype(float)
    kept = shared.shape[1] + season.shape[1]
    weight = found.posterior.water_probability
    likely = [int(i) for i in np.argsort(-weight)[:MOST_WATERS] if weight[i] >= LEAST]
    beside = []
    unit = np.append(1.0 / np.maximum(drawn.usual, 1e-12), np.ones(season.shape[1]))
    for water in (found.posterior.waters[i] for i in likely):
        one = evidence.beside(information, score, kept, slow, water, free=own.shape[1])
        beforehand = one.log_likelihood + (0.0 if water is None else water.log_prior)
        beside.append(Products(one.information * np.outer(unit, unit), one.score * unit, beforehand))
    seen = view.visible(shared)
    uneven = {type(group.term): value for group, value in zip(candidates.groups, candidates.uneven, strict=True)}
    each = [np.full(columns.shape[1], uneven[kind]) for kind, columns in zip(kinds, listed, strict=True)]
    return Effects(
        forms=tuple(kind.__name__ for kind in kinds),
        parts=tuple(columns.shape[1] for columns in listed),
        usual=drawn.usual,
        uneven=np.concatenate([np.zeros(0), *each]),
        visible=seen.T @ seen / max(len(seen), 1),
        beside=tuple(beside),
        residual_deg=robust.width(state.residual_deg[np.isfinite(state.residual_deg)]),
        n=len(state.case),
    )


def _own(half: Any) -> Floats:
    """Return the columns of the terms that stand in the record and are its own."""
    slopes = np.nan_to_num(composition.derivative(half.simulation, half.case.scene, half.heading_deg, first=5))
    own = [np.full(len(term.fitted()), not term.instrument) for term in half.simulation.terms]
    return np.asarray(slopes[:, np.concatenate([np.zeros(0, dtype=bool), *own])])


def seasons(case: Case) -> Floats:
    """Return what a season of the water that recurs every year does, degrees for one degree of its size, (n, SEASONS).

    Harmonics of the year of a veer, and of an eastward and a northward shear; higher ones are as much smaller.
    """
    phase = 360.0 * case.scene.time_s / YEAR_S
    waves = np.column_stack([x / k for k in HARMONICS for x in angles.sin_cos(k * phase)])
    departures = case.scene.departures
    if "flow_east" not in departures or "speed" not in case.covariates:
        return np.concatenate([waves, np.zeros_like(waves)], axis=1)
    shear = noise.sheared(case, waves[:, : len(HARMONICS)], noise.SPEED_SPAN_S)
    return np.concatenate([waves, SHEAR_M_S_DEG * shear], axis=1)


def kind_of(form: str) -> type[Term]:
    """Return the class of an effect by its name."""
    return next(kind for kind in all_terms() if kind.__name__ == form)
