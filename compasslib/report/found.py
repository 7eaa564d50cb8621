"""A diagnosis.json in words, for moorings and calibrations alike."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from compasslib.effects import COMPOSED, meanings
from compasslib.effects.composed import formula
from compasslib.inference import wording
from compasslib.report import words
from compasslib.report.section import ReportedFinding, ReportTable

SIDES = {
    "compass": "the compass",
    "reference": "the reference",
    "water": "the water",
    "clock": "the clocks",
}
LEAST_P = 0.001  # the smallest that the drawn blocks can show
CLAUSES = {
    **wording.PHYSICS,
    "hard_iron": "iron near by adds a constant field",
    "mounting_offset": "the mount turns all headings by a constant",
    "field_disturbance": "magnetic north moved with storms or the daily variation",  # shown by a series, or an index
}


def findings(diagnosis: Mapping[str, Any], *, product: bool) -> tuple[ReportedFinding, ...]:
    """Return what was found, strongest first, and what stays unexplained after it.

    Args:
        diagnosis: content of diagnosis.json.
        product: whether there is a corrected record that a finding may have entered.
    """
    texts = [_finding(one, product) for one in diagnosis["findings"]]
    left = diagnosis["unexplained"]
    return (*texts, _unexplained(left)) if left else tuple(texts)


def named(finding: Mapping[str, Any]) -> list[str]:
    """Return what may fill a finding's place, the best first: physics, and in brackets its name and probability."""
    chances = {finding["effect"]: finding.get("probability"), **(finding.get("alternatives_probability") or {})}
    if composed := finding.get("composition"):
        chances = {f"{COMPOSED}{'/'.join(composed.values())}": chances.pop(finding["effect"]), **chances}
    return [_named(name, chances.get(name)) for name in dict.fromkeys([*chances, *finding["alternatives"]])]


def _named(name: str, chance: float | None) -> str:
    sure = [] if chance is None else [f"probability {words.chance(chance)}"]
    if name.startswith(COMPOSED):
        return " ".join([words.plain(name), *(f"({each})" for each in sure)])
    clause = re.split(r" \(|[;:]", CLAUSES.get(name, words.plain(name)))[0]
    return f"{clause} ({', '.join([words.plain(name), *sure])})"


def cannot_tell(diagnosis: Mapping[str, Any]) -> tuple[str, ...]:
    """Return sentences on what the recording does not tell.

    Args:
        diagnosis: content of diagnosis.json.
    """
    decide = [part for part in (diagnosis["separated_by"] or "").split("; ") if part]
    texts = [f"What would decide: {words.sentence(words.plain(part))}" for part in decide]
    chances = [f"{one['what']}: {words.percent(one['probability'])}" for one in diagnosis.get("experiments") or []]
    texts += [f"Probability that a further observation leaves one effect: {words.listed(chances)}."] if chances else []
    texts += [words.sentence(diagnosis.get("why", ""))] * (diagnosis["verdict"] != "insufficient")
    texts += _slow_water(diagnosis.get("noise") or {})
    texts += _not_testable(diagnosis)
    small = [_small(one) for one in diagnosis.get("negligible", [])]
    texts += [f"Negligible: {words.listed(small)}."] if small else []
    return tuple(filter(None, texts))


def _slow_water(noise: Mapping[str, Mapping[str, float]]) -> list[str]:
    """Return a sentence on what slow water is taken to do, none where none was looked for."""
    if "slow_rms_deg" not in noise:
        return []
    veer, days, shear = (noise[name] for name in ("slow_rms_deg", "slow_memory_days", "slow_shear_m_s"))
    return [
        "Slow changes of the water between the two depths: directional shear "
        f"{words.with_sigma(veer['value'], veer['sigma'], '°')} rms with a memory of {words.number(days['value'], 0)} "
        f"days, velocity shear {words.number(100.0 * shear['value'])} cm/s. Compass errors that change as slowly and "
        "as little cannot be separated from them; both are included in the uncertainty."
    ]


def _not_testable(diagnosis: Mapping[str, Any]) -> list[str]:
    """Return a sentence for each reason; an effect of several forms may have been tried in one and not in another."""
    reasons: dict[str, dict[str, None]] = {}
    for one in diagnosis["not_testable"]:
        reasons.setdefault(one["effect"], {})[words.sentence(one["why"])] = None
    tried = {one["effect"] for one in diagnosis.get("hypotheses") or []}
    closed: dict[tuple[bool, str], list[str]] = {}
    for effect, whys in reasons.items():
        closed.setdefault((effect in tried, " ".join(whys)), []).append(words.plain(effect))
    return [
        f"{'Testable only in part' if partly else 'Not testable'}: {words.listed(effects)}. {why}"
        for (partly, why), effects in closed.items()
    ]


def hypotheses(diagnosis: Mapping[str, Any]) -> tuple[ReportTable, ...]:
    """Return the table of all effects that were tried, each alone, the best first; none where none was tried.

    Args:
        diagnosis: content of diagnosis.json.
    """
    tried = diagnosis.get("hypotheses") or []
    rows = tuple(
        (
            words.plain(one["effect"]),
            words.number(one["score"]),
            f"{words.degrees(one['rms_effect_deg'], 2)} rms",
            words.number(one["probability"], 2),
        )
        for one in tried
    )
    caption = "Each effect tried alone: log likelihood ratio with size and date integrated out, posterior probability"
    return (ReportTable(caption, ("", "Log evidence", "Size", "Probability"), rows),) if rows else ()


def _small(one: Mapping[str, Any]) -> str:
    return f"{words.plain(one['effect'])} ({words.degrees(one['rms_effect_deg'])} rms)"


def _finding(one: Mapping[str, Any], product: bool) -> ReportedFinding:
    facts = [
        ("Side", SIDES.get(one["side"], one["side"])),
        *([("Probability", words.chance(one["probability"]))] if "probability" in one else []),
        ("Could also be", "; ".join(named(one)[1:]) or "nothing else of the catalogue"),
        *_place(one),
        *([("Formula", formula(**one["composition"]))] if one.get("composition") else []),
        *([("Residual on held-out days", _held_out(one["heldout"]))] if one["heldout"] else []),
        *([("In the product", "yes" if one["applied"] else "no")] if product else []),
    ]
    name = f"{COMPOSED}{'/'.join(one['composition'].values())}" if one.get("composition") else one["effect"]
    title = words.plain(name)
    return ReportedFinding(title[0].upper() + title[1:], one["text"], tuple(facts), _parameters(one))


def _unexplained(left: Mapping[str, Any]) -> ReportedFinding:
    return ReportedFinding("Unexplained", left["text"], tuple(_place(left)))


def _place(one: Mapping[str, Any]) -> list[tuple[str, str]]:
    where, when = one.get("where") or {}, one.get("when")
    texts = [("Where", words.sentence(where["text"]))] if where.get("text") else []
    texts += [("When", words.days(when))] if when else []
    return [*texts, ("Size", f"{words.degrees(one['rms_effect_deg'])} rms")] if "rms_effect_deg" in one else texts


def _held_out(proof: Mapping[str, Any]) -> str:
    text = f"{words.degrees(proof['rms_before_deg'], 2)} before, {words.degrees(proof['rms_after_deg'], 2)} after"
    chance = proof.get("p_value")
    if chance is None:
        return f"{text} rms"
    return f"{text} rms ({'p ≤ 0.001' if chance <= LEAST_P else f'p = {words.significant(chance, 2)}'})"


def _parameters(finding: Mapping[str, Any]) -> ReportTable | None:
    fitted = {name: one for name, one in finding["parameters"].items() if one["sigma"]}
    known = meanings(finding["effect"])
    if not fitted:
        return None
    rows = tuple(
        (
            known.get(name) or words.parameter(name, one["unit"]),
            words.with_sigma(one["value"], one["sigma"], one["unit"]),
        )
        for name, one in fitted.items()
    )
    return ReportTable("Parameters", ("", "Value ± 1σ"), rows)
