"""Infer the iron of one compass from several records, its variation between deployments, and inconsistent records.

B and C of a deployment are (P + p)/H + c tan I and (Q + q)/H + f tan I; D and E are the instrument's. P, Q are hard
iron, c, f are induced by the vertical field (physics page, section 3). p and q, of sphere and battery, are normal with
two unknown standard deviations, which are marginalized over a grid (a linear mixed model; Searle, Casella and
McCulloch, Variance Components, 1992). A is specific to each record: mount, clamp, mean veer of the water.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from compasslib import angles
from compasslib.deviation.model import LETTERS, CoefficientPrior, FieldAtPlace, iron_design
from compasslib.effects import Effect, all_effects
from compasslib.types import Floats

IRON_NAMES = ("P_nT", "Q_nT", "c", "f", "D", "E")
SHARED_COEFFICIENTS = np.arange(1, 5)  # B, C, D, E of A..E
PRIOR_SIGMA = np.array([6000.0, 6000.0, 0.05, 0.05, 0.1, 0.1])  # of IRON_NAMES, prior standard deviations
SIZES_NT = (10.0, 30.0, 60.0, 120.0, 240.0, 480.0, 960.0, 2000.0)  # standard deviations of p, q
SIZE_PAIRS_NT = np.array(list(itertools.product(SIZES_NT, SIZES_NT)))  # of sphere and battery
BETWEEN_PRIOR_NT = 150.0  # scale of the half-Cauchy prior of either size, sphere and battery
SOFT_SIGMA = 0.002  # standard deviation of D and E between deployments: induction in batteries and spheres
CLAMP_DEG = 2.0  # least standard deviation of A between records, for a record without a reference
STRANGER_SIGMAS = (2.0, 4.0, 8.0)  # distances of another compass in standard deviations, equally likely
LEAST_SAME = 0.5  # probability of the same compass below which a record is excluded


@dataclass(frozen=True)
class Member:
    """One deployment or calibration; its coefficients are empty where its own data do not determine them."""

    name: str
    kind: str  # mooring, or the kind of a calibration
    sphere: str | None
    horizontal_nT: float
    vertical_nT: float
    coefficients: Floats  # (5,) A..E of the exact compass there
    covariance: Floats  # (5, 5)
    effects: EffectInformation | None = None
    why: str = ""  # why it has no coefficients; empty if it has

    @property
    def tells(self) -> bool:
        """Whether its own data determine the coefficients."""
        return bool(self.coefficients.size)

    def to_json(self) -> dict[str, Any]:
        """Encode the record as ``mooring_member`` reads it."""
        effects = None if self.effects is None else {k: np.asarray(x).tolist() for k, x in vars(self.effects).items()}
        arrays = {"coefficients": self.coefficients.tolist(), "covariance": self.covariance.tolist()}
        return {**vars(self), **arrays, "effects": effects}


def mooring_member(content: Mapping[str, Any], sphere: str | None) -> Member:
    """Read a mooring's record from its summary, see ``Member.to_json``."""
    arrays = {name: np.array(content[name]) for name in ("coefficients", "covariance")}
    effects = content["effects"]
    if effects is not None:
        plain = {"forms": tuple(effects["forms"]), "residual_deg": effects["residual_deg"], "n": effects["n"]}
        effects = EffectInformation(**{name: np.array(value) for name, value in effects.items()} | plain)
    return Member(**{**content, **arrays, "effects": effects, "sphere": sphere})


def calibration_member(content: Mapping[str, Any], sphere: str | None) -> Member:
    """Read a calibration from its calibration.json; no coefficients where its headings do not determine them."""
    field, exact = content["place"]["field"] or {}, content["exact"]
    h, z = (field.get(name, np.nan) for name in ("horizontal_nT", "vertical_nT"))
    covariance = np.array([[np.nan]]) if exact is None else np.array(exact["covariance"], dtype=float)
    coefficients, why = np.zeros(0), content["why"] or "its headings, or its place, do not determine the exact compass"
    if field and np.isfinite(covariance).all():
        coefficients, why = np.array([exact["coefficients"][k] for k in LETTERS]), ""
    return Member(content["name"], content["kind"], sphere, h, z, coefficients, covariance, why=why)


@dataclass(frozen=True)
class EffectInformation:
    """Information of one record on instrument effects; p columns of their parameters, then s of the season.

    In the units of the parameters, with slow noise and the effects of the record alone marginalized.
    """

    forms: tuple[str, ...]  #: class name of each effect
    usual: Floats  #: (p,) prior standard deviation of each parameter, at an amplitude of one
    visible: Floats  #: (p, p) mean products of the visible columns, square degrees
    information: Floats  #: (p + s, p + s)
    score: Floats  #: (p + s,)
    residual_deg: float  #: robust standard deviation, degrees
    n: int  #: number of pairs


@dataclass(frozen=True)
class RecordInformation:
    """Information of one record on its compass."""

    coefficients: Floats  #: (5,) A..E of the exact compass, dimensionless
    covariance: Floats  #: (5, 5)
    effects: EffectInformation | None  #: None without a search


def effect_class(form: str) -> type[Effect]:
    """Look up the class of an effect by its name."""
    return next(kind for kind in all_effects() if kind.__name__ == form)


@dataclass(frozen=True)
class RejectedRecord:
    """A record that is inconsistent with the others."""

    name: str
    probability_same: float
    sigmas: float  # standard deviations from the prediction of the others
    why: str


@dataclass(frozen=True)
class Mixture:
    """Mixture of normal distributions, one for each pair of sizes between deployments; weights sum to 1."""

    weight: Floats  # (t,)
    means: Floats  # (t, k)
    covariances: Floats  # (t, k, k)

    @property
    def mean(self) -> Floats:
        """The mean, (k,)."""
        return np.asarray(self.weight @ self.means)

    @property
    def covariance(self) -> Floats:
        """The covariance, (k, k)."""
        off = self.means - self.mean
        inner = np.einsum("t,tij->ij", self.weight, self.covariances)
        return np.asarray(inner + (self.weight[:, None] * off).T @ off)


@dataclass(frozen=True)
class JointCompass:
    """Joint inference from the records of one compass."""

    members: tuple[Member, ...]
    consistent: tuple[str, ...]  # names of mutually consistent records, in order
    rejected: tuple[RejectedRecord, ...]
    same: dict[str, float]  # probability of the same compass, by record; empty without a second record

    @cached_property
    def shared(self) -> Mixture:
        """Posterior of the iron, in the order of IRON_NAMES."""
        return _infer(self._those(self.consistent), np.eye(len(IRON_NAMES)), self._those(self.consistent))

    def others(self, name: str) -> tuple[str, ...]:
        """List the other records that inform a record; none if it was rejected."""
        if any(record.name == name for record in self.rejected):
            return ()
        return tuple(other for other in self.consistent if other != name)

    def prior(self, name: str) -> CoefficientPrior | None:
        """Compute the prior of a record's A..E from the other records; None if there are none."""
        (this_member,), others = self._those([name]), self._those(self.others(name))
        if not others:
            return None
        law = predict_compass(this_member, others)
        mean, precision = np.append(0.0, law.mean), np.zeros((5, 5))
        precision[1:, 1:] = np.linalg.inv(law.covariance)
        if not this_member.tells:
            # A record that does not determine its own A takes it from the others.
            values = np.array([member.coefficients[0] for member in others])
            variances = np.array([member.covariance[0, 0] for member in others])
            least = (CLAMP_DEG * angles.DEGREE) ** 2
            spread = max(float(np.var(values, ddof=1)) if len(values) > 1 else 0.0, least)
            weight = 1.0 / (variances + spread)
            mean[0], precision[0, 0] = float(weight @ values / weight.sum()), float(1.0 / (spread + 1.0 / weight.sum()))
        return CoefficientPrior(mean, precision)

    def _those(self, names: Sequence[str]) -> list[Member]:
        return [member for member in self.members if member.name in names]


def join_records(members: Sequence[Member]) -> JointCompass:
    """Join records, rejecting those inconsistent with the others one by one, the worst first."""
    siblings, rejected = [member for member in members if member.tells], list[RejectedRecord]()
    same: dict[str, float] = {}
    while len(siblings) > 1:
        tested = {
            record.name: probability_same(record, [other for other in siblings if other is not record])
            for record in siblings
        }
        same.update({name: probability for name, (probability, _) in tested.items()})
        worst = min(tested, key=lambda name: tested[name][0])
        if tested[worst][0] >= LEAST_SAME:
            break
        wrong = [worst] if len(siblings) > 2 else list(tested)  # of two, neither can be singled out
        for name in wrong:
            against = ", ".join(other for other in tested if other != name)
            why = (
                f"B to E are {tested[name][1]:.1f} standard deviations from what {against} tell of this compass, iron "
                "that varies between deployments counted: another compass, or iron that changed; it is not averaged"
            )
            rejected.append(RejectedRecord(name, *tested[name], why))
        siblings = [record for record in siblings if record.name not in wrong]
    return JointCompass(tuple(members), tuple(record.name for record in siblings), tuple(rejected), same)


def probability_same(member: Member, others: Sequence[Member]) -> tuple[float, float]:
    """Compute the probability that a record is of the same compass as others, and its distance in sigmas.

    Another compass is modelled as some standard deviations away in any direction: for records precise enough to be
    distinguished, this matters more than the distribution of compasses.
    """
    law, known = predict_compass(member, others), member.covariance[SHARED_COEFFICIENTS][:, SHARED_COEFFICIENTS]
    off, spread = member.coefficients[SHARED_COEFFICIENTS] - law.means, law.covariances + known
    each = zip(np.log(law.weight), off, spread, strict=True)
    logs = np.array([[w + _log_normal(x, s * (1.0 + far**2)) for far in (0.0, *STRANGER_SIGMAS)] for w, x, s in each])
    same, other = np.logaddexp.reduce(logs[:, 0]), np.logaddexp.reduce(logs[:, 1:], axis=None)
    odds = same - other + np.log(len(STRANGER_SIGMAS))  # even beforehand
    away = member.coefficients[SHARED_COEFFICIENTS] - law.mean
    sigmas = float(np.sqrt(away @ np.linalg.solve(law.covariance + known, away)))
    return float(1.0 / (1.0 + np.exp(-np.clip(odds, -700.0, 700.0)))), sigmas


def predict_compass(member: Member, others: Sequence[Member]) -> Mixture:
    """Predict B..E of one record from others, including the variation between deployments."""
    return _infer(others, _design(member), [*others, member])


def _infer(observed: Sequence[Member], target: Floats, varying: Sequence[Member]) -> Mixture:
    """Infer linear combinations of the iron, (k, 6), from B..E of some records, which vary between deployments."""
    values = np.concatenate([member.coefficients[SHARED_COEFFICIENTS] for member in observed])
    noise = block_diag(*(member.covariance[SHARED_COEFFICIENTS][:, SHARED_COEFFICIENTS] for member in observed))
    design = np.concatenate([*(_design(member) for member in observed), target])
    fixed, n = (design * PRIOR_SIGMA**2) @ design.T, len(values)
    means, covariances, logs = [], [], []
    for sizes in SIZE_PAIRS_NT:
        whole, between = fixed.copy(), _between(varying, sizes)
        whole[: len(between), : len(between)] += between
        inner, cross = whole[:n, :n] + noise, whole[n:, :n]
        gain = np.linalg.solve(inner, cross.T).T
        means.append(gain @ values)
        covariances.append(whole[n:, n:] - gain @ cross.T)
        relative = sizes / BETWEEN_PRIOR_NT  # half-Cauchy, on a grid of logarithms
        logs.append(_log_normal(values, inner) + float(np.sum(np.log(relative) - np.log1p(relative**2))))
    return Mixture(np.exp(logs - np.logaddexp.reduce(logs)), np.array(means), np.array(covariances))


def _design(member: Member) -> Floats:
    """Build the derivative of B, C, D, E by IRON_NAMES at one place, (4, 6)."""
    return iron_design(FieldAtPlace(member.horizontal_nT, member.vertical_nT))[1:, 1:]


def _between(members: Sequence[Member], sizes: Floats) -> Floats:
    """Build the covariance of B..E between deployments, (4 m, 4 m); deployments of one sphere share its iron."""
    level = np.array([1.0 / member.horizontal_nT for member in members])
    alike = np.array(
        [[a is b or (a.sphere is not None and a.sphere == b.sphere) for b in members] for a in members], dtype=float
    )
    iron = (sizes[0] ** 2 * alike + sizes[1] ** 2 * np.eye(len(members))) * np.outer(level, level)
    soft = SOFT_SIGMA**2 * np.eye(len(members))
    return np.kron(iron, np.diag([1.0, 1.0, 0.0, 0.0])) + np.kron(soft, np.diag([0.0, 0.0, 1.0, 1.0]))


def _log_normal(off: Floats, covariance: Floats) -> float:
    sign_log = np.linalg.slogdet(2.0 * np.pi * covariance)[1]
    return float(-0.5 * (off @ np.linalg.solve(covariance, off) + sign_log))
