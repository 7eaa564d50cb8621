"""Sentences for an oceanographer on calibrations: where, what physics, how large, how sure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from compasslib.core.types import Floats
from compasslib.search import verdict, wording
from compasslib.search.show import HeldOut
from compasslib.search.verdict import Finding, Parameter, Unexplained, Where

WHERE = {
    "hard_iron": ("heading",), "soft_iron": ("heading",), "compass_lag": ("turn_rate",), "clock_offset": ("turn_rate",),
    "water_drift": ("heading",), "mounting_offset": ("heading",), "course_lag": ("turn_rate",),
} | wording.WHERE  # fmt: skip
unexplained = wording.unexplained
PHYSICS = {
    "hard_iron": "a magnetised part that turns with the instrument adds a constant field (hard iron)",
    "soft_iron": "a part that the earth's field magnetises distorts it (soft iron)",
    "mounting_offset": "the heading is turned by a constant from the magnetometer's axes",
    "water_drift": "the water carries the vessel sideways, so that its track over ground is not its heading",
    "tilt_uncompensated": "the recorded heading is compensated for tilt, the simulated one is not",
    "clock_offset": "the two clocks differ",
    "course_lag": "the course over ground lags: the receiver filters it, and a hull slides on in a turn",
}
SEPARATED_BY = {
    frozenset(pair): how
    for pair, how in {
        ("hard_iron", "tilt_uncompensated"): "logged tilts: a mean tilt in the vertical field looks like hard iron",
        ("soft_iron", "tilt_uncompensated"): "logged tilts: a tilt that goes with the heading stretches the circle",
        ("mounting_offset", "tilt_uncompensated"): "logged tilts",
        ("heading_slip", "tilt_uncompensated"): "logged tilts",
        ("mounting_offset", "declination_error"): "the declination that the instrument was set to",
        ("sextantal", "octantal"): "a swing of 16 to 24 headings all round",
        ("compass_lag", "clock_offset"): "tilts of both heads that change with time: they have no compass in them",
        ("heading_slip", "hard_iron_step"): "headings all round on both sides of the date",
        ("heading_slip", "compass_drift"): "the same headings read again, more often and in another order",
        ("water_drift", "sextantal"): "each heading at two speeds, or a log of the speed through the water",
        ("water_drift", "octantal"): "each heading at two speeds, or a log of the speed through the water",
        ("water_drift", "heading_slip"): "the first headings swung again at the end",
        ("water_drift", "compass_drift"): "the first headings swung again at the end",
        ("water_drift", "hard_iron_step"): "the first headings swung again, each at two speeds",
        ("water_drift", "hard_iron_drift"): "the first headings swung again, each at two speeds",
        ("course_lag", "clock_offset"): "headings and courses logged by one clock",
    }.items()
}


def along(effect: str, covariates: Mapping[str, Floats]) -> str:
    """Return the covariate along which an effect lives: of those known to go with it the one that varies most.

    Args:
        covariates: that there are, (n,) each.
    """
    known = [name for name in WHERE.get(effect, ("time", "reading")) if name in covariates]
    known = known or [name for name in ("time", "reading") if name in covariates] or list(covariates)
    return max(known, key=lambda name: float(np.std(covariates[name])))


def finding(
    effect: str,
    alternatives: Sequence[str],
    *,
    where: str,
    parameters: Mapping[str, tuple[float, float, str]],
    size_deg: float,
    proof: HeldOut,
    what: str,
) -> str:
    """Return two or three sentences on one finding.

    Args:
        parameters: value, standard error and unit by name.
        size_deg: visible size, rms degrees.
        proof: residual before and after on held-out stretches.
    """
    each = (
        (name, f"{v:.3g} ± {1.96 * s:.2g}", "" if unit == "1" else f" {unit}")
        for name, (v, s, unit) in parameters.items()
    )
    numbers = ", ".join(f"{name} {value}{unit} (95 %)" for name, value, unit in each)
    begin = f"{what[0].upper()}{what[1:]}, {where}: {_physics(effect)}. Size {size_deg:.2g}° rms; {numbers}."
    shown = (
        f" On held-out stretches the residual goes from {proof.rms_before_deg:.3g}° to "
        f"{proof.rms_after_deg:.3g}° rms (p = {proof.p_value:.2g})."
    )
    others = f" This recording cannot separate it from {wording.listed(alternatives)}." if alternatives else ""
    return begin + shown + others


def large(size_deg: float, proof: HeldOut, what: str) -> Finding:
    """Return the finding that the five-term series is too small a model.

    Args:
        size_deg: difference from the exact compass, rms degrees.
    """
    place = Where("heading", 0.0, 360.0, "along the recorded heading, all round")
    share = {"share": Parameter(1.0, 0.0, "of the exact compass")}
    text = finding("large_deviation", (), where=place.text, parameters={}, size_deg=size_deg, proof=proof, what=what)
    return Finding("large_deviation", "compass", (), place, None, share, size_deg, proof, text)


def place(covariate: str, low: float, high: float, clocked: bool) -> str:
    """Return the range of a covariate in words.

    Args:
        clocked: whether time is UTC.
    """
    if covariate == "time" and clocked:
        return f"from {verdict.stamp(low)} to {verdict.stamp(high)}"
    unit = wording.UNITS_OF_CALIBRATIONS.get(covariate, "")
    return f"along {covariate.replace('_', ' ')} from {low:.3g} to {high:.3g} {unit}".rstrip()


def separated_by(effect: str, alternatives: Sequence[str]) -> str:
    """Return what observation would separate effects.

    Args:
        effect: the effect that fits best.
    """
    phrases = {
        other: SEPARATED_BY.get(frozenset((effect, other))) or wording.separated_by(effect, [other]).split(": ", 1)[-1]
        for other in alternatives
    }
    return "; ".join(f"{effect} or {other}: {how}" for other, how in phrases.items())


def why(found: Sequence[Finding], left: Unexplained | None, compared: Sequence[str]) -> str:
    """Return what the verdict rests on, one sentence.

    Args:
        left: what has no name.
    """
    if left is not None:
        return left.text
    if not found:
        return f"The residual of {wording.listed(compared, ' and ')} is noise."
    return f"Found in the residual: {'; '.join(_physics(finding.effect) for finding in found)}."


def _physics(effect: str) -> str:
    return PHYSICS.get(effect) or wording.PHYSICS.get(effect, effect.replace("_", " "))
