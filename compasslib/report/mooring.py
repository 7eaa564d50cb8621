"""One mooring's results -> its section of the report."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from compasslib.core import angles
from compasslib.report import figures, found, words
from compasslib.report.results import Headings, MooringResults
from compasslib.report.section import Cell, ReportSection, ReportTable
from compasslib.search.wording import VERDICTS

HEADER = (
    "Mooring",
    "Verdict",
    "Effects found",
    "Method",
    "Pairs",
    "Corrected",
    "Uncertainty",
    "Rms before",
    "Rms after",
    "Largest deviation",
    "Folded",
    "Warnings",
)
FILES = ("corrected.nc", "overlap.nc", "deviation.json", "diagnosis.json", "assessment.json", "figures", "logs")
LETTERS = ("A", "B", "C", "D", "E")


def section(results: MooringResults, root: Path, site: Mapping[str, Any], *, embed: bool) -> ReportSection:
    """Return one mooring's section.

    Args:
        site: latitude, longitude, water_depth_m, instruments (role and what it is).
        embed: whether its figures come into the page.
    """
    verdict = results.diagnosis["verdict"]
    drawn = alternatives(results)
    return ReportSection(
        name=results.name,
        anchor=f"mooring-{results.name}",
        verdict=verdict,
        summary=sentences(results),
        facts=_facts(results, site),
        findings=found.findings(results.diagnosis, product=True),
        cannot_tell=found.cannot_tell(results.diagnosis),
        warnings=tuple(warning for warning in results.row["warnings"].split(" | ") if warning),
        tables=(
            *_agreement(results.assessment),
            *_coefficients(results.fit),
            *found.hypotheses(results.diagnosis),
            *_inputs(results.inputs),
        ),
        figures=figures.of_folder(results.folder, root, drawn, embed=embed),
        links=tuple((file, figures.relative(results.folder / file, root)) for file in FILES),
        cells=_cells(results),
    )


def sentences(results: MooringResults) -> tuple[str, ...]:
    """Return what comes first of one mooring: its verdict, why, and the share that is corrected."""
    head, why = results.headings, results.diagnosis.get("why", "")
    texts = [words.sentence(VERDICTS[results.diagnosis["verdict"]])]
    texts += [words.sentence(why)] if why else []
    share = words.percent(head.corrected / head.n if head.n else None)
    texts.append(f"{share} of the {words.count(head.n)} samples have a corrected heading.")
    if results.fit["why"] and results.fit["why"] != why:
        texts.append(words.sentence(results.fit["why"]))
    return tuple(texts)


def _water(errors: Mapping[str, float] | None) -> list[tuple[str, str]]:
    """Return how far the water at the trusted depth is expected to be from what stands for it, if that is known."""
    if not errors:
        return []
    mean, predicted = (f"{words.significant(100.0 * errors[name], 2)} cm/s" for name in ("mean_of_bins", "predicted"))
    return [
        (
            "Water at the trusted depth",
            f"by the profile {predicted} rms off the prediction, {mean} off the mean of the bins",
        )
    ]


def _facts(results: MooringResults, site: Mapping[str, Any]) -> tuple[tuple[str, str], ...]:
    head, attributes = results.headings, results.headings.attributes
    instrument = ", ".join(str(attributes[key]) for key in ("instrument", "serial_number") if key in attributes)
    facts = [
        ("Position", words.position(site["latitude"], site["longitude"])),
        ("Water depth", f"{words.significant(site['water_depth_m'], 5)} m"),
        ("Deployment", words.days({"from": site["start"], "to": site["end"]})),
        *((f"{role} instrument", text) for role, text in site["instruments"].items()),
        ("Make and number", instrument or "not given"),
        ("Method", made_with(results.fit)),
        *counted(head),
        *sure(head),
        *_water(results.assessment.get("water_error_m_s")),
        ("The compass can show", _range(results.product)),
        ("Declination", _pair("{} to {}", head.declination_deg, digits=2)),
        (
            "Made by",
            f"{attributes.get('software_version', 'not given')}, {attributes.get('date_created', 'not dated')}",
        ),
    ]
    return tuple(facts)


def counted(head: Headings) -> list[tuple[str, str]]:
    """Return how many samples are corrected, doubtful and not corrected."""

    def share(n: int) -> str:
        return f"{words.percent(n / head.n if head.n else None)} ({words.plural(n, 'sample')})"

    return [
        ("Corrected, flag 1 or 2", share(head.corrected - head.doubtful)),
        ("Corrected, but doubtful, flag 3", share(head.doubtful)),
        ("Not corrected, NaN", share(head.n - head.corrected)),
    ]


def sure(head: Headings) -> list[tuple[str, str]]:
    """Return how uncertain the corrected headings are, and how far they were turned."""
    return [
        ("Uncertainty of the heading (1σ)", _pair("median {}, 95th percentile {}", head.sigma_deg)),
        ("Largest deviation", words.degrees(head.largest_deviation_deg)),
    ]


def _pair(form: str, pair: tuple[float, float], digits: int = 1) -> str:
    return form.format(*(words.degrees(x, digits) for x in pair)) if math.isfinite(pair[0]) else words.UNKNOWN


def made_with(fit: Mapping[str, Any]) -> str:
    """Return by which method a product was made, and with which effects.

    Args:
        fit: content of deviation.json.
    """
    text = words.METHODS.get(fit["method"], fit["method"])
    applied = fit["applied"]
    if not _other(fit):
        return text
    product = words.METHODS.get(applied["method"], applied["method"])
    text += f"; the product is made by the {product}"
    beside = words.listed([words.plain(effect) for effect in applied["accounted_for"]])
    text += f", fitted with {beside} accounted for" if beside else ""
    effects = words.listed([words.plain(effect) for effect in applied["effects"]])
    return f"{text} with what was found on its side ({effects})" if effects else text


def _other(fit: Mapping[str, Any]) -> bool:
    """Tell whether the product is made by another compass than the configured fit's."""
    applied = fit["applied"]
    return bool(applied["fit"]) and bool(
        applied["effects"] or applied["accounted_for"] or applied["method"] != fit["method"]
    )


def _range(fit: Mapping[str, Any]) -> str:
    if not fit["recorded_range_deg"]:
        return words.UNKNOWN
    low, high = fit["recorded_range_deg"]
    if high - low >= 360.0:
        return "every heading"
    begin, end = (words.degrees(float(angles.wrap360(heading)), 0) for heading in (low, high))
    return f"{begin} to {end} only{', each for two correct headings' if fit['folded'] else ''}"


def _agreement(assessment: Mapping[str, Any]) -> tuple[ReportTable, ...]:
    """Return the table of agreement on held-out pairs; none where there is no pair."""
    rows = [("Before", assessment["before"]), ("Before, where corrected", assessment["before_where_corrected"])]
    rows.append(("After", assessment["after"]))
    if not assessment["before"]["n"]:
        return ()
    days = words.significant(assessment["held_out"]["block_days"], 2)
    caption = f"Upper minus lower current direction, each pair held out from the fit (blocks of {days} days)"
    header = ("", "Pairs", "Mean", "Rms", "Median absolute", "Vector correlation")
    return (ReportTable(caption, header, tuple((name, *_compared(one)) for name, one in rows)),)


def _compared(one: Mapping[str, Any]) -> tuple[str, ...]:
    if not one["n"]:
        return (words.count(0), *(words.UNKNOWN,) * 4)
    rms = words.with_sigma(one["rms_deg"], one["rms_deg_sigma"], "°")
    correlated = words.number(one["vector_correlation"]["magnitude"], 3)
    mean, median = (words.degrees(one[key]) for key in ("mean_deg", "median_absolute_deg"))
    return (words.count(one["n"]), mean, rms, median, correlated)


def _coefficients(fit: Mapping[str, Any]) -> tuple[ReportTable, ...]:
    if not fit["coefficients"]:
        return ()
    method = words.METHODS.get(fit["method"], fit["method"])
    columns = [(f"As configured ({method})", fit["coefficients"], fit["covariance"])]
    applied = fit["applied"]
    if _other(fit):
        block = (applied["compasses"] or [{"compass": None}])[0]["compass"] or applied["fit"]
        columns.append(("Of the product (exact compass)", block["coefficients"], block["covariance"]))
    unit = "°" if fit["unit"] == "degrees" else ""
    units = [unit, ""]  # the product's compass is the exact one, whose coefficients have no unit
    rows = tuple((name, *_lettered(c, v, u)) for (name, c, v), u in zip(columns, units, strict=False))
    kind = "" if unit else ", dimensionless"
    pairs = f"{words.plural(fit['n_pairs'], 'pair')}, worth {words.number(fit['n_effective'], 0)} independent ones"
    caption = (
        f"Coefficients of the deviation ± 1σ{kind} ({pairs}; residual {words.degrees(fit['residual_rms_deg'])} rms)"
    )
    return (ReportTable(caption, ("", *LETTERS), rows),)


def _lettered(coefficients: Mapping[str, float], covariance: Any, unit: str) -> tuple[str, ...]:
    sigmas = [math.sqrt(covariance[k][k]) if covariance else None for k in range(len(LETTERS))]
    return tuple(words.with_sigma(coefficients[k], sigma, unit) for k, sigma in zip(LETTERS, sigmas, strict=True))


def _inputs(inputs: Mapping[str, Mapping[str, int]]) -> tuple[ReportTable, ...]:
    """Return one table of what was read, skipped and flagged, a column an instrument; zeros stand in its caption."""
    names = dict.fromkeys(name for counts in inputs.values() for name in counts)
    seen = [name for name in names if any(counts.get(name) for counts in inputs.values())]
    if not names:
        return ()
    rows = tuple(
        (words.plain(name), *(words.count(counts[name]) if name in counts else "" for counts in inputs.values()))
        for name in seen
    )
    none = ", ".join(words.plain(name) for name in names if name not in seen)
    caption = "Inputs: what was read, skipped and flagged" + (f"; none of: {none}" if none else "")
    return (ReportTable(caption, ("", *inputs), rows, folded="Inputs: what was read, skipped and flagged"),)


def _cells(results: MooringResults) -> tuple[Cell, ...]:
    row, head = results.row, results.headings
    before, after, largest = (_number(row[f"{key}_deg"]) for key in ("rms_before", "rms_after", "max_deviation"))
    effects = [words.plain(effect) for effect in row["effects"].split()]
    warnings = len([warning for warning in row["warnings"].split(" | ") if warning])
    share = head.corrected / head.n if head.n else 0.0
    sigma = head.sigma_deg[0] if head.corrected else None
    return (
        Cell(results.name, results.name),
        Cell(row["verdict"], _order(row["verdict"])),
        Cell(", ".join(effects) or "none", ", ".join(effects) or None),
        Cell(row["method"], row["method"]),
        Cell(words.count(int(row["n_pairs"])), int(row["n_pairs"])),
        Cell(words.percent(share), share),
        Cell(words.degrees(sigma), sigma),
        Cell(words.degrees(before), before),
        Cell(words.degrees(after), after),
        Cell(words.degrees(largest), largest),
        Cell("yes" if row["folded"] == "True" else "no", row["folded"]),
        Cell(words.count(warnings), warnings),
    )


def _number(text: str) -> float | None:
    return float(text) if text else None


def _order(verdict: str) -> str:
    """Return what a verdict is sorted by, what agrees first."""
    return str(list(VERDICTS).index(verdict))


# What each figure of a mooring shows, in words and numbers, for whoever cannot see it.


def alternatives(results: MooringResults) -> dict[str, Callable[[], str]]:
    """Return the texts by the figures' names, each made where it is asked for."""
    return {
        "deviation": lambda: _deviation(results),
        "histograms": lambda: _histograms(results),
        "scatter": lambda: _scatter(results),
        "timeline": lambda: _timeline(results),
        "diagnosis": lambda: of_diagnosis(results.diagnosis),
    }


def _deviation(results: MooringResults) -> str:
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


def _histograms(results: MooringResults) -> str:
    head = results.headings
    spans = [f"Nine in ten recorded headings lie {_span(head.recorded_span_deg)}"]
    spans.append(
        f"nine in ten corrected headings {_span(head.corrected_span_deg)}" if head.corrected else "none is corrected"
    )
    return (
        "Histograms per 10° of headings (left) and of current directions of the pairs (right), recorded, corrected and "
        f"trusted. {', '.join(spans)}."
    )


def _span(span: tuple[float, float]) -> str:
    if not math.isfinite(span[0]):
        return "nowhere"
    return f"from {words.degrees(span[0], 0)} clockwise to {words.degrees(span[1], 0)}"


def _scatter(results: MooringResults) -> str:
    before, after = results.assessment["before"], results.assessment["after"]
    if not before["n"]:
        return "No pairs: there is no trusted measurement near enough to compare."
    text = "Current direction of the upper against the lower instrument, recorded and corrected. On held-out pairs the "
    text += f"difference is {words.degrees(before['rms_deg'])} rms before ({words.plural(before['n'], 'pair')})"
    if not after["n"]:
        return f"{text}; none could be corrected."
    return f"{text} and {words.degrees(after['rms_deg'])} after ({words.plural(after['n'], 'pair')})."


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
    texts = [f"Residual in bins along {words.plain(one['covariate'])}: {_largest(one)}." for one in _curves(diagnosis)]
    verdict = words.sentence(f"{diagnosis['verdict']}: {VERDICTS[diagnosis['verdict']]}")
    return " ".join([verdict, *(texts or ["There is no residual to show."])])


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
