"""The answer that a reader comes for: are the currents right now, how sure, what was found, and what is left to do."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from compasslib.report import found, words
from compasslib.report.results import Headings, MooringResults

WIDE_DEG = 20.0  # an uncertainty beyond which a direction says little
MOST_NAMES = 3  # of one effect in the answer; the finding has all of them


def answer(results: MooringResults) -> str:
    """Return what is probably wrong, if anything is; then share corrected, uncertainty, deviation and findings."""
    head = results.headings
    if not head.corrected:
        why = results.fit["why"] or results.diagnosis.get("why", "") or "no usable deviation model covers them"
        return words.sentence(f"no heading is corrected: {why}")
    share = f"{words.percent(head.corrected / head.n)} of the" if head.corrected < head.n else "All"
    sigma, largest = words.degrees(head.sigma_deg[0]), words.degrees(head.largest_deviation_deg, 0)
    but = "but with" if head.sigma_deg[0] > WIDE_DEG else "with"
    corrected = (
        f"{share} headings are corrected, {but} a median uncertainty of {sigma} (1σ); the compass deviated by up to "
        f"{largest}; {what_was_found(results.diagnosis)}."
    )
    reasons = [words.sentence(doubt["why"]) for doubt in results.fit["applied"].get("doubts", ())]
    return " ".join([*reasons, corrected])


def what_was_found(diagnosis: Mapping[str, Any]) -> str:
    """Return a clause on what the search found beyond the fitted deviation, with its probability.

    Args:
        diagnosis: content of diagnosis.json.
    """
    texts = [_first(found.named(one)) for one in diagnosis["findings"]]
    if left := diagnosis["unexplained"]:
        texts.append(f"a mismatch of {words.degrees(left['rms_effect_deg'])} rms that is unexplained")
    if texts:
        return f"found beyond the fitted deviation: {'; '.join(texts)}"
    if diagnosis["verdict"] == "insufficient":
        return "the record does not tell whether there is more than the fitted deviation"
    none = (diagnosis.get("sides") or {}).get("none")
    sure = f" (probability {words.chance(none)})" if none is not None else ""
    return f"no error beyond the fitted deviation was detected{sure}"


def _first(names: list[str]) -> str:
    rest = len(names) - MOST_NAMES
    return " or ".join([*names[:MOST_NAMES], *([f"one of {rest} others"] if rest > 1 else names[MOST_NAMES:])])


def agreement(assessment: Mapping[str, Any]) -> str:
    """Return the one sentence on how far the currents are from the reference's, before and after; empty without pairs.

    Args:
        assessment: content of assessment.json.
    """
    before, after = assessment["before"], assessment["after"]
    if not before["n"]:
        return ""
    rms = [words.with_sigma(one["rms_deg"], one["rms_deg_sigma"], "°") for one in (before, after) if one["n"]]
    then = f", {rms[1]} rms after" if after["n"] else "; none of them could be corrected"
    return (
        f"Direction of the current minus the reference's, on {words.plural(before['n'], 'pair')} held out from the "
        f"fit: {rms[0]} rms before{then}. The shear of the water and the noise of both instruments are in it, so that "
        "it never goes to zero."
    )


def to_do(results: MooringResults) -> tuple[str, ...]:
    """Return what is left to the reader, in sentences."""
    head, warnings = results.headings, [one for one in results.row["warnings"].split(" | ") if one]
    texts = [*_of_headings(head)]
    decide = words.listed([words.plain(part) for part in (results.diagnosis["separated_by"] or "").split("; ") if part])
    texts += [f"To settle which effect it is: {decide.rstrip('.')}."] if decide else []
    texts += [f"Read the {words.plural(len(warnings), 'warning')} below."] if warnings else []
    return tuple(texts) or ("Nothing: UCUR and VCUR of corrected.nc are the currents to use.",)


def _of_headings(head: Headings) -> list[str]:
    if not head.corrected:
        return ["Give the mooring a reference that overlaps, or a calibration (fit: {method: calibration, name: ...})."]
    doubtful, lost = (words.percent(n / head.n) for n in (head.doubtful, head.n - head.corrected))
    texts = [f"{doubtful} of the headings are doubtful (flag 3): leave them out where a wrong one would harm."] * bool(
        head.doubtful
    )
    if head.sigma_deg[0] > WIDE_DEG:
        texts.append("The uncertainty of the headings is large: do not rest on directions that need a smaller one.")
    return [*texts, f"{lost} of the headings are missing (flag 4)."] if head.corrected < head.n else texts
