"""Diagnosis of a recording: findings of all comparisons, and the verdict."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from compasslib.deviation.average import average_with_none
from compasslib.deviation.model import DeviationFit
from compasslib.inference import wording
from compasslib.inference.comparison import Comparison, Options
from compasslib.inference.finding import (
    LISTED_SHARE,
    SURE,
    UNTESTED,
    BinnedResidual,
    Detection,
    Finding,
    Unexplained,
    curve_json,
)
from compasslib.inference.joint_compass import RecordInformation
from compasslib.inference.noise import SEPARATED_BY, CurrentStatement
from compasslib.inference.product import CorrectionModel, WeightedCompass
from compasslib.types import Floats

SIDES = ("none", "compass", "clock", "reference", "water")
MOST_FACTOR = 1e12  # largest Bayes factor that is reported
UNEXPLAINED_FACTOR = 15.0  # Bayes factor of an established, unexplained mismatch against the side "none"
RIVALS = {  # sides that can cause a mismatch along these covariates as well as the compass can
    "water": ("speed", "depth", "separation", "time"),
    "reference": ("reference_heading",),
}


@dataclass(frozen=True)
class Diagnosis:
    """Result of comparing one recording with its simulation."""

    verdict: str  #: consistent | explained | ambiguous | unexplained | insufficient
    findings: tuple[Finding, ...] = ()  #: effects that were found, of compass, clock, reference or water
    unexplained: Unexplained | None = None  #: mismatch that no effect of the catalogue explains; None if there is none
    separated_by: str | None = None  #: observations that would distinguish the alternatives; None without alternatives
    not_testable: tuple[tuple[str, str], ...] = ()  #: (effect, reason why this record cannot show it)
    negligible: tuple[tuple[str, float], ...] = ()  #: (effect or covariate, visible size in degrees rms)
    why: str = ""  #: basis of the verdict, or the reason why there is none
    curves: tuple[BinnedResidual, ...] = ()  #: residuals without and with the effects, along the covariates concerned
    applied: tuple[WeightedCompass, ...] = ()  #: compasses whose average corrects the record, the selected one first
    fit: DeviationFit | None = None  #: exact compass on which the search was based; None if it must not be applied
    covariance: Floats | None = None  #: (5, 5) of A..E fitted without terms; the noise includes slow directional shear
    sides: Mapping[str, float] = field(default_factory=dict)  #: probability of each side; empty if not computed
    noise: Mapping[str, tuple[float, float]] = field(default_factory=dict)  #: (value, standard error) by parameter
    #: detection limit of each effect, visible size, degrees rms
    detectable_deg: Mapping[str, float | None] = field(default_factory=dict)
    detection: Detection | None = None  #: evidence of any effect, ranked among surrogates; None if not computed
    warnings: tuple[str, ...] = ()  #: sentences for the summary
    information: RecordInformation | None = None  #: what this record contributes to others of the same compass
    experiments: tuple[tuple[str, float], ...] = ()  #: (observation, probability that it leaves a single explanation)
    current: tuple[CurrentStatement, ...] = ()  #: statements on the current, which the simulation does not contain
    prior_odds: float | None = None  #: of a fault of compass or clock; None if the search does not use them
    refutes_fit: bool = False  #: whether a record with too little data contradicts its fit; all headings are flagged

    def __post_init__(self) -> None:
        """Remove from ``not_testable`` the effects of which at least one form was tested."""
        judged = {*self.detectable_deg, *(finding.effect for finding in self.findings)}
        untested = tuple(entry for entry in self.not_testable if entry[0] not in judged)
        object.__setattr__(self, "not_testable", untested)

    @property
    def bayes_factor(self) -> float | None:
        """Posterior odds over prior odds of a fault of compass or clock; None if not computed."""
        if self.prior_odds is None or not self.sides:
            return None
        fault = self.sides["compass"] + self.sides["clock"]
        return min(fault / max(1.0 - fault, 1e-300) / self.prior_odds, MOST_FACTOR)

    def to_json(self) -> dict[str, Any]:
        """Encode the diagnosis for diagnosis.json."""
        return {
            "verdict": self.verdict,
            "prior_odds": self.prior_odds,
            "bayes_factor": self.bayes_factor,
            "current": [stated.to_json() for stated in self.current],
            "findings": [finding.to_json() for finding in self.findings],
            "unexplained": None if self.unexplained is None else self.unexplained.to_json(),
            "separated_by": self.separated_by,
            "not_testable": [{"effect": effect, "why": why} for effect, why in self.not_testable],
            "negligible": [{"effect": effect, "rms_effect_deg": size} for effect, size in self.negligible],
            "why": self.why,
            "curves": [curve_json(curve) for curve in self.curves],
            **({"sides": dict(self.sides)} if self.sides else {}),
            "noise": {name: {"value": value, "sigma": sigma} for name, (value, sigma) in self.noise.items()},
            "experiments": [{"what": what, "probability": chance} for what, chance in self.experiments],
            "fit": None if self.fit is None else self.fit.to_json(),
            "detection": None if self.detection is None else self.detection.to_json(),
            "detectable_deg": dict(self.detectable_deg),
            "warnings": list(self.warnings),
        }

    def log_line(self, name: str) -> str:
        """Summarize the diagnosis for the log; findings and warnings on lines of their own."""
        texts = [*(finding.text for finding in self.findings), *(stated.text for stated in self.current)]
        texts += [self.unexplained.text] if self.unexplained else []
        texts += [self.why] if self.why else []
        texts += [f"warning: {warning}" for warning in self.warnings]
        return "\n".join([f"{name}: {self.verdict}", *(textwrap.indent(text, "  ") for text in texts)])


def insufficient(why: str, not_testable: tuple[tuple[str, str], ...] = ()) -> Diagnosis:
    """Build the diagnosis of a record with too little data."""
    return Diagnosis("insufficient", why=why, not_testable=not_testable)


def overall_verdict(
    findings: Sequence[Finding], unexplained: Unexplained | None, current: Sequence[CurrentStatement] = ()
) -> str:
    """Derive the verdict from the findings, an unexplained mismatch and the statements on the current."""
    if unexplained is not None:
        return "unexplained"
    contested = any(item.probability < SURE for item in current)
    if not findings:
        return "ambiguous" if contested else "explained" if current else "consistent"
    return "explained" if not contested and all(item.settled for item in findings) else "ambiguous"


@dataclass(frozen=True)
class Outcome:
    """Result of the search of one comparison, in the same form for long and short recordings."""

    comparison: Comparison
    sides: Callable[[Collection[str]], dict[str, float]]  # probability of each side; given effects are ignored
    findings: tuple[Finding, ...]  # of the most probable hypothesis, in the order of its terms
    chances: tuple[Mapping[str, float], ...]  # of the effect of each finding and of its alternatives
    left: Unexplained | None  # mismatch that the most probable hypothesis does not explain
    small: tuple[tuple[str, float], ...]  # (covariate, visible degrees rms) of remaining mismatches that are negligible
    curves: Callable[[Sequence[Finding], Unexplained | None], list[BinnedResidual]]  # of findings and mismatch
    noise: Mapping[str, tuple[float, float]]  # (value, standard error) by parameter
    current: tuple[CurrentStatement, ...] = ()
    current_probability: float = 0.0  # that the effect of the current exceeds ``min_effect_deg``
    detection: Detection | None = None  # evidence of any effect
    deniable: bool = False  # whether a finding is withdrawn if held-out readings refute it


def combine_outcomes(
    parts: Sequence[Outcome],
    options: Options,
    *,
    extra: Sequence[Finding] = (),
    not_testable: Sequence[tuple[str, str]] = (),
    separated_by: str = "",
) -> Diagnosis:
    """Combine the comparisons of a recording into its diagnosis.

    Args:
        extra: findings made outside a search.
        separated_by: observation that this kind of recording always lacks, reported with a finding on the compass side.
    """
    findings = [*extra, *(finding for part in parts for finding in part.findings)]
    denied = {id(item) for part in parts if part.deniable for item in part.findings if item.held_out.refuted}
    matter = [item for item in findings if item.rms_effect_deg >= options.min_effect_deg]
    stands = [item for item in matter if id(item) not in denied]
    merged = _merge_findings(
        [[item for item in group if item in stands] for group in (extra, *(part.findings for part in parts))]
    )
    unnamed = [part.left for part in parts if part.left is not None]
    for item in (item for item in matter if id(item) in denied):  # the mismatch remains, without an attribution
        text = wording.unexplained_text(item.where.text, item.rms_effect_deg, [])
        place = (item.where.covariate,), item.where, item.when_s, item.rms_effect_deg, ()
        unnamed.append(Unexplained(*place, text))
    left = max(unnamed, key=lambda item: item.rms_effect_deg, default=None)
    small = [(item.effect, item.rms_effect_deg) for item in findings if item.rms_effect_deg < options.min_effect_deg]
    small += [item for part in parts for item in part.small]
    by_part = []  # probability of each side; effects that are negligible or withdrawn count as none
    for part in parts:
        names = {True: set[str](), False: set[str]()}
        for item, chances in zip(part.findings, part.chances, strict=True):
            names[item in stands].update(chances)
        by_part.append(part.sides(names[False] - names[True]))
    sides = min(by_part, key=lambda item: item["none"], default={})
    for item in (item for item in extra if item in merged):
        sides = exclude_nothing(item.side, sides)
    if left is not None:
        sides = spread_unexplained(sides, left.covariates)
    if sides:  # move probability from none to water, by the probability that the current matters
        water = sides["none"] * max((part.current_probability for part in parts), default=0.0)
        sides = dict(sides) | {"none": sides["none"] - water, "water": sides["water"] + water}
    current = tuple(stated for part in parts for stated in part.current)
    phrases = [wording.separating_observations(f.named, f.alternatives) for f in merged if f.alternatives]
    phrases += [SEPARATED_BY] * any(item.probability < SURE for item in current)
    phrases += [separated_by] * bool(separated_by and any(item.side == "compass" for item in merged))
    compared = [part.comparison.what for part in parts] if not merged and left is None else []
    detected = [part.detection for part in parts if part.detection is not None]
    return Diagnosis(
        verdict=overall_verdict(merged, left, current),
        findings=merged,
        unexplained=left,
        separated_by="; ".join(dict.fromkeys(phrases)) or None,
        not_testable=tuple(not_testable),
        negligible=tuple({name: size for name, size in small if size > LISTED_SHARE * options.min_effect_deg}.items()),
        why=f"The residual of {wording.join_names(compared, ' and ')} is noise." if compared else "",
        curves=tuple(curve for part in parts for curve in part.curves(merged, left)),
        detection=min(detected, key=lambda item: (item.rank_p or 1.0, -item.statistic), default=None),
        sides=sides,
        noise=parts[0].noise if parts else {},
        current=current,
    )


def exclude_nothing(side: str, sides: Mapping[str, float]) -> dict[str, float]:
    """Condition the probabilities of the sides on an effect that certainly acts on one of them."""
    if not sides:
        return {}
    yielding = ("none", "water") if side == "clock" else ("none", "water", "clock", "reference")
    return {
        name: value + sum(sides[x] for x in yielding) if name == side else value * (name not in yielding)
        for name, value in sides.items()
    }


def spread_unexplained(sides: Mapping[str, float], covariates: Sequence[str]) -> dict[str, float]:
    """Move probability from none to the sides that can cause an established mismatch along its covariates."""
    if not sides:
        return {}
    moved = sides["none"] * (1.0 - 1.0 / UNEXPLAINED_FACTOR)
    rival = next((side for side, names in RIVALS.items() if set(covariates) & set(names)), "compass")
    result = dict(sides) | {"none": sides["none"] - moved}
    for side in ("compass", rival):
        result[side] += moved / 2.0
    return result


def prepend_findings(first: Sequence[Finding], diagnosis: Diagnosis) -> Diagnosis:
    """Add findings made before the search, and sort all by visible size, largest first."""
    if not first:
        return diagnosis
    findings = tuple(sorted((*first, *diagnosis.findings), key=lambda finding: -finding.rms_effect_deg))
    sides = exclude_nothing(first[0].side, diagnosis.sides)
    verdict = overall_verdict(findings, diagnosis.unexplained, diagnosis.current)
    return replace(diagnosis, findings=findings, verdict=verdict, sides=sides)


def _merge_findings(groups: Sequence[Sequence[Finding]]) -> tuple[Finding, ...]:
    """Merge the findings of several comparisons, one per effect, largest visible size first."""
    merged: list[Finding] = []
    for group in groups:
        again = {finding.effect: finding for finding in group}
        for k, finding in enumerate(merged):
            if (other := again.get(finding.effect)) is not None:
                stronger = max(finding, other, key=lambda x: x.rms_effect_deg)
                both = tuple(name for name in finding.alternatives if name in other.alternatives)
                text = f"{stronger.text} A second comparison shows it too."
                merged[k] = replace(stronger, alternatives=both, text=text)
        known = {finding.effect for finding in merged}
        merged += [finding for finding in group if finding.effect not in known]
    return tuple(sorted(merged, key=lambda finding: -finding.rms_effect_deg))


def product_of_diagnosis(fit: DeviationFit, diagnosis: Diagnosis) -> CorrectionModel:
    """Derive the correction of a record; without corrected effects the fit is averaged with one without deviation."""
    # Sum the visible sizes, rms degrees, of effects that may act on the compass and are not corrected.
    uncorrected = [
        finding for finding in diagnosis.findings if not finding.applied and finding.held_out is not UNTESTED
    ]
    if diagnosis.applied:  # the average of hypotheses covers a compass effect that is only an alternative
        uncorrected = [finding for finding in uncorrected if finding.side == "compass"]
    sizes = [finding.rms_effect_deg for finding in uncorrected if finding.of_compass]
    sizes += [] if diagnosis.unexplained is None else [diagnosis.unexplained.rms_effect_deg]
    left_deg = float(np.hypot.reduce(sizes)) if sizes else 0.0
    fit, no_deviation = replace(diagnosis.fit or fit, iron_declared=fit.iron_declared), None
    if all(member.compass is None for member in diagnosis.applied[:1]):  # the chosen one
        fit, no_deviation = average_with_none(fit)
    if diagnosis.fit is None:
        return CorrectionModel(fit, left_deg=left_deg, no_deviation=no_deviation)
    effects = tuple(finding.effect for finding in diagnosis.findings if finding.applied)
    accounted = tuple(finding.effect for finding in diagnosis.findings if not finding.of_compass)
    return CorrectionModel(fit, effects, diagnosis.applied, accounted, left_deg, no_deviation=no_deviation)
