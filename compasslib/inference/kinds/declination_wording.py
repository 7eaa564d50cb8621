"""Sentences on an observatory's declination."""

from __future__ import annotations

from collections.abc import Sequence

from compasslib.inference import wording
from compasslib.inference.finding import Finding, Parameter
from compasslib.inference.show import HeldOut
from compasslib.observatory import FieldComparison, Storm
from compasslib.records import stamp

SEPARATED_BY = {
    "compass_drift": "absolute measurements of the declination at the station, or its definitive data",
    "field_disturbance": "a day more of the series: a storm's level does not stay",
    "hard_iron": "a survey of the field around the station",
    "mounting_offset": "the azimuth mark measured again",
    "heading_slip": "more of the series around the date, or the observatory's log",
    "secular_variation": "more years, or a second observatory near by",
}


def separated_by(findings: Sequence[Finding]) -> str | None:
    """Return what would tell the alternatives apart, or None where nothing is open."""
    pairs = [(one.effect, other) for one in findings for other in one.alternatives]
    texts = [f"{a} or {b}: {SEPARATED_BY.get(b, 'a second observatory near by')}" for a, b in pairs]
    return "; ".join(dict.fromkeys(texts)) or None


def why(compared: FieldComparison, source: str, findings: Sequence[Finding]) -> str:
    """Return what the verdict rests on."""
    model = "IGRF" if source == "IGRF" else "the given declination"
    begin = (
        f"{len(compared.time_s)} means over {compared.days} days against {model} plus "
        f"{compared.constant_deg:+.3f} ± {1.96 * compared.constant_sigma_deg:.3f} degrees (95 %)"
    )
    quiet = f", quiet day from {compared.quiet_days} days" if compared.quiet_days else ", no quiet day known"
    agree = "" if findings else "; the residual is negligible"
    return begin + quiet + agree


def storm(found: Storm, compared: FieldComparison, proof: HeldOut, more: int) -> str:
    """Return the sentences on one storm.

    Args:
        more: smaller storms that have no finding of their own.
    """
    quiet = "" if compared.quiet_days else " No quiet day is known: daily variation is part of it."
    others = f" {more} smaller storms are not listed." if more else ""
    return (
        f"From {stamp(found.begin_s)} to {stamp(found.end_s)} a disturbance of the earth's field moves "
        f"magnetic north by {found.rms_deg:.2f}° rms in its disturbed hours, {found.worst_deg:.2f}° in its worst "
        f"three; highest minus lowest declination is {found.range_deg:.1f}°.{quiet} The model of it is the "
        f"recorded course itself: on held-out stretches the residual goes from {proof.rms_before_deg:.2f}° to "
        f"{proof.rms_after_deg:.2f}° rms (p = {proof.p_value:.3g}); it predicts no other day or place.{others}"
    )


def daily(amplitude_deg: float, size_deg: float, days: int) -> str:
    """Return the sentences on a daily variation that matters.

    Args:
        amplitude_deg: half of its range.
        days: quiet days that it comes from.
    """
    return (
        f"Every day magnetic north swings by {amplitude_deg:.2f}° to either side, {size_deg:.2f}° rms: "
        f"the daily variation, by the median of {days} quiet days."
    )


def constant(compared: FieldComparison, most_deg: float, source: str, alternatives: Sequence[str]) -> str:
    """Return the sentences on a constant that rocks do not make.

    Args:
        most_deg: largest plausible constant of rocks.
    """
    model = "IGRF" if source == "IGRF" else "the given declination"
    begin = (
        f"The declination differs from {model} by {compared.constant_deg:+.2f} ± "
        f"{1.96 * compared.constant_sigma_deg:.2f} degrees (95 %) at all times; "
        f"rocks make up to {most_deg:.1f}."
    )
    if not alternatives:
        return f"{begin} IGRF agrees with the recording: the given number is wrong."
    return f"{begin} A wrong declination or place, strong rocks and a turned azimuth mark look the same here."


def jump(found: tuple[float, float], sigma_deg: float, proof: HeldOut, alternatives: Sequence[str]) -> str:
    """Return the sentences on a jump of the baseline.

    Args:
        found: date, and degrees that the declination rises by.
        proof: on days left out.
    """
    others = f" This record cannot separate it from {wording.listed(alternatives)}." if alternatives else ""
    return (
        f"From {stamp(found[0])} on the declination is {found[1]:+.2f} ± {1.96 * sigma_deg:.2f} degrees (95 %) "
        f"off what it was: the baseline jumped, as where a sensor turned. The residual goes from "
        f"{proof.rms_before_deg:.2f}° to {proof.rms_after_deg:.2f}° rms (p = {proof.p_value:.3g}).{others}"
    )


def trend(slope: Parameter, one: Finding, model_slope: float | None, alternatives: Sequence[str]) -> str:
    """Return the sentences on a trend.

    Args:
        slope: degrees a year.
        model_slope: IGRF's own where the trend is that, degrees a year.
    """
    as_model = "" if model_slope is None else f" IGRF has {model_slope:+.3f} there: the given declination is constant."
    others = f" This record cannot separate it from {wording.listed(alternatives)}." if alternatives else ""
    return (
        f"The declination moves by {slope.value:+.3f} ± {1.96 * slope.sigma:.3f} degrees a year (95 %) beyond the "
        f"simulation, {one.rms_effect_deg:.2f}° rms over the record.{as_model} On held-out days the "
        f"residual goes from {one.held_out.rms_before_deg:.2f}° to {one.held_out.rms_after_deg:.2f}° rms "
        f"(p = {one.held_out.p_value:.3g}).{others}"
    )


def restless(size_deg: float) -> str:
    """Return the sentence on a series that is disturbed at all times.

    Args:
        size_deg: its middle rms over three hours.
    """
    return (
        f"The declination is restless at all times, by {size_deg:.2f}° rms over three hours in the middle of "
        "the record: the ordinary weather of a station in the auroral zone, or noise of the recording. No storm stands "
        "out."
    )
