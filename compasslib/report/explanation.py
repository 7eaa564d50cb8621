"""A diagnosis.json in words, for moorings, compasses and calibrations alike: the answer, the findings, the limits."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from compasslib.effects import COMPOSED, meanings
from compasslib.effects.composed import effect_formula
from compasslib.inference import wording
from compasslib.report import words
from compasslib.report.sections import HeadingSummary, MooringResults, ReportedFinding, ReportTable

SIDES = {
    "compass": "the compass",
    "reference": "the reference",
    "water": "the water",
    "clock": "the clocks",
}
SMALLEST_P_VALUE = 0.001  # the smallest that the drawn blocks can show
CLAUSES = {
    **wording.PHYSICS,
    "hard_iron": "iron near by adds a constant field",
    "mounting_offset": "the mount turns all headings by a constant",
    "field_disturbance": "magnetic north moved with storms or the daily variation",  # shown by a series, or an index
}


def report_findings(diagnosis: Mapping[str, Any], *, product: bool) -> tuple[ReportedFinding, ...]:
    """Word the findings, strongest first, and after them what stays unexplained.

    Args:
        diagnosis: content of diagnosis.json.
        product: whether there is a corrected record that a finding may have entered.
    """
    texts = [_report_finding(entry, product) for entry in diagnosis["findings"]]
    left = diagnosis["unexplained"]
    return (
        (*texts, ReportedFinding("Unexplained", left["text"], tuple(_where_and_when(left)))) if left else tuple(texts)
    )


def candidate_names(finding: Mapping[str, Any]) -> list[str]:
    """Name the candidates of a finding, the best first: physics, and in brackets its name and probability."""
    chances = {finding["effect"]: finding.get("probability"), **(finding.get("alternatives_probability") or {})}
    if composed := finding.get("composition"):
        chances = {f"{COMPOSED}{'/'.join(composed.values())}": chances.pop(finding["effect"]), **chances}
    return [_candidate_name(name, chances.get(name)) for name in dict.fromkeys([*chances, *finding["alternatives"]])]


def _candidate_name(name: str, chance: float | None) -> str:
    sure = [] if chance is None else [f"probability {words.chance(chance)}"]
    if name.startswith(COMPOSED):
        return " ".join([words.plain(name), *(f"({each})" for each in sure)])
    clause = re.split(r" \(|[;:]", CLAUSES.get(name, words.plain(name)))[0]
    return f"{clause} ({', '.join([words.plain(name), *sure])})"


def describe_limits(diagnosis: Mapping[str, Any]) -> tuple[str, ...]:
    """Return sentences on what the recording does not tell.

    Args:
        diagnosis: content of diagnosis.json.
    """
    decide = [part for part in (diagnosis["separated_by"] or "").split("; ") if part]
    texts = [f"What would decide: {words.sentence(words.plain(part))}" for part in decide]
    chances = [
        f"{entry['what']}: {words.percent(entry['probability'])}" for entry in diagnosis.get("experiments") or []
    ]
    texts += [f"Probability that a further observation leaves one effect: {words.listed(chances)}."] if chances else []
    texts += [words.sentence(diagnosis.get("why", ""))] * (diagnosis["verdict"] != "insufficient")
    texts += _slow_water(diagnosis.get("noise") or {})
    texts += _not_testable(diagnosis)
    small = [
        f"{words.plain(entry['effect'])} ({words.degrees(entry['rms_effect_deg'])} rms)"
        for entry in diagnosis.get("negligible", [])
    ]
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
    for entry in diagnosis["not_testable"]:
        reasons.setdefault(entry["effect"], {})[words.sentence(entry["why"])] = None
    tested = {entry["effect"] for entry in diagnosis.get("hypotheses") or []}
    closed: dict[tuple[bool, str], list[str]] = {}
    for effect, whys in reasons.items():
        closed.setdefault((effect in tested, " ".join(whys)), []).append(words.plain(effect))
    return [
        f"{'Testable only in part' if partly else 'Not testable'}: {words.listed(effects)}. {why}"
        for (partly, why), effects in closed.items()
    ]


def hypotheses_table(diagnosis: Mapping[str, Any]) -> tuple[ReportTable, ...]:
    """Return the table of all effects that were tried, each alone, the best first; none where none was tried.

    Args:
        diagnosis: content of diagnosis.json.
    """
    tested = diagnosis.get("hypotheses") or []
    rows = tuple(
        (
            words.plain(entry["effect"]),
            words.number(entry["score"]),
            f"{words.degrees(entry['rms_effect_deg'], 2)} rms",
            words.number(entry["probability"], 2),
        )
        for entry in tested
    )
    caption = "Each effect tried alone: log likelihood ratio with size and date integrated out, posterior probability"
    return (ReportTable(caption, ("", "Log evidence", "Size", "Probability"), rows),) if rows else ()


def _report_finding(entry: Mapping[str, Any], product: bool) -> ReportedFinding:
    facts = [
        ("Side", SIDES.get(entry["side"], entry["side"])),
        *([("Probability", words.chance(entry["probability"]))] if "probability" in entry else []),
        ("Could also be", "; ".join(candidate_names(entry)[1:]) or "nothing else of the catalogue"),
        *_where_and_when(entry),
        *([("Formula", effect_formula(**entry["composition"]))] if entry.get("composition") else []),
        *([("Residual on held-out days", _held_out(entry["heldout"]))] if entry["heldout"] else []),
        *([("In the product", "yes" if entry["applied"] else "no")] if product else []),
    ]
    name = f"{COMPOSED}{'/'.join(entry['composition'].values())}" if entry.get("composition") else entry["effect"]
    title = words.plain(name)
    return ReportedFinding(title[0].upper() + title[1:], entry["text"], tuple(facts), _parameters(entry))


def _where_and_when(entry: Mapping[str, Any]) -> list[tuple[str, str]]:
    where, when = entry.get("where") or {}, entry.get("when")
    texts = [("Where", words.sentence(where["text"]))] if where.get("text") else []
    texts += [("When", words.days(when))] if when else []
    return [*texts, ("Size", f"{words.degrees(entry['rms_effect_deg'])} rms")] if "rms_effect_deg" in entry else texts


def _held_out(proof: Mapping[str, Any]) -> str:
    text = f"{words.degrees(proof['rms_before_deg'], 2)} before, {words.degrees(proof['rms_after_deg'], 2)} after"
    chance = proof.get("p_value")
    if chance is None:
        return f"{text} rms"
    return f"{text} rms ({'p ≤ 0.001' if chance <= SMALLEST_P_VALUE else f'p = {words.significant(chance, 2)}'})"


def _parameters(finding: Mapping[str, Any]) -> ReportTable | None:
    fitted = {name: entry for name, entry in finding["parameters"].items() if entry["sigma"]}
    known = meanings(finding["effect"])
    if not fitted:
        return None
    rows = tuple(
        (
            known.get(name) or words.parameter(name, entry["unit"]),
            words.with_sigma(entry["value"], entry["sigma"], entry["unit"]),
        )
        for name, entry in fitted.items()
    )
    return ReportTable("Parameters", ("", "Value ± 1σ"), rows)


# The answer: are the currents right now, how sure, what was found, and what is left to do.

WIDE_DEG = 20.0  # an uncertainty beyond which a direction says little
MAX_NAMES = 3  # of one effect in the answer; the finding has all of them


def summarize(results: MooringResults) -> str:
    """Summarize a mooring: what is probably wrong, if anything; share corrected, uncertainty, deviation, findings."""
    head = results.headings
    if not head.corrected:
        why = results.fit["why"] or results.diagnosis.get("why", "") or "no usable deviation model covers them"
        return words.sentence(f"no heading is corrected: {why}")
    share = f"{words.percent(head.corrected / head.n)} of the" if head.corrected < head.n else "All"
    sigma, largest = words.degrees(head.sigma_deg[0]), words.degrees(head.largest_deviation_deg, 0)
    but = "but with" if head.sigma_deg[0] > WIDE_DEG else "with"
    corrected = (
        f"{share} headings are corrected, {but} a median uncertainty of {sigma} (1σ); the compass deviated by up to "
        f"{largest}; {describe_findings(results.diagnosis)}."
    )
    reasons = [words.sentence(doubt["why"]) for doubt in results.fit["applied"].get("doubts", ())]
    return " ".join([*reasons, corrected])


def describe_findings(diagnosis: Mapping[str, Any]) -> str:
    """Return a clause on what the search found beyond the fitted deviation, with its probability.

    Args:
        diagnosis: content of diagnosis.json.
    """
    texts = [_join_candidates(candidate_names(entry)) for entry in diagnosis["findings"]]
    if left := diagnosis["unexplained"]:
        texts.append(f"a mismatch of {words.degrees(left['rms_effect_deg'])} rms that is unexplained")
    if texts:
        return f"found beyond the fitted deviation: {'; '.join(texts)}"
    if diagnosis["verdict"] == "insufficient":
        return "the record does not tell whether there is more than the fitted deviation"
    none = (diagnosis.get("sides") or {}).get("none")
    sure = f" (probability {words.chance(none)})" if none is not None else ""
    return f"no error beyond the fitted deviation was detected{sure}"


def _join_candidates(names: list[str]) -> str:
    remaining = len(names) - MAX_NAMES
    return " or ".join([*names[:MAX_NAMES], *([f"one of {remaining} others"] if remaining > 1 else names[MAX_NAMES:])])


def describe_agreement(assessment: Mapping[str, Any]) -> str:
    """Return the one sentence on how far the currents are from the reference's, before and after; empty without pairs.

    Args:
        assessment: content of assessment.json.
    """
    before, after = assessment["before"], assessment["after"]
    if not before["n"]:
        return ""
    rms = [words.with_sigma(entry["rms_deg"], entry["rms_deg_sigma"], "°") for entry in (before, after) if entry["n"]]
    then = f", {rms[1]} rms after" if after["n"] else "; none of them could be corrected"
    return (
        f"Direction of the current minus the reference's, on {words.plural(before['n'], 'pair')} held out from the "
        f"fit: {rms[0]} rms before{then}. The shear of the water and the noise of both instruments are in it, so that "
        "it never goes to zero."
    )


def list_actions(results: MooringResults) -> tuple[str, ...]:
    """List what is left to the reader, in sentences."""
    head, warnings = results.headings, [entry for entry in results.row["warnings"].split(" | ") if entry]
    texts = [*_heading_actions(head)]
    decide = words.listed([words.plain(part) for part in (results.diagnosis["separated_by"] or "").split("; ") if part])
    texts += [f"To settle which effect it is: {decide.rstrip('.')}."] if decide else []
    texts += [f"Read the {words.plural(len(warnings), 'warning')} below."] if warnings else []
    return tuple(texts) or ("Nothing: UCUR and VCUR of corrected.nc are the currents to use.",)


def _heading_actions(head: HeadingSummary) -> list[str]:
    if not head.corrected:
        return ["Give the mooring a reference that overlaps, or a calibration (fit: {method: calibration, name: ...})."]
    doubtful, lost = (words.percent(n / head.n) for n in (head.doubtful, head.n - head.corrected))
    texts = [f"{doubtful} of the headings are doubtful (flag 3): leave them out where a wrong one would harm."] * bool(
        head.doubtful
    )
    if head.sigma_deg[0] > WIDE_DEG:
        texts.append("The uncertainty of the headings is large: do not rest on directions that need a smaller one.")
    return [*texts, f"{lost} of the headings are missing (flag 4)."] if head.corrected < head.n else texts


def diagnosis_caption(diagnosis: Mapping[str, Any]) -> str:
    """Caption the figure of a diagnosis.

    Args:
        diagnosis: content of diagnosis.json.
    """
    shown = wording.displayed_residuals(diagnosis)
    if not shown:
        return "There is no residual to show."
    texts = ["Residual of the fit, in bins; grey: 95 % range of noise."]
    alone = " by the fit alone, and with the identified effects" * any(
        entry["before_deg"] != entry["after_deg"] for entry in shown
    )
    largest = [f"{words.plain(entry['covariate'])} {_largest_residual(entry)}" for entry in shown]
    texts += [f"Largest in a bin{alone}: along {', '.join(largest)}."]
    texts += ["Below: the residual on held-out data."] * bool(diagnosis["findings"])
    composed = [entry["composition"] for entry in diagnosis["findings"] if entry.get("composition")]
    texts += [f"Composed, on {words.plain(entry['acts_on'])}: {effect_formula(**entry)}." for entry in composed]
    return " ".join(texts)


def _largest_residual(curve: Mapping[str, Any]) -> str:
    """Return the largest binned residual before and after; a bin that holds no number is passed over."""
    ends = [
        words.degrees(max((abs(x) for x in curve[key] if x is not None), default=None))
        for key in ("before_deg", "after_deg")
    ]
    return ends[0] if curve["before_deg"] == curve["after_deg"] else f"{ends[0]} and {ends[1]}"
