"""Write the scorecard as JSON, its tables as CSV, and a Markdown page that shows them with the figures."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks import targets
from benchmarks.proof import tally

DEFINITIONS = (
    "No fault: nothing is wrong with the compass; its current may be named. Listed effects stand in the catalogue, "
    "unlisted ones do not. Visible size: rms of what remains of an effect after five coefficients are fitted to the "
    "true headings. Score: 1 for the diagnosis of a tool that knows the truth, 1/n for a correct name in a set of n, 0 "
    "for what is wrong or refused; a composed effect counts as the listed one with the same action and driver. Fit: "
    "the configured fit alone, on the correct branch. Product: corrected.nc. Published: von Appen's series on the same "
    "pairs, where it gives a heading. Five: five coefficients fitted to the true headings. Oracle: the same with every "
    "effect known, so that the noise of the compass remains. Sampled: the configured fit, repeated on pairs from which "
    "every effect but a wrong clock was taken out, so that the scatter of the current remains. Brackets are 95 % "
    "intervals: Clopper and Pearson's of rates, else by resampling the moorings."
)
NOT_SHOWN = ("Every mooring",)  # on the page: it is long
Table = tuple[str, list[str], list[list[str]]]


def write(out: Path, made: dict[str, Any]) -> None:
    """Write scorecard.json, scorecard.md and a CSV file for each of its tables."""
    out.mkdir(parents=True, exist_ok=True)
    (out / "scorecard.json").write_text(json.dumps(made, indent=1) + "\n")
    links, shown = [], []
    for title, head, rows in _tables(made):
        if rows:
            name = f"{title.partition(',')[0].lower().replace(' ', '_')}.csv"
            with (out / name).open("w", newline="", encoding="utf-8") as file:
                plain = [[cell.replace("> 0", "above 0") for cell in row] for row in rows]  # else a quotation
                csv.writer(file, lineterminator="\n").writerows([head, *plain])
            links.append(f"[{title}]({name})")
            if title not in NOT_SHOWN:
                shown.append(f"```{{csv-table}} {title}\n:file: {name}\n:header-rows: 1\n```")
    figures = [f"![{path.stem}](figures/{path.name})" for path in sorted((out / "figures").glob("*.png"))]
    parts = [_heading(made), DEFINITIONS, f"Tables: {', '.join(links)}.", shown[0], *figures, *shown[1:]]
    (out / "scorecard.md").write_text("\n\n".join(parts) + "\n")


def _heading(made: dict[str, Any]) -> str:
    seal = made["seal"]
    title = f"# Sealed proof, seed {seal['seed']}: {seal['count']} moorings in simulated water, {seal['real']} in real"
    sealed = f"Truth sealed as {seal['sha256']}, before the pipeline ran. Seed: {seal['seed_of']}. "
    sealed += f"Families of effects {seal['families']}. Commit {seal['commit']}. "
    sealed += f"Simulated records last {seal['hours']} hours; real ones: {', '.join(seal['records']) or 'none'}."
    return f"{title}\n\n{sealed}"


def _tables(made: dict[str, Any]) -> list[Table]:
    of_headings = ["moorings", "n", "fit", "product", *tally.HEADINGS[2:]]
    of_headings += ["product ≤ sampled + 0.3°", "worse than fit by 0.1°", "within 95 % interval"]
    of_moorings = ["mooring", "kind", "water", "planted (visible)", "named", "unexplained", "outcome", "score"]
    of_moorings += ["heading errors: fit, product, sampled, oracle", "why not named"]
    sizes, keys = ["visible", "water", "n", "detected", "named"], ("place", "count", "detected", "named")
    power = [[f"{x['from_deg']:g} to {x['to_deg']:g}°", *(str(x[key]) for key in keys)] for x in made["power"]]
    goals = [[x["what"], x["value"], f"{x['target']}{', MISSED' if x['missed'] else ''}"] for x in made["goals"]]
    rates = [[x["what"], *(targets.text_of(*x[place]) for place in tally.PLACES)] for x in made["measures"]]
    scores = ["probability of", "n", "base rate"]
    for rule in ("Brier score", "log score"):
        scores += [rule, "base rate's", "improvement"]
    return [
        ("Targets", ["measure", "value", "target"], goals),
        ("Scores", ["tool", *tally.PLACES, "this pipeline minus tool"], _points(made["points"])),
        ("Rates", ["measure", *tally.PLACES], rates),
        ("Scores of stated probabilities", scores, _scores(made["probabilities"])),
        ("Reliability of stated probabilities", ["probability of", "stated", "observed"], _came(made["probabilities"])),
        ("Errors of the heading, rms", of_headings, _headings(made["headings"])),
        ("Single effects by visible size", sizes, power),
        ("Every mooring", of_moorings, [_mooring(row) for row in made["moorings"]]),
    ]  # fmt: skip


def _points(tools: dict[str, Any]) -> list[list[str]]:
    return [
        [name, *(_text(one[place]) for place in tally.PLACES), _between(one["ahead"])] for name, one in tools.items()
    ]


def _scores(stated: dict[str, Any]) -> list[list[str]]:
    return [
        [what, str(one["count"]), _percent(one["share"]), *_rule(one["brier"]), *_rule(one["log"])]
        for what, one in stated.items()
        if one["count"]
    ]


def _rule(one: dict[str, Any]) -> list[str]:
    return [f"{one['own']:.3f}", f"{one['share']:.3f}", _between(one["better"])]


def _came(stated: dict[str, Any]) -> list[list[str]]:
    return [
        [what, f"{100.0 * each['stated']:.1f} %", targets.text_of(each["hits"], each["count"])]
        for what, one in stated.items()
        if one["count"]
        for each in one["bins"]
    ]


def _headings(groups: dict[str, dict[str, Any]]) -> list[list[str]]:
    keys, shares = [f"{key}_deg" for key in tally.HEADINGS], ("near_sampled", "worse", "covered_95")
    return [
        [name, str(one["count"]), *(f"{_text(one[key])}°" for key in keys), *(_percent(one[key]) for key in shares)]
        for name, one in groups.items()
        if one["count"]
    ]


def _mooring(row: dict[str, Any]) -> list[str]:
    planted = ", ".join(f"{n} {v:.1f}°" for n, v in zip(row["truth"], row["visible_deg"], strict=True)) or "–"
    named = "; ".join(" or ".join(one) for one in row["sets"]) or "–"
    left = "–" if row["unexplained"] is None else f"{row['unexplained'][1]:.1f}° {row['unexplained'][0]}"
    errors = ", ".join(_text(row[key]) for key in ("before_deg", "after_deg", "sampled_deg", "oracle_deg"))
    kind = f"{row['kind']}, {'wide' if row['wide'] else 'narrow'}"
    water = row["water"] if row["real"] or row["water"] == "made" else f"made of {row['water']}"
    told = [planted, named, left, row["outcome"], _text(row["points"]), errors, row["why"] or "–"]
    return [row["name"], kind, water, *told]


def _between(interval: Sequence[float] | None) -> str:
    return "{:+.3f} to {:+.3f}".format(*interval) if interval else "–"


def _text(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"


def _percent(value: float | None) -> str:
    return "–" if value is None else f"{100.0 * value:.0f} %"
