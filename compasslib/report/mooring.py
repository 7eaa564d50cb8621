"""One mooring's results -> its section of the report, and what each of its figures shows."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from compasslib import angles
from compasslib.archive import summary
from compasslib.report import explanation, sections, words
from compasslib.report.explanation import diagnosis_caption
from compasslib.report.sections import HeadingSummary, MooringResults, ReportSection, ReportTable

CURRENTS = ("sticks", "progressive", "roses")
OF_PAIRS = ("diagnosis", "deviation", "scatter")  # empty where there is neither a pair nor a curve
HEADER = (
    *("Mooring", "Verdict", "Found", "Method", "Pairs", "Corrected", "Uncertainty", "Rms before", "Rms after"),
    *("Largest deviation", "Two-valued", "Warnings"),
)
FILES = ("corrected.nc", "overlap.nc", "deviation.json", "diagnosis.json", "assessment.json", "figures", "logs")
LETTERS = ("A", "B", "C", "D", "E")


def mooring_section(results: MooringResults, root: Path, site: Mapping[str, Any], *, small: bool) -> ReportSection:
    """Return one mooring's section.

    Args:
        site: latitude, longitude, water_depth_m, instruments (role and what it is).
        small: whether the page has too many sections for whole pictures.
    """
    pictures = sections.collect_figures(results.folder, root, mooring_captions(results), small=small)
    if not (results.fit["n_pairs"] or results.product["coefficients"]):
        pictures = {name: entry for name, entry in pictures.items() if name not in OF_PAIRS}
    findings = explanation.report_findings(results.diagnosis, product=True)
    extra = ("diagnosis",) if findings else ()  # else it stands with the other figures
    return ReportSection(
        name=results.name,
        anchor=f"mooring-{results.name}",
        verdict=results.diagnosis["verdict"],
        summary=summary_sentences(results),
        to_do=explanation.list_actions(results),
        facts=_facts(results, site),
        first=tuple(pictures.pop(name) for name in CURRENTS if name in pictures),
        finding_figures=tuple(pictures.pop(name) for name in extra if name in pictures),
        findings=findings,
        limits=explanation.describe_limits(results.diagnosis),
        warnings=tuple(warning for warning in results.row["warnings"].split(" | ") if warning),
        figures=tuple(pictures.values()),
        tables=(
            *_agreement_table(results.assessment),
            *_coefficients_table(results.fit),
            *explanation.hypotheses_table(results.diagnosis),
            *_inputs_table(results.inputs),
        ),
        links=tuple((file, sections.relative_link(results.folder / file, root)) for file in FILES),
        cells=_cells(results),
    )


def summary_sentences(results: MooringResults) -> tuple[str, ...]:
    """Summarize a mooring: the answer, agreement with the reference, and reasons why not more."""
    first, fit = explanation.summarize(results), results.fit["why"]
    searched = results.diagnosis.get("why", "") if results.diagnosis["verdict"] == "insufficient" else ""
    reasons = [fit, "" if fit and fit in searched else searched]
    texts = (
        first,
        explanation.describe_agreement(results.assessment),
        *(words.sentence(why) for why in reasons if why not in first),
    )
    return (*(text for text in texts if text), *shared_sentence(results.fit))


def _water_facts(errors: Mapping[str, float] | None) -> list[tuple[str, str]]:
    """State the expected error of the water at the reference's depth, if that is known."""
    if not errors:
        return []
    mean, predicted = (f"{words.significant(100.0 * errors[name], 2)} cm/s" for name in ("mean_of_bins", "predicted"))
    return [
        (
            "Water at the depth of the reference",
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
        ("Method", describe_method(results.fit)),
        *count_facts(head),
        *uncertainty_facts(head),
        *_water_facts(results.assessment.get("water_error_m_s")),
        ("The compass can show", _recorded_range(results.product)),
        ("Declination", _pair("{} to {}", head.declination_deg, digits=2)),
        (
            "Made by",
            f"{attributes.get('software_version', 'not given')}, {attributes.get('date_created', 'not dated')}",
        ),
    ]
    return tuple(facts)


def count_facts(head: HeadingSummary) -> list[tuple[str, str]]:
    """Count the samples that are corrected, doubtful and not corrected."""

    def share(n: int) -> str:
        return f"{words.percent(n / head.n if head.n else None)} ({words.plural(n, 'sample')})"

    return [
        ("Corrected, flag 1 or 2", share(head.corrected - head.doubtful)),
        ("Corrected, but doubtful, flag 3", share(head.doubtful)),
        ("Not corrected, NaN", share(head.n - head.corrected)),
    ]


def uncertainty_facts(head: HeadingSummary) -> list[tuple[str, str]]:
    """State the uncertainty of the corrected headings and their largest deviation."""
    return [
        ("Uncertainty of the heading (1σ)", _pair("median {}, 95th percentile {}", head.sigma_deg)),
        ("Largest deviation", words.degrees(head.largest_deviation_deg)),
    ]


def _pair(form: str, pair: tuple[float, float], digits: int = 1) -> str:
    return form.format(*(words.degrees(x, digits) for x in pair)) if math.isfinite(pair[0]) else words.UNKNOWN


def describe_method(fit: Mapping[str, Any]) -> str:
    """Return by which method a product was made, and with which effects.

    Args:
        fit: content of deviation.json.
    """
    text = words.METHODS.get(fit["method"], fit["method"])
    applied = fit["applied"]
    if not _uses_other_compass(fit):
        return text
    product = words.METHODS.get(applied["method"], applied["method"])
    text += f"; the product is made by the {product}"
    extra = words.listed([words.plain(effect) for effect in applied["accounted_for"]])
    text += f", fitted beside {extra} (by half what is named of water or reference)" if extra else ""
    effects = words.listed([words.plain(effect) for effect in applied["effects"]])
    return f"{text} with what was found on its side ({effects})" if effects else text


def _uses_other_compass(fit: Mapping[str, Any]) -> bool:
    """Tell whether the product is made by another compass than the configured fit's."""
    applied = fit["applied"]
    return bool(applied["fit"]) and bool(
        applied["effects"] or applied["accounted_for"] or applied["method"] != fit["method"]
    )


def _recorded_range(fit: Mapping[str, Any]) -> str:
    if not fit["recorded_range_deg"]:
        return words.UNKNOWN
    low, high = fit["recorded_range_deg"]
    if high - low >= 360.0:
        return "every heading"
    begin, end = (words.degrees(float(angles.wrap360(heading)), 0) for heading in (low, high))
    return f"{begin} to {end} only{', each for two correct headings' if fit['folded'] else ''}"


def _agreement_table(assessment: Mapping[str, Any]) -> tuple[ReportTable, ...]:
    """Return the table of agreement on held-out pairs; none where there is no pair."""
    rows = [("Before", assessment["before"]), ("Before, where corrected", assessment["before_where_corrected"])]
    rows.append(("After", assessment["after"]))
    if not assessment["before"]["n"]:
        return ()
    days = words.significant(assessment["held_out"]["block_days"], 2)
    caption = f"Direction of the current minus the reference's, each pair held out from the fit (blocks of {days} days)"
    header = ("", "Pairs", "Mean", "Rms", "Median absolute", "Vector correlation")
    return (ReportTable(caption, header, tuple((name, *_agreement_cells(entry)) for name, entry in rows)),)


def _agreement_cells(entry: Mapping[str, Any]) -> tuple[str, ...]:
    if not entry["n"]:
        return (words.count(0), *(words.UNKNOWN,) * 4)
    rms = words.with_sigma(entry["rms_deg"], entry["rms_deg_sigma"], "°")
    correlated = words.number(entry["vector_correlation"]["magnitude"], 3)
    mean, median = (words.degrees(entry[key]) for key in ("mean_deg", "median_absolute_deg"))
    return (words.count(entry["n"]), mean, rms, median, correlated)


def _coefficients_table(fit: Mapping[str, Any]) -> tuple[ReportTable, ...]:
    if not fit["coefficients"]:
        return ()
    method = words.METHODS.get(fit["method"], fit["method"])
    columns = [(f"As configured ({method})", fit["coefficients"], fit["covariance"])]
    applied = fit["applied"]
    if _uses_other_compass(fit):
        block = (applied["compasses"] or [{"compass": None}])[0]["compass"] or applied["fit"]
        columns.append(("Of the product (exact compass)", block["coefficients"], block["covariance"]))
    unit = "°" if fit["unit"] == "degrees" else ""
    units = [unit, ""]  # the product's compass is the exact one, whose coefficients have no unit
    rows = tuple((name, *_coefficient_cells(c, v, u)) for (name, c, v), u in zip(columns, units, strict=False))
    kind = "" if unit else ", dimensionless"
    pairs = f"{words.plural(fit['n_pairs'], 'pair')}, worth {words.number(fit['n_effective'], 0)} independent ones"
    return (ReportTable(f"Coefficients of the deviation ± 1σ{kind} ({pairs})", ("", *LETTERS), rows),)


def _coefficient_cells(coefficients: Mapping[str, float], covariance: Any, unit: str) -> tuple[str, ...]:
    sigmas = [math.sqrt(covariance[k][k]) if covariance else None for k in range(len(LETTERS))]
    return tuple(words.with_sigma(coefficients[k], sigma, unit) for k, sigma in zip(LETTERS, sigmas, strict=True))


def _inputs_table(inputs: Mapping[str, Mapping[str, int]]) -> tuple[ReportTable, ...]:
    """Return one table of what was read, skipped and flagged, a column an instrument; zeros stand in its caption."""
    names = dict.fromkeys(name for counts in inputs.values() for name in counts)
    nonzero = [name for name in names if any(counts.get(name) for counts in inputs.values())]
    if not names:
        return ()
    rows = tuple(
        (words.plain(name), *(words.count(counts[name]) if name in counts else "" for counts in inputs.values()))
        for name in nonzero
    )
    none = ", ".join(words.plain(name) for name in names if name not in nonzero)
    caption = "Inputs: what was read, skipped and flagged" + (f"; none of: {none}" if none else "")
    return (ReportTable(caption, ("", *inputs), rows),)


def _cells(results: MooringResults) -> tuple[str, ...]:
    row, head = results.row, results.headings
    keys = ("rms_before_deg", "rms_after_deg", "max_deviation_deg")
    return (
        results.name,
        row["verdict"],
        ", ".join(words.plain(effect) for effect in row["effects"].split()) or "none",
        row["method"],
        words.count(int(row["n_pairs"])),
        words.percent(head.corrected / head.n if head.n else 0.0),
        words.degrees(head.sigma_deg[0]),
        *(words.degrees(float(row[key]) if row[key] else None) for key in keys),
        "yes" if row["folded"] == "True" else "no",
        words.count(len([warning for warning in row["warnings"].split(" | ") if warning])),
    )


def shared_sentence(fit: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the sentence on whose data carry a mooring's compass, none where only its own do.

    Args:
        fit: content of deviation.json.
    """
    shared = fit.get("shared")
    return (words.sentence(shared["text"]),) if shared else ()


# Captions.


def mooring_captions(results: MooringResults) -> dict[str, Callable[[], str]]:
    """Return the texts by the figures' names, each made where it is asked for."""
    return {
        "sticks": lambda: _sticks_caption(results),
        "progressive": lambda: (
            f"Where water would go that moved as the current at {_depth(results)} in its means of "
            f"{_averaging_period(results)}, over those that all lines have; north is up."
        ),
        "roses": lambda: _roses_caption(results),
        "deviation": lambda: _deviation_caption(results),
        "scatter": lambda: _scatter_caption(results),
        "timeline": lambda: _timeline_caption(results),
        "diagnosis": lambda: diagnosis_caption(results.diagnosis),
    }


def _depth(results: MooringResults) -> str:
    return f"{words.number(results.currents.depth_m, 0)}{words.SPACE}m"


def _averaging_period(results: MooringResults) -> str:
    hours = summary.averaging_hours(results.currents.recorded.time_s)
    return words.plural(int(hours), "hour") if hours <= 24.0 else words.plural(int(hours / 24.0), "day")


def _sticks_caption(results: MooringResults) -> str:
    before, after = (words.current(mean) for mean in results.currents.mean)
    if before == words.UNKNOWN:
        return "No bin has a current to show."
    text = (
        f"The current at {_depth(results)}: each stick is a mean of {_averaging_period(results)}, from its date towards"
    )
    description = f"{text} where the water goes, north up. On average {before} by the recorded heading"
    return (
        f"{description}, {after} by the corrected one."
        if after != words.UNKNOWN
        else f"{description}; none is corrected."
    )


def _roses_caption(results: MooringResults) -> str:
    head = results.headings
    spans = [f"Nine in ten recorded headings lie {_format_span(head.recorded_span_deg)}"]
    spans += [f"nine in ten corrected ones {_format_span(head.corrected_span_deg)}"] if head.corrected else []
    return (
        f"How often the current at {_depth(results)} and the instrument point each way; the reference's current at the "
        f"pairs. {', '.join(spans)}."
    )


def _deviation_caption(results: MooringResults) -> str:
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


def _format_span(span: tuple[float, float]) -> str:
    if not math.isfinite(span[0]):
        return "nowhere"
    return f"from {words.degrees(span[0], 0)} clockwise to {words.degrees(span[1], 0)}"


def _scatter_caption(results: MooringResults) -> str:
    if not results.assessment["before"]["n"]:
        return "There are no pairs: no reference measured near enough to compare."
    return (
        "Direction of the current at the affected instrument against the reference's, of all pairs, by the recorded "
        "and by the corrected heading; on the line they agree."
    )


def _timeline_caption(results: MooringResults) -> str:
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
