"""What each figure of a mooring shows, in words and numbers, for whoever cannot see it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from compasslib.discrepancy.telling import VERDICTS
from compasslib.report import words

if TYPE_CHECKING:
    from compasslib.report.mooring import Results


def alternatives(results: Results) -> dict[str, Callable[[], str]]:
    """Return the texts by the figures' names, each made where it is asked for.

    Args:
        results: what the files of the mooring hold.
    """
    return {
        "deviation": lambda: _deviation(results),
        "histograms": lambda: _histograms(results),
        "scatter": lambda: _scatter(results),
        "timeline": lambda: _timeline(results),
        "diagnosis": lambda: of_diagnosis(results.diagnosis),
    }


def _deviation(results: Results) -> str:
    fit = results.product
    if not fit["coefficients"]:
        return "Deviation against heading: no curve, because nothing was fitted."
    method = words.METHODS.get(fit["method"], fit["method"])
    seen = (
        "each recorded heading stands for two correct ones"
        if fit["folded"]
        else "each recorded heading stands for one correct one"
    )
    residual = f", residual {words.degrees(fit['residual_rms_deg'])} rms" if fit["n_pairs"] else ""
    return (
        f"Three panels: deviation against correct heading, recorded against correct heading, and back. Curve of the "
        f"{method} with its 95 % band and {words.plural(fit['n_pairs'], 'pair')}{residual}. The largest deviation of "
        f"the record is {words.degrees(results.headings.largest_deviation_deg)}; {seen}."
    )


def _histograms(results: Results) -> str:
    head = results.headings
    told = [f"Nine in ten recorded headings lie {_span(head.recorded_span_deg)}"]
    told.append(
        f"nine in ten corrected headings {_span(head.corrected_span_deg)}" if head.corrected else "none is corrected"
    )
    return (
        "Histograms per 10° of headings (left) and of current directions of the pairs (right), recorded, corrected and "
        f"trusted. {', '.join(told)}."
    )


def _span(span: tuple[float, float]) -> str:
    if not math.isfinite(span[0]):
        return "nowhere"
    return f"from {words.degrees(span[0], 0)} clockwise to {words.degrees(span[1], 0)}"


def _scatter(results: Results) -> str:
    before, after = results.assessment["before"], results.assessment["after"]
    if not before["n"]:
        return "No pairs: there is no trusted measurement near enough to compare."
    told = "Current direction of the upper against the lower instrument, recorded and corrected. On held-out pairs the "
    told += f"difference is {words.degrees(before['rms_deg'])} rms before ({words.plural(before['n'], 'pair')})"
    if not after["n"]:
        return f"{told}; none could be corrected."
    return f"{told} and {words.degrees(after['rms_deg'])} after ({words.plural(after['n'], 'pair')})."


def _timeline(results: Results) -> str:
    head = results.headings
    if not head.n:
        return "The record along time: there is no sample inside the deployment."
    shares = [words.percent(k / head.n) for k in (head.corrected, head.doubtful, head.n - head.corrected)]
    said = head.attributes
    span = {"from": said["time_coverage_start"], "to": said["time_coverage_end"]}
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
    told = [f"Residual in bins along {words.plain(one['covariate'])}: {_largest(one)}." for one in _curves(diagnosis)]
    verdict = words.sentence(f"{diagnosis['verdict']}: {VERDICTS[diagnosis['verdict']]}")
    return " ".join([verdict, *(told or ["There is no residual to show."])])


def _curves(diagnosis: Mapping[str, Any]) -> Sequence[Mapping[str, Any]]:
    left = diagnosis["unexplained"]["curves"] if diagnosis["unexplained"] else []
    curves = {one["covariate"]: one for one in [*left, *diagnosis.get("curves", [])]}
    return [one for one in curves.values() if len(one["centre"]) > 1]


def _largest(curve: Mapping[str, Any]) -> str:
    """Return the largest binned residual before and after; a bin that holds no number is passed over."""
    before, after = (
        max((abs(x) for x in curve[key] if x is not None), default=None) for key in ("before_deg", "after_deg")
    )
    if before == after:
        return f"at most {words.degrees(after)} from zero"
    return f"at most {words.degrees(before)} from zero by the fit alone, {words.degrees(after)} with what was found"
