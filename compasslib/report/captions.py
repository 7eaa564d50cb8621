"""What each figure of a mooring shows, and the figure of any diagnosis, in words and numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from compasslib.archive import currents
from compasslib.effects.composed import formula
from compasslib.inference.wording import displayed_residuals
from compasslib.report import words
from compasslib.report.results import MooringResults


def captions(results: MooringResults) -> dict[str, Callable[[], str]]:
    """Return the texts by the figures' names, each made where it is asked for."""
    return {
        "sticks": lambda: _sticks(results),
        "progressive": lambda: (
            f"Where water would go that moved as the current at {_depth(results)} in its means of "
            f"{_span_of_means(results)}, over those that all lines have; north is up."
        ),
        "roses": lambda: _roses(results),
        "deviation": lambda: _deviation(results),
        "scatter": lambda: _scatter(results),
        "timeline": lambda: _timeline(results),
        "diagnosis": lambda: of_diagnosis(results.diagnosis),
    }


def _depth(results: MooringResults) -> str:
    return f"{words.number(results.currents.depth_m, 0)}{words.SPACE}m"


def _span_of_means(results: MooringResults) -> str:
    hours = currents.span_of_means(results.currents.recorded.time_s)
    return words.plural(int(hours), "hour") if hours <= 24.0 else words.plural(int(hours / 24.0), "day")


def _sticks(results: MooringResults) -> str:
    before, after = (words.current(mean) for mean in results.currents.mean)
    if before == words.UNKNOWN:
        return "No bin has a current to show."
    text = f"The current at {_depth(results)}: each stick is a mean of {_span_of_means(results)}, from its date towards"
    told = f"{text} where the water goes, north up. On average {before} by the recorded heading"
    return f"{told}, {after} by the corrected one." if after != words.UNKNOWN else f"{told}; none is corrected."


def _roses(results: MooringResults) -> str:
    head = results.headings
    spans = [f"Nine in ten recorded headings lie {_span(head.recorded_span_deg)}"]
    spans += [f"nine in ten corrected ones {_span(head.corrected_span_deg)}"] if head.corrected else []
    return (
        f"How often the current at {_depth(results)} and the instrument point each way; the reference's current at the "
        f"pairs. {', '.join(spans)}."
    )


def _deviation(results: MooringResults) -> str:
    fit = results.product
    if not fit["coefficients"]:
        return f"No curve was fitted. {words.sentence(results.fit['why'])}".strip()
    turn = "two correct ones" if fit["folded"] else "one correct one"
    points = words.plural(fit["n_pairs"], "pair") if fit["n_pairs"] else "no pair of this mooring"
    return (
        "Above the deviation by the correct heading β, below recorded heading γ by correct one and back: the "
        f"{words.METHODS.get(fit['method'], fit['method'])} with its 95 % band, and {points}. Each recorded heading "
        f"stands for {turn}."
    )


def _span(span: tuple[float, float]) -> str:
    if not math.isfinite(span[0]):
        return "nowhere"
    return f"from {words.degrees(span[0], 0)} clockwise to {words.degrees(span[1], 0)}"


def _scatter(results: MooringResults) -> str:
    if not results.assessment["before"]["n"]:
        return "There are no pairs: no reference measured near enough to compare."
    return (
        "Direction of the current at the affected instrument against the reference's, of all pairs, by the recorded "
        "and by the corrected heading; on the line they agree."
    )


def _timeline(results: MooringResults) -> str:
    head = results.headings
    if not head.n:
        return "The record along time: there is no sample inside the deployment."
    shares = [words.percent(k / head.n) for k in (head.corrected, head.doubtful, head.n - head.corrected)]
    attributes = head.attributes
    span = {"from": attributes["time_coverage_start"], "to": attributes["time_coverage_end"]}
    sigma = f" The uncertainty is {words.degrees(head.sigma_deg[0])} (1σ, median)." if head.corrected else ""
    return (
        f"Recorded and corrected heading, share of samples and depth from {words.days(span)}: {shares[0]} corrected "
        f"({shares[1]} doubtful), {shares[2]} not corrected.{sigma}"
    )


def of_diagnosis(diagnosis: Mapping[str, Any]) -> str:
    """Return what the figure of a diagnosis shows.

    Args:
        diagnosis: content of diagnosis.json.
    """
    shown = displayed_residuals(diagnosis)
    if not shown:
        return "There is no residual to show."
    texts = ["Residual of the fit, in bins; grey: 95 % range of noise."]
    alone = " by the fit alone, and with the identified effects" * any(
        one["before_deg"] != one["after_deg"] for one in shown
    )
    largest = [f"{words.plain(one['covariate'])} {_largest(one)}" for one in shown]
    texts += [f"Largest in a bin{alone}: along {', '.join(largest)}."]
    texts += ["Below: the residual on held-out data."] * bool(diagnosis["findings"])
    composed = [one["composition"] for one in diagnosis["findings"] if one.get("composition")]
    texts += [f"Composed, on {words.plain(one['acts_on'])}: {formula(**one)}." for one in composed]
    return " ".join(texts)


def _largest(curve: Mapping[str, Any]) -> str:
    """Return the largest binned residual before and after; a bin that holds no number is passed over."""
    ends = [
        words.degrees(max((abs(x) for x in curve[key] if x is not None), default=None))
        for key in ("before_deg", "after_deg")
    ]
    return ends[0] if curve["before_deg"] == curve["after_deg"] else f"{ends[0]} and {ends[1]}"
