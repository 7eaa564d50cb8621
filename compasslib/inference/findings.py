"""A finding made of a fitted term: where, when, how large, how sure, in numbers and in sentences."""

from __future__ import annotations

from collections.abc import Mapping

from compasslib.effects import COMPOSED, Term
from compasslib.effects.composed import Composed
from compasslib.inference import wording
from compasslib.inference.comparison import Comparison
from compasslib.inference.finding import Finding, Parameter, Where
from compasslib.inference.show import HeldOut


def of_term(
    comparison: Comparison,
    term: Term,
    chances: Mapping[str, float],
    parameters: Mapping[str, Parameter],
    *,
    size_deg: float,
    proof: HeldOut,
    place: Where,
    span_s: tuple[float, float] | None = None,
) -> Finding:
    """Return the finding of one term of the likeliest hypothesis.

    Args:
        chances: probability of the effect, which is first, and of what else may stand in its place.
        parameters: by name, for people.
        size_deg: visible size, rms.
        place: where it shows; of a term with a date, since then.
        span_s: when it acts, where that is not always.
    """
    probability, others = next(iter(chances.values())), dict(list(chances.items())[1:])
    effect, composition = _name(term)
    begin, end = span_s or comparison.span_s
    if term.dated():
        begin, place = term.date, comparison.since(term.date)
    physics = " changes ".join(wording.of_composed(*composition.values())) if composition else term.words
    text = wording.finding(
        term.name,
        tuple(others),
        where=place.text,
        parameters={name: (one.value, one.sigma, one.unit) for name, one in parameters.items()},
        size_deg=size_deg,
        proof=(proof.rms_before_deg, proof.rms_after_deg, proof.p_value),
        physics=f"{physics}, which no listed effect does" if composition else physics,
        what=comparison.what,
    )
    return Finding(
        effect=effect,
        side=term.side,
        alternatives=tuple(others),
        where=place,
        when_s=(begin, end) if comparison.clocked else None,
        parameters=parameters,
        rms_effect_deg=size_deg,
        held_out=proof,
        text=text,
        probability=probability,
        alternatives_probability=others,
        composition=composition,
    )


def large_deviation(size_deg: float, proof: HeldOut, *, what: str = "") -> Finding:
    """Return the finding that the five-term series is too small a model: the exact compass fits where it does not.

    Args:
        size_deg: difference of the two, rms.
        what: is compared, in words, where a recording may hold several comparisons.
    """
    effect, place = "large_deviation", Where("heading", 0.0, 360.0, "along the recorded heading")
    shown = (proof.rms_before_deg, proof.rms_after_deg, proof.p_value)
    text = wording.finding(effect, (), where=place.text, parameters={}, size_deg=size_deg, proof=shown, what=what)
    return Finding(effect, "compass", (), place, None, {"share": Parameter(1.0, 0.0, "1")}, size_deg, proof, text)


def _name(term: Term) -> tuple[str, dict[str, str] | None]:
    """Return the name of an effect, and what it is composed of where nobody listed it."""
    if not isinstance(term, Composed) or not term.name.startswith(COMPOSED):
        return term.name, None
    return "composed", dict(zip(("acts_on", "driver", "form"), term.said(), strict=True))
