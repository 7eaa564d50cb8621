"""One calibration's results -> its section of the report; the section of a compass that several records share."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from compasslib.archive.files import read_json
from compasslib.calibrations import MODELS
from compasslib.report import explanation, sections, words
from compasslib.report.sections import CalibrationResults, ReportSection, ReportTable

HEADER = (
    "Calibration",
    "Kind",
    "Readings",
    "Sectors of 10°",
    "Residual rms",
    "Expanded uncertainty",
    "Verdict",
    "Warnings",
)
KINDS = {
    "platform": "turned on a bench",
    "swing": "ship's swing by GNSS",
    "magnetometer": "magnetometer log",
    "two_heads": "two instruments on one frame",
    "declination": "observatory against the field model",
}
FILES = ("calibration.json", "table.csv", "points.csv", "diagnosis.json", "figures", "logs")
LETTERS = ("A", "B", "C", "D", "E")
AXES = ("x", "y", "z")


def calibration_section(results: CalibrationResults, root: Path, *, small: bool) -> ReportSection:
    """Return one calibration's section.

    Args:
        small: whether the page has too many sections for whole pictures.
    """
    content, diagnosis = results.content, results.diagnosis
    figures = sections.collect_figures(results.folder, root, calibration_captions(content, diagnosis), small=small)
    findings = explanation.report_findings(diagnosis, product=False) if diagnosis else ()
    diagnosis_figures = ("diagnosis",) if findings else ()
    links = tuple((f, sections.relative_link(results.folder / f, root)) for f in FILES if (results.folder / f).exists())
    parts = (_coefficients, _iron, _cardinal, _storms, _budget)
    return ReportSection(
        name=results.name,
        anchor=f"calibration-{results.name}",
        verdict=diagnosis["verdict"] if diagnosis else "",
        summary=_summary(content, diagnosis),
        facts=_facts(content),
        finding_figures=tuple(figures.pop(name) for name in diagnosis_figures if name in figures),
        findings=findings,
        limits=(*_limits(content), *(explanation.describe_limits(diagnosis) if diagnosis else ())),
        warnings=tuple(content["warnings"]),
        first=tuple(figures.values()),
        tables=(
            *(table for part in parts for table in part(content)),
            *(explanation.hypotheses_table(diagnosis) if diagnosis else ()),
            *_deviations(results),
        ),
        links=links,
        cells=_cells(results),
    )


def _summary(content: Mapping[str, Any], diagnosis: Mapping[str, Any] | None) -> tuple[str, ...]:
    beyond = f"; {explanation.describe_findings(diagnosis)}" if diagnosis else ""
    reasons = [diagnosis.get("why", "")] if diagnosis and diagnosis["verdict"] == "insufficient" else []
    later = (*(words.sentence(why) for why in reasons if why), *_nested_texts(content))
    if content["why"]:
        return (words.sentence(f"no curve was fitted: {content['why']}"), *later)
    expanded = content["uncertainty"]["expanded_deg"]
    sure = f"; the expanded uncertainty of a deviation is {words.degrees(expanded, 2)} (k = 2)" if expanded else ""
    spread = f" in {content['coverage']} of 36 sectors of 10°" if content["coverage"] else ""
    readings = f"{words.plural(content['n'], 'reading')}{spread}, model: {_model(content)}"
    return (f"{readings}{sure}{beyond}.", *later)


def _nested_texts(content: Mapping[str, Any]) -> Iterator[str]:
    """Give the sentences that a kind says about itself, wherever they stand in the file."""
    for key, value in content.items():
        if key == "text" and isinstance(value, str) and value:
            yield words.sentence(value)
        elif isinstance(value, Mapping):
            yield from _nested_texts(value)


def _facts(content: Mapping[str, Any]) -> tuple[tuple[str, str], ...]:
    place = content["place"]
    facts = [("Kind", KINDS.get(content["kind"], content["kind"])), ("Model", _model(content))]
    if place["latitude"] is not None:
        facts.append(("Position", words.position(place["latitude"], place["longitude"])))
    facts += [("Date", place["date"])] if place["date"] else []
    facts += (
        [("Declination", words.degrees(place["declination_deg"], 2))] if place["declination_deg"] is not None else []
    )
    if place["field"]:
        across, down = (words.number(place["field"][f"{axis}_nT"], 0) for axis in ("horizontal", "vertical"))
        facts.append(("Earth's field", f"horizontal {across} nT, down {down} nT"))
    if content["residual_rms_deg"] is not None:
        facts.append(("Residual", f"{words.degrees(content['residual_rms_deg'], 2)} rms"))
    if content.get("constant_sigma_deg") is not None:
        constant = words.with_sigma(content["constant_deg"], content["constant_sigma_deg"], "°")
        facts.append(("Constant beside the field model", constant))
    if content.get("offset_deg") is not None:
        facts.append(
            ("Offset of the second", words.with_sigma(content["offset_deg"], content.get("offset_sigma_deg"), "°"))
        )
    made = f"{content.get('software', 'not given')}, {content.get('date_created', 'not dated')}"
    return (*facts, ("Made from", ", ".join(content.get("source_files", [])) or "not given"), ("Made by", made))


def _model(content: Mapping[str, Any]) -> str:
    return MODELS.get(content["model"], words.plain(content["model"]))


def _limits(content: Mapping[str, Any]) -> tuple[str, ...]:
    open_ = [
        f"Not determined: {name}. {words.sentence(why)}" for name, why in content.get("undetermined_why", {}).items()
    ]
    limit = (content.get("iso_25862") or {}).get("conditions", [])
    return (*content.get("cannot_tell", []), *open_, *limit)


def _coefficients(content: Mapping[str, Any]) -> tuple[ReportTable, ...]:
    exact = content["exact"] or {}
    columns = [
        ("Series in the recorded heading", content["coefficients"], content["covariance"], "°"),
        ("Exact compass, dimensionless", exact.get("coefficients"), exact.get("covariance"), ""),
    ]
    known = [column for column in columns if column[1]]
    if not known:
        return ()
    rows = tuple(
        (name, *(_coefficient(c[letter], v, k, unit) for k, letter in enumerate(LETTERS))) for name, c, v, unit in known
    )
    return (ReportTable("Coefficients of the deviation ± 1σ", ("", *LETTERS), rows),)


def _coefficient(value: float | None, covariance: Any, k: int, unit: str) -> str:
    variance = covariance[k][k] if covariance else None
    if value is not None and variance is not None and abs(value) < 1e-9 and variance < 1e-18:
        return "0 by convention"
    return words.with_sigma(value, math.sqrt(variance) if variance else None, unit)


def _iron(content: Mapping[str, Any]) -> tuple[ReportTable, ...]:
    if not content.get("hard_iron"):
        return ()
    rows = tuple(_axis(content, k) for k in range(3))
    return (ReportTable("Hard iron (unit of the log) and soft iron ± 1σ", ("", "Hard iron", *AXES), rows),)


def _axis(content: Mapping[str, Any], k: int) -> tuple[str, ...]:
    hard = words.with_sigma(content["hard_iron"][k], content["hard_iron_sigma"][k])
    pairs = zip(content["soft_iron"][k], content["soft_iron_sigma"][k], strict=True)
    return (AXES[k], hard, *(words.with_sigma(value, sigma) for value, sigma in pairs))


def _cardinal(content: Mapping[str, Any]) -> tuple[ReportTable, ...]:
    """Return the coefficients by the formulae of the eight points; none where a kind has none."""
    cardinal = content.get("cardinal")
    if not cardinal:
        return ()
    single = [
        (words.plain(name), words.degrees(value, 2))
        for name, value in cardinal.items()
        if not isinstance(value, Mapping)
    ]
    single += [(f"D from {name}", words.degrees(value, 2)) for name, value in cardinal["D_from"].items()]
    return (
        ReportTable(
            "By the eight points (Moncunill Marimón et al. 2023)",
            ("", "Value"),
            tuple(single),
        ),
    )


def _storms(content: Mapping[str, Any]) -> tuple[ReportTable, ...]:
    """Return the storms of an observatory's series; none where a kind has none."""
    rows = tuple(
        (words.days(entry), words.degrees(entry["range_deg"], 2), f"{words.degrees(entry['rms_deg'], 2)} rms")
        for entry in content.get("storms") or []
    )
    return (ReportTable("Storms", ("When", "Range", "Size"), rows),) if rows else ()


def _budget(content: Mapping[str, Any]) -> tuple[ReportTable, ...]:
    budget = content["uncertainty"]
    rows = [(words.plain(n), words.degrees(row["standard_deg"], 2), row["how"]) for n, row in budget["rows"].items()]
    if not rows:
        return ()
    rows.append(
        (
            "together",
            words.degrees(budget["standard_deg"], 2),
            f"expanded {words.degrees(budget['expanded_deg'], 2)} (k = 2)",
        )
    )
    return (ReportTable("Uncertainty budget of one deviation", ("", "Standard", "How"), tuple(rows)),)


def _deviations(results: CalibrationResults) -> tuple[ReportTable, ...]:
    if not results.table:
        return ()
    rows = tuple((f"{row[0]}°", *(words.degrees(float(x) if x else None) for x in row[1:])) for row in results.table)
    return (
        ReportTable(
            "Deviation and its standard uncertainty by recorded heading",
            ("Recorded", "Deviation", "1σ"),
            rows,
        ),
    )


def _cells(results: CalibrationResults) -> tuple[str, ...]:
    content, diagnosis = results.content, results.diagnosis
    return (
        results.name,
        KINDS.get(content["kind"], content["kind"]),
        words.count(content["n"]),
        words.count(content["coverage"]),
        words.degrees(content["residual_rms_deg"], 2),
        words.degrees(content["uncertainty"]["expanded_deg"], 2),
        diagnosis["verdict"] if diagnosis else ("no calibration" if content["why"] else "not searched"),
        words.count(len(content["warnings"])),
    )


# What each figure of a calibration shows, in words and numbers.


def calibration_captions(
    content: Mapping[str, Any], diagnosis: Mapping[str, Any] | None
) -> dict[str, Callable[[], str]]:
    """Return the texts by the figures' names, each made where it is asked for.

    Args:
        diagnosis: diagnosis.json; None where there is none.
    """
    texts = {
        "deviation": lambda: _deviation_caption(content),
        "residuals": lambda: _residuals_caption(content),
        "certificate": lambda: _certificate_caption(content),
        "magnetometer": lambda: _magnetometer_caption(content),
        "swing": lambda: _swing_caption(content),
        "difference": lambda: (
            f"Heading of the first minus the second instrument against heading. {_offset_caption(content)}"
        ),
        "tilt_check": lambda: (
            f"Tilts of the two instruments, turned onto each other. {(content.get('frame') or {}).get('text', '')}"
        ),
        "series": lambda: f"Declination along time, observed and by the field model. {_constant_caption(content)}",
        "disturbance": lambda: _disturbance_caption(content),
        "along_time": lambda: (
            f"Headings of both instruments along time and their difference. {_offset_caption(content)}"
        ),
    }
    return texts | ({"diagnosis": lambda: explanation.diagnosis_caption(diagnosis)} if diagnosis else {})


def _deviation_caption(content: Mapping[str, Any]) -> str:
    if not content["coefficients"]:
        return f"Deviation against recorded heading: {content['n']} readings, no curve."
    letters = ", ".join(f"{k} {words.number(x, 2)}" for k, x in content["coefficients"].items())
    return (
        f"Deviation against recorded heading: {words.plural(content['n'], 'reading')}, the curve ("
        f"{_model(content)}) with its 95 % band. Coefficients in degrees: {letters}."
    )


def _residuals_caption(content: Mapping[str, Any]) -> str:
    rms = content["residual_rms_deg"]
    left = f"they are {words.degrees(rms, 2)} rms" if rms is not None else "there are none, for want of a curve"
    return f"Residuals of {words.plural(content['n'], 'reading')} against recorded heading: {left}."


def _certificate_caption(content: Mapping[str, Any]) -> str:
    expanded = content["uncertainty"]["expanded_deg"]
    sure = (
        f"expanded uncertainty {words.degrees(expanded, 2)} (k = 2)" if expanded else "no uncertainty could be stated"
    )
    what = "coefficients, table of deviations and budget"
    return f"Certificate on one page: {what}; {sure}. All its numbers stand in the tables here."


def _magnetometer_caption(content: Mapping[str, Any]) -> str:
    left = content.get("modulus_residual_percent") or {}
    text = "Magnetometer readings before and after taking out hard and soft iron."
    if left.get("after") is None:
        return f"{text} {words.sentence(content['why'])}"
    before, after = (words.number(left[key], 2) for key in ("before", "after"))
    return f"{text} The modulus of the field scatters by {before} % before and {after} % after."


def _swing_caption(content: Mapping[str, Any]) -> str:
    water = (content.get("drift") or {}).get("text", "")
    verdict = (content.get("iso_25862") or {}).get("text", "")
    text = f"The swing: courses against compass headings, {words.plural(content['n'], 'sample')}."
    return " ".join(part for part in (text, water, verdict) if part)


def _offset_caption(content: Mapping[str, Any]) -> str:
    if content.get("offset_deg") is None:
        return "No offset was found."
    return f"The offset is {words.with_sigma(content['offset_deg'], content.get('offset_sigma_deg'), '°')} (1σ)."


def _constant_caption(content: Mapping[str, Any]) -> str:
    value, sigma = content.get("constant_deg"), content.get("constant_sigma_deg")
    return f"The constant between them is {words.with_sigma(value, sigma, '°')} (1σ)."


def _disturbance_caption(content: Mapping[str, Any]) -> str:
    storms = content.get("storms") or []
    largest = max((entry["range_deg"] for entry in storms), default=None)
    range_ = f", the largest of {words.degrees(largest, 2)} from end to end" if storms else ""
    return f"What level and quiet day leave along time: {words.plural(len(storms), 'storm')}{range_}."


# A compass that several records share.

COMPASS_CAPTION = "All compasses that several records share"
COMPASS_HEADER = ("Name", "Verdict", "Records", "Not the same", "Iron between deployments", "Effects")
COMPASS_FILES = ("compass.json", "diagnosis.json", "figures", "logs")
COMPASS_CAPTIONS: Mapping[str, Callable[[], str]] = {
    "coefficients": lambda: "What each record shows of the iron, with its 95 % interval, beside what the compass has.",
    "curve": lambda: "Deviation by correct heading: each record's, and the compass's in the mean field, 95 % band.",
}
UNITS = {"P_nT": "nT", "Q_nT": "nT"}


def compass_section(name: str, root: Path, *, small: bool) -> ReportSection:
    """Return one compass's section.

    Args:
        small: whether the page has too many sections for whole pictures.

    Raises:
        InputError: a file of its results is absent or damaged.
    """
    folder = root / "compasses" / name
    content, diagnosis = read_json(folder / "compass.json"), read_json(folder / "diagnosis.json")
    figures = sections.collect_figures(folder, root, COMPASS_CAPTIONS, small=small)
    return ReportSection(
        name=name,
        anchor=f"compass-{name}",
        verdict=diagnosis["verdict"],
        summary=(_compass_summary(content, diagnosis), words.sentence(diagnosis["why"])),
        facts=(("iron that varies between deployments", _iron_between(content)),),
        findings=explanation.report_findings(diagnosis, product=False),
        limits=explanation.describe_limits(diagnosis),
        warnings=tuple(f"{entry['name']}: {words.sentence(entry['why'])}" for entry in content["rejected"]),
        tables=tuple(_compass_tables(content)),
        first=tuple(figures.values()),
        links=tuple(
            (file, sections.relative_link(folder / file, root)) for file in COMPASS_FILES if (folder / file).exists()
        ),
        cells=_compass_cells(name, content, diagnosis),
    )


def _compass_summary(content: Mapping[str, Any], diagnosis: Mapping[str, Any]) -> str:
    """Return the answer in a sentence: whose records they are, who does not belong, what they share."""
    fitting = [entry["name"] for entry in content["deployments"] if entry["fits"]]
    records = (
        f"{words.plural(len(content['deployments']), 'record')}, of one compass: {words.listed(fitting) or 'none'}"
    )
    odd = [entry["name"] for entry in content["rejected"]]
    return f"{records}{f'; not the same: {words.listed(odd)}' * bool(odd)}; {explanation.describe_findings(diagnosis)}."


def _iron_between(content: Mapping[str, Any]) -> str:
    size = content["sigma_between"]
    return "unknown" if size is None else f"{words.number(size, 0)} nT in each direction (1σ)"


def _compass_tables(content: Mapping[str, Any]) -> list[ReportTable]:
    header = ("Record", "B", "C", "D", "E", "Probability that it is this compass")
    rows = [
        (entry["name"], *_record_coefficients(entry), _probability(entry["probability_same"]))
        for entry in content["deployments"]
    ]
    tables = [ReportTable("What each record tells alone", header, tuple(rows))]
    if content["coefficients"]:
        spread = [row[k] ** 0.5 for k, row in enumerate(content["covariance"])]
        iron = [
            (name.removesuffix("_nT"), words.with_sigma(value, sigma, f" {UNITS[name]}" if name in UNITS else ""))
            for (name, value), sigma in zip(content["coefficients"].items(), spread, strict=True)
        ]
        tables.append(ReportTable("The iron that they share", ("", "Value"), tuple(iron)))
    return tables


def _record_coefficients(entry: Mapping[str, Any]) -> list[str]:
    if not entry["coefficients"]:
        return [words.UNKNOWN] * 4
    return [words.with_sigma(entry["coefficients"][k], entry["sigma"][k], "") for k in "BCDE"]


def _probability(value: float | None) -> str:
    return words.UNKNOWN if value is None else words.percent(value)


def _compass_cells(name: str, content: Mapping[str, Any], diagnosis: Mapping[str, Any]) -> tuple[str, ...]:
    effects = ", ".join(words.plain(entry["effect"]) for entry in diagnosis["findings"])
    odd = ", ".join(entry["name"] for entry in content["rejected"])
    return (name, diagnosis["verdict"], str(len(content["deployments"])), odd, _iron_between(content), effects)
