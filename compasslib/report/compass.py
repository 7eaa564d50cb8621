"""The section of a compass that several records share."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from compasslib.archive import netcdf
from compasslib.report import answer, figures, found, words
from compasslib.report.section import ReportSection, ReportTable

CAPTION = "All compasses that several records share"
HEADER = ("Name", "Verdict", "Records", "Not the same", "Iron between deployments", "Effects")
FILES = ("compass.json", "diagnosis.json", "figures", "logs")
CAPTIONS: Mapping[str, Callable[[], str]] = {
    "coefficients": lambda: "What each record shows of the iron, with its 95 % interval, beside what the compass has.",
    "curve": lambda: "Deviation by correct heading: each record's, and the compass's in the mean field, 95 % band.",
}
UNITS = {"P_nT": "nT", "Q_nT": "nT"}


def section(name: str, root: Path, *, small: bool) -> ReportSection:
    """Return one compass's section.

    Args:
        small: whether the page has too many sections for whole pictures.

    Raises:
        InputError: a file of its results is absent or damaged.
    """
    folder = root / "compasses" / name
    content, diagnosis = netcdf.read_json(folder / "compass.json"), netcdf.read_json(folder / "diagnosis.json")
    drawn = figures.of_folder(folder, root, CAPTIONS, small=small)
    return ReportSection(
        name=name,
        anchor=f"compass-{name}",
        verdict=diagnosis["verdict"],
        summary=(_first(content, diagnosis), words.sentence(diagnosis["why"])),
        facts=(("iron that varies between deployments", _between(content)),),
        findings=found.findings(diagnosis, product=False),
        cannot_tell=found.cannot_tell(diagnosis),
        warnings=tuple(f"{one['name']}: {words.sentence(one['why'])}" for one in content["rejected"]),
        tables=tuple(_tables(content)),
        first=tuple(drawn.values()),
        links=tuple((file, figures.relative(folder / file, root)) for file in FILES if (folder / file).exists()),
        cells=_cells(name, content, diagnosis),
    )


def carried(fit: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the sentence on whose data carry a mooring's compass, none where only its own do.

    Args:
        fit: content of deviation.json.
    """
    shared = fit.get("shared")
    return (words.sentence(shared["text"]),) if shared else ()


def _first(content: Mapping[str, Any], diagnosis: Mapping[str, Any]) -> str:
    """Return the answer in a sentence: whose records they are, who does not belong, what they share."""
    kept = [one["name"] for one in content["deployments"] if one["fits"]]
    records = f"{words.plural(len(content['deployments']), 'record')}, of one compass: {words.listed(kept) or 'none'}"
    odd = [one["name"] for one in content["rejected"]]
    return f"{records}{f'; not the same: {words.listed(odd)}' * bool(odd)}; {answer.what_was_found(diagnosis)}."


def _between(content: Mapping[str, Any]) -> str:
    size = content["sigma_between"]
    return "unknown" if size is None else f"{words.number(size, 0)} nT in each direction (1σ)"


def _tables(content: Mapping[str, Any]) -> list[ReportTable]:
    header = ("Record", "B", "C", "D", "E", "Probability that it is this compass")
    rows = [(one["name"], *_letters(one), _probability(one["probability_same"])) for one in content["deployments"]]
    tables = [ReportTable("What each record tells alone", header, tuple(rows))]
    if content["coefficients"]:
        spread = [row[k] ** 0.5 for k, row in enumerate(content["covariance"])]
        iron = [
            (name.removesuffix("_nT"), words.with_sigma(value, sigma, f" {UNITS[name]}" if name in UNITS else ""))
            for (name, value), sigma in zip(content["coefficients"].items(), spread, strict=True)
        ]
        tables.append(ReportTable("The iron that they share", ("", "Value"), tuple(iron)))
    return tables


def _letters(one: Mapping[str, Any]) -> list[str]:
    if not one["coefficients"]:
        return [words.UNKNOWN] * 4
    return [words.with_sigma(one["coefficients"][k], one["sigma"][k], "") for k in "BCDE"]


def _probability(value: float | None) -> str:
    return words.UNKNOWN if value is None else words.percent(value)


def _cells(name: str, content: Mapping[str, Any], diagnosis: Mapping[str, Any]) -> tuple[str, ...]:
    effects = ", ".join(words.plain(one["effect"]) for one in diagnosis["findings"])
    odd = ", ".join(one["name"] for one in content["rejected"])
    return (name, diagnosis["verdict"], str(len(content["deployments"])), odd, _between(content), effects)
