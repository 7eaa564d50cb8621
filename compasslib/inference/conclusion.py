"""What a mooring's diagnosis, its product and the agreement with the reference come to together.

A search names what bends the compass where the record as a whole is sound. Whether it is sound is judged here, so that
verdict, flags and uncertainty agree: a constant that a mistake in the configuration explains, stretches that disagree
with the rest, and a correction that held-out pairs deny.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from compasslib import deviation
from compasslib.calibrations import at_mooring
from compasslib.deviation import assessment, windows
from compasslib.deviation.constant import Constant
from compasslib.deviation.doubts import KNOWS_NOTHING_DEG, Doubt, along_time, whole_record
from compasslib.deviation.model import Fit
from compasslib.inference import product, verdict
from compasslib.inference.finding import Finding, Parameter, Unexplained, Where
from compasslib.inference.product import Product, Series
from compasslib.inference.show import UNTESTED
from compasslib.inference.verdict import Diagnosis
from compasslib.records import EarthField, Pairs, Record

UNSETTLED = (
    "headings are flagged doubtful and the angle is included in their uncertainty until the configuration is "
    "corrected, or confirmed: {constant: true} states that the constant is real"
)
SURE = 0.95  # probability above which no other name is listed
MOST_OUTLIERS = 0.03  # share of directions that say nothing; of 19 sound moorings up to 0.006, of a refuted one 0.02
SIDES = ("none", "compass", "clock", "reference", "water")


@dataclass(frozen=True)
class Conclusion:
    """What is said of a mooring, and what corrects it."""

    diagnosis: Diagnosis
    product: Product
    assessment: dict[str, Any]


def of_constant(constant: Constant, pairs: Pairs) -> Diagnosis:
    """Return the diagnosis of a mooring whose constant a mistake in the configuration explains.

    Nothing else is attributed until the constant is settled.
    """
    span = (float(pairs.time_s[0]), float(pairs.time_s[-1]))
    p = constant.probability
    others = {"mounting_offset": 1.0 - p} if p < SURE else {}
    finding = Finding(
        effect=constant.effect,
        side="compass",
        alternatives=tuple(others),
        where=Where("time", *span, "throughout the record"),
        when_s=span,
        parameters={"constant_deg": Parameter(constant.angle_deg, constant.sigma_deg, "°")},
        rms_effect_deg=abs(constant.angle_deg),
        held_out=UNTESTED,
        text=f"{constant.text[0].upper()}{constant.text[1:]}. {UNSETTLED[0].upper()}{UNSETTLED[1:]}.",
        probability=p,
        alternatives_probability=others,
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
    search: Callable[[Pairs], Diagnosis],
    pairs: Pairs,
    record: Record,
    field: EarthField,
    series: Series,
    *,
    fit: Fit,
    constant: Constant | None,
    calibration: str = "",
    with_effects: Callable[[Product, bool], Product] = lambda made, searched: made,
) -> Conclusion:
    """Judge a mooring as a whole.

    Args:
        search: the search for unmodelled effects, of pairs.
        series: what was logged besides at the record's samples.
        fit: the configured fit.
        constant: between the instruments, where it is not confirmed.
        calibration: name of the calibration that corrects the mooring, if one does.
        with_effects: puts effects that other records of the compass know into a product, given whether it comes from
            a search.
    """
    questioned = constant is not None and bool(constant.effect)
    found = of_constant(constant, pairs) if constant is not None and questioned else search(pairs)
    made = with_effects(product.of(fit, found), found.fit is not None)
    plain = product.plain(made, pairs, record, field, series)
    doubts = windows.doubtful(plain, made.fit)
    agreement = assessment.assess(pairs, made.fit, plain)
    denied = agreement["refuted"] or deviation.implausible(made.fit, record)
    if why := denied or (at_mooring.contradicted(fit, pairs) if calibration else ""):
        why = f"calibration {calibration}: {why}" if calibration else why
        found = replace(verdict.insufficient(why, found.not_testable), warnings=found.warnings)
        made = replace(made, doubts=(whole_record(KNOWS_NOTHING_DEG, why),))
    elif constant is not None and questioned:
        made = replace(made, doubts=(whole_record(abs(constant.angle_deg), constant.text), *doubts))
    elif doubts := (*(() if made.effects else _outliers(fit)), *doubts):  # effects that are corrected explain outliers
        found = _unexplained(found, doubts, pairs)
        made = replace(made, doubts=doubts)
    if constant is not None and not questioned and constant.text:
        found = replace(found, warnings=(*found.warnings, constant.text))
    return Conclusion(found, made, agreement)


def _outliers(fit: Fit) -> tuple[Doubt, ...]:
    """Doubt a record of which more directions than usual agree with no heading of the fitted compass."""
    share = fit.noise.outliers
    if fit.method != "exact" or share < MOST_OUTLIERS:
        return ()
    why = (
        f"{share:.0%} of the directions disagree with the fitted compass altogether (usually under 1 %): part of the "
        "headings, or of the reference, is of something else"
    )
    return (whole_record(KNOWS_NOTHING_DEG * float(np.sqrt(share)), why),)


def _unexplained(found: Diagnosis, doubts: tuple[Doubt, ...], pairs: Pairs) -> Diagnosis:
    """Return the diagnosis with the stretches that disagree with the rest as what it does not explain."""
    worst = max(doubts, key=lambda doubt: doubt.sigma_deg)
    first, last = float(pairs.time_s[0]), float(pairs.time_s[-1])
    span = (max(worst.from_s, first), min(worst.to_s, last))
    inside, _ = along_time(doubts, pairs.time_s)
    size = float(np.sqrt(np.mean(np.where(inside, worst.sigma_deg**2, 0.0))))
    text = f"{worst.why[0].upper()}{worst.why[1:]}. The headings there are flagged doubtful."
    place = "throughout the record" if np.isinf([worst.from_s, worst.to_s]).all() else worst.why.partition(" direc")[0]
    left = Unexplained(("time",), Where("time", *span, place), span, size, (), text)
    warnings = tuple(doubt.why for doubt in doubts)
    if found.verdict == "insufficient":
        return replace(found, warnings=(*warnings, *found.warnings))
    return replace(found, verdict="unexplained", unexplained=left, why=text, warnings=(*warnings, *found.warnings))
