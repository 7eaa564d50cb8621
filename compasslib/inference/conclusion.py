"""Diagnosis, correction and assessment of a mooring's record as a whole.

The search for unmodelled effects assumes that the record as a whole is valid. The checks here test this and keep
verdict, flags and uncertainty consistent: a constant that iron does not explain, periods that disagree with the other
pairs, a correction that held-out pairs contradict, and large corrections whose cause is not settled.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from compasslib import angles
from compasslib.deviation import find_implausibility
from compasslib.deviation.assessment import assess_correction
from compasslib.deviation.constant import ConstantOffset
from compasslib.deviation.doubts import (
    LEAST_DOUBT_DEG,
    Doubt,
    doubt_whole_record,
    evaluate_doubts,
    find_doubtful_windows,
)
from compasslib.deviation.model import DeviationFit
from compasslib.effects import CATALOGUE
from compasslib.effects.readout import MountingOffset
from compasslib.effects.reference import DeclinationError
from compasslib.inference import product as products
from compasslib.inference import wording
from compasslib.inference.comparison import Comparison, build_finding
from compasslib.inference.diagnosis import (
    SIDES,
    Diagnosis,
    insufficient,
    prepend_findings,
    product_of_diagnosis,
    spread_unexplained,
)
from compasslib.inference.finding import SURE, UNTESTED, CovariateRange, Parameter, Unexplained
from compasslib.inference.product import CorrectionModel, Series
from compasslib.records import EarthField, Pairs, Record

UNSETTLED = (
    "headings are flagged doubtful and the angle is included in their uncertainty until the configuration is "
    "corrected, or confirmed: {constant: true} states that the constant is real"
)
CORROBORATED_SIGMAS = 2.0  # normal score of a clock error that also explains a constant
MOST_OUTLIERS = 0.03  # outlier share that flags a record; of 19 valid moorings up to 0.006, of a refuted one 0.02


@dataclass(frozen=True)
class Conclusion:
    """Diagnosis of a mooring, its correction, and the assessment of the correction."""

    diagnosis: Diagnosis
    product: CorrectionModel
    assessment: dict[str, Any]


def diagnose_constant(constant: ConstantOffset, pairs: Pairs) -> Diagnosis:
    """Diagnose a mooring whose constant offset matches a configuration error; nothing else is attributed."""
    of_pairs, p = Comparison(time_s=pairs.time_s, terms=(), covariates={}), constant.probability
    term, other = sorted((DeclinationError(), MountingOffset()), key=lambda kind: kind.name != constant.effect)
    finding = build_finding(
        of_pairs,
        term,
        {term.name: p} | ({other.name: 1.0 - p} if p < SURE else {}),
        {"constant_deg": Parameter(constant.angle_deg, constant.sigma_deg, "°")},
        size_deg=abs(constant.angle_deg),
        proof=UNTESTED,
        place=CovariateRange("time", *of_pairs.span_s, "throughout the record"),
        physics=f"{constant.text}; {UNSETTLED}",
    )
    return Diagnosis(
        "ambiguous",
        findings=(finding,),
        separated_by="the configuration checked against the deployment's log, or the mount's angle measured",
        why=constant.text,
        sides=dict.fromkeys(SIDES, 0.0) | {"compass": p, "none": 1.0 - p},
        warnings=(f"{constant.text}; {UNSETTLED}",),
    )


def conclude(
    search: Callable[..., Diagnosis],
    pairs: Pairs,
    record: Record,
    field: EarthField,
    series: Series,
    *,
    fit: DeviationFit,
    find_constant: Callable[[DeviationFit], ConstantOffset | None],
    calibration: str = "",
    with_effects: Callable[[CorrectionModel, bool], CorrectionModel] = lambda made, searched: made,
) -> Conclusion:
    """Diagnose a mooring as a whole: search, constant offset, doubtful periods and agreement on held-out pairs.

    Args:
        search: searches pairs for unmodelled effects; ``clock_sigmas`` is the normal score that a clock error needs.
        series: other series that the instrument logged, at the record's samples.
        fit: the configured fit.
        find_constant: estimates the constant offset of a fit; gives None if there is none or it is confirmed.
        calibration: name of the calibration that corrects the mooring; empty if none does.
        with_effects: adds effects known from other records of the compass to a product; the second argument is whether
            the product comes from a search.
    """
    diagnosis, constant = _search_or_question(search, pairs, fit, find_constant)
    questioned = constant is not None and bool(constant.effect)
    made = with_effects(product_of_diagnosis(fit, diagnosis), diagnosis.fit is not None)
    plain = products.equivalent_pairs(made, pairs, record, field, series)
    doubts = find_doubtful_windows(plain, made.fit)
    agreement = assess_correction(pairs, made.fit, plain)
    refuted = agreement["refuted"] or (diagnosis.why if diagnosis.refutes_fit else "")
    denied = refuted or find_implausibility(made.fit, record) or find_implausibility(fit, record)
    if calibration and denied:
        denied = f"calibration {calibration}: {denied}"
    suspected = () if fit.known_beforehand else pairs.doubts  # errors of the pairs do not affect a given fit
    nothing_known = (why for sigma_deg, why in suspected if sigma_deg >= angles.UNIFORM_SIGMA_DEG)
    if why := next(nothing_known, denied):
        diagnosis = replace(insufficient(why, diagnosis.not_testable), warnings=diagnosis.warnings)
        doubts = (doubt_whole_record(angles.UNIFORM_SIGMA_DEG, why),)
    elif constant is not None and questioned:
        doubts = (doubt_whole_record(abs(constant.angle_deg), constant.text), *doubts)
    else:
        outliers = () if made.effects else _doubt_outliers(fit)  # corrected effects explain the outliers
        doubts = (*outliers, *(doubt_whole_record(sigma_deg, why) for sigma_deg, why in suspected), *doubts)
        mismatch = _doubt_mismatch(diagnosis)
        diagnosis = _with_doubts(diagnosis, doubts, pairs) if doubts else diagnosis
        doubts = (*doubts, *mismatch)
    made = replace(made, doubts=doubts)
    if diagnosis.verdict == "ambiguous" and not questioned:
        reasons = [
            wording.unsettled_reason(item.named, item.alternatives, item.level, item.probability)
            + ("; it is corrected all the same" if item.applied else "")
            for item in diagnosis.findings
            if not item.settled
        ]
        reasons += [
            f"the current, or a compass that follows the same, turns directions by {item.size_deg:.1f}° rms"
            for item in diagnosis.current
            if item.probability < SURE
        ]
        diagnosis = replace(diagnosis, why=f"{'; '.join(dict.fromkeys(reasons))}. {diagnosis.why}")
    said = [constant.text] if constant is not None and not questioned and constant.text else []
    said += [why for _, why in pairs.doubts if fit.known_beforehand]
    return Conclusion(replace(diagnosis, warnings=(*diagnosis.warnings, *said)), made, agreement)


def _search_or_question(
    search: Callable[..., Diagnosis],
    pairs: Pairs,
    fit: DeviationFit,
    find_constant: Callable[[DeviationFit], ConstantOffset | None],
) -> tuple[Diagnosis, ConstantOffset | None]:
    """Search a mooring, unless its constant offset matches a configuration error.

    In rotating (e.g. inertial) currents a clock error resembles a constant angle. A search that finds a clock error and
    whose fit then has no offset that matches a configuration error is therefore used; as speeds and directions then
    agree on it, speeds need not show it as clearly as alone.
    """
    constant = find_constant(fit)
    if constant is None:
        searched = search(pairs)  # its exact compass has a constant where a folded series has none
        remaining = None if searched.fit is None else find_constant(searched.fit)
        if remaining is None or not remaining.effect:
            return searched, remaining
        said = diagnose_constant(remaining, pairs)
        made = replace(prepend_findings(said.findings, searched), verdict=said.verdict, why=said.why)
        return replace(made, separated_by=said.separated_by, warnings=(*said.warnings, *searched.warnings)), remaining
    if not constant.effect:
        return search(pairs), constant
    if constant.between_instruments:
        searched = search(pairs, clock_sigmas=CORROBORATED_SIGMAS)
        if any(each.statement.side == "clock" and each.level for each in searched.findings):
            remaining = find_constant(product_of_diagnosis(fit, searched).fit)
            if remaining is None or not remaining.effect:
                return searched, remaining
    return diagnose_constant(constant, pairs), constant


def _doubt_mismatch(diagnosis: Diagnosis) -> tuple[Doubt, ...]:
    """Flag a record with a large mismatch that is unexplained, or whose attribution to the compass is not settled."""
    said = []
    if (left := diagnosis.unexplained) is not None and left.rms_effect_deg >= LEAST_DOUBT_DEG:
        # The uncertainty already includes the mismatch: only the flag is added, with a standard deviation of 0.
        said.append((0.0, f"a mismatch of {left.rms_effect_deg:.0f}° rms is unexplained and not corrected"))
    for item in diagnosis.findings if diagnosis.verdict == "ambiguous" else ():
        if item.applied and not item.settled and item.rms_effect_deg >= LEAST_DOUBT_DEG:
            size = f"a correction of {item.rms_effect_deg:.0f}° rms rests on a cause that is not settled"
            said.append((item.rms_effect_deg, size))
    return tuple(doubt_whole_record(size, f"{why}: all headings are flagged doubtful") for size, why in said)


def _doubt_outliers(fit: DeviationFit) -> tuple[Doubt, ...]:
    """Flag a record in which an unusual share of the directions fits no heading of the fitted compass."""
    share = fit.noise.outliers
    why = (
        f"{share:.0%} of the directions disagree with the fitted compass altogether (usually under 1 %): part of the "
        "headings, or of the reference, is of something else"
    )
    doubt = doubt_whole_record(angles.UNIFORM_SIGMA_DEG * float(np.sqrt(share)), why)
    return (doubt,) if fit.method == "exact" and share >= MOST_OUTLIERS else ()


def _with_doubts(diagnosis: Diagnosis, doubts: tuple[Doubt, ...], pairs: Pairs) -> Diagnosis:
    """Report periods that disagree with the other pairs as an unexplained mismatch."""
    warned = replace(diagnosis, warnings=(*(doubt.why for doubt in doubts), *diagnosis.warnings))
    steps = {kind.name for kind in CATALOGUE if kind.dated()}
    explained = any({item.effect, *item.alternatives} & steps for item in diagnosis.findings)
    if diagnosis.verdict == "insufficient" or explained:
        return warned
    worst = max(doubts, key=lambda doubt: doubt.sigma_deg)
    span = max(worst.from_s, float(pairs.time_s[0])), min(worst.to_s, float(pairs.time_s[-1]))
    inside, _ = evaluate_doubts(doubts, pairs.time_s)
    size = float(np.sqrt(np.mean(np.where(inside, worst.sigma_deg**2, 0.0))))
    text = f"{worst.why[0].upper()}{worst.why[1:]}. The headings there are flagged doubtful."
    place = "throughout the record" if np.isinf([worst.from_s, worst.to_s]).all() else worst.why.partition(" direc")[0]
    left = Unexplained(("time",), CovariateRange("time", *span, place), span, size, (), text)
    sides = spread_unexplained(diagnosis.sides, ())
    return replace(warned, verdict="unexplained", unexplained=left, why=text, sides=sides)
