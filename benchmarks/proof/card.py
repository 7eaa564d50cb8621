"""Write the scorecard as JSON, its tables as CSV, its figures, and a Markdown page that shows them."""

import csv
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.ticker import FixedLocator, NullLocator

from benchmarks import targets
from benchmarks.proof import score, tally
from compasslib.plots.page import BLUE, GREY, WIDE_IN, create

DEFINITIONS = (
    "No fault: nothing is wrong with the compass; its current may be named. Listed effects stand in the catalogue, "
    "unlisted ones do not. Visible size: rms of what remains of an effect after five coefficients are fitted to the "
    "true headings. Score: 1 for the diagnosis of a tool that knows the truth, 1/n for a correct name in a set of n, 0 "
    "for what is wrong or refused; a composed effect counts as the listed one with the same action and driver. Every "
    "reference deviates: where this was not planted, naming `reference_deviation` is neither right nor wrong. Fit: "
    "the configured fit alone, on the correct branch. Product: corrected.nc. Published: von Appen's series on the same "
    "pairs, where it gives a heading. Five: five coefficients fitted to the true headings. Oracle: the same with every "
    "effect known, so that the noise of the compass remains. Sampled: the configured fit, repeated on pairs from which "
    "every effect but a wrong clock was taken out, so that the scatter of the current remains. Brackets are 95 % "
    "intervals: Clopper and Pearson's of rates, else by resampling the moorings."
)
NOT_SHOWN = ("Every mooring",)  # on the page: it is long
TICKS_DEG = (0.2, 0.5, 1, 2, 5, 10, 20, 50)
Table = tuple[list[str], list[list[str]]]


def write(out: Path, made: dict[str, Any]) -> None:
    """Write scorecard.json, scorecard.md, a CSV file for each of its tables, and the figures."""
    (out / "figures").mkdir(parents=True, exist_ok=True)
    (out / "scorecard.json").write_text(json.dumps(made, indent=1) + "\n")
    draw_headings(out / "figures/headings.png", made["moorings"])
    links, shown = [], []
    for title, (head, rows) in _tables(made).items():
        if rows:
            name = f"{title.partition(',')[0].lower().replace(' ', '_')}.csv"
            with (out / name).open("w", newline="", encoding="utf-8") as file:
                plain = [[cell.replace("> 0", "above 0") for cell in row] for row in rows]  # else a quotation
                csv.writer(file, lineterminator="\n").writerows([head, *plain])
            links.append(f"[{title}]({name})")
            if title not in NOT_SHOWN:
                shown.append(f"```{{csv-table}} {title}\n:file: {name}\n:header-rows: 1\n```")
    figures = [f"![{path.stem}](figures/{path.name})" for path in sorted((out / "figures").glob("*.png"))]
    seal = made["seal"]
    parts = [
        f"# Sealed proof, seed {seal['seed']}: {seal['count']} moorings in simulated water, {seal['real']} in real",
        f"Truth sealed as {seal['sha256']}, before the pipeline ran. Seed: {seal['seed_of']}. Families of effects "
        f"{seal['families']}. Commit {seal['commit']}. Simulated records last {seal['hours']} hours; real ones: "
        f"{', '.join(seal['records']) or 'none'}.",
        *(DEFINITIONS, f"Tables: {', '.join(links)}.", shown[0], *figures, *shown[1:]),
    ]
    (out / "scorecard.md").write_text("\n\n".join(parts) + "\n")


def _tables(made: dict[str, Any]) -> dict[str, Table]:
    """Compose the tables, each by its title from its head and rows."""
    stated = {what: one for what, one in made["probabilities"].items() if one["count"]}
    rules = ("brier", "log")
    scores = [
        [what, str(one["count"]), _percent(one["share"]), *(cell for rule in rules for cell in _rule(one[rule]))]
        for what, one in stated.items()
    ]
    came = [
        [what, f"{100.0 * each['stated']:.1f} %", targets.text_of(each["hits"], each["count"])]
        for what, one in stated.items()
        for each in one["bins"]
    ]
    errors = [
        [
            *(name, str(one["count"]), *(f"{_text(one[f'{key}_deg'])}°" for key in tally.HEADINGS)),
            *(_percent(one[key]) for key in ("near_sampled", "worse", "covered_95")),
        ]
        for name, one in made["headings"].items()
        if one["count"]
    ]
    points = [
        [name, *(_text(one[place]) for place in tally.PLACES), _between(one["ahead"])]
        for name, one in made["points"].items()
    ]
    goals = [[x["what"], x["value"], f"{x['target']}{', MISSED' if x['missed'] else ''}"] for x in made["goals"]]
    rates = [[x["what"], *(targets.text_of(*x[place]) for place in tally.PLACES)] for x in made["measures"]]
    of_scores = ["probability of", "n", "base rate", "Brier score", "base rate's", "improvement", "log score"]
    of_errors = ["moorings", "n", "fit", "product", *tally.HEADINGS[2:], "product ≤ sampled + 0.3°"]
    of_moorings = ["mooring", "kind", "water", "planted (visible)", "named", "unexplained", "outcome", "score"]
    of_moorings += ["heading errors: fit, product, sampled, oracle"]
    return {
        "Targets": (["measure", "value", "target"], goals),
        "Scores": (["tool", *tally.PLACES, "this pipeline minus tool"], points),
        "Rates": (["measure", *tally.PLACES], rates),
        "Scores of stated probabilities": ([*of_scores, "base rate's", "improvement"], scores),
        "Reliability of stated probabilities": (["probability of", "stated", "observed"], came),
        "Errors of the heading, rms": ([*of_errors, "worse than fit by 0.1°", "within 95 % interval"], errors),
        "Every mooring": (of_moorings, [_mooring(row) for row in made["moorings"]]),
    }


def _mooring(row: dict[str, Any]) -> list[str]:
    planted = ", ".join(f"{n} {v:.1f}°" for n, v in zip(row["truth"], row["visible_deg"], strict=True)) or "–"
    named = "; ".join(" or ".join(one) for one in row["reported"]) or "–"
    left = "–" if row["unexplained"] is None else f"{row['unexplained'][1]:.1f}° {row['unexplained'][0]}"
    errors = ", ".join(_text(row[key]) for key in ("before_deg", "after_deg", "sampled_deg", "oracle_deg"))
    kind = f"{row['kind']}, {'wide' if row['wide'] else 'narrow'}"
    water = row["water"] if row["real"] or row["water"] == "made" else f"made of {row['water']}"
    told = [planted, named, left, row["outcome"], _text(row["points"]), errors]
    return [row["name"], kind, water, *told]


def _rule(one: dict[str, Any]) -> list[str]:
    return [f"{one['own']:.3f}", f"{one['share']:.3f}", _between(one["better"])]


def _between(interval: Sequence[float] | None) -> str:
    return "{:+.3f} to {:+.3f}".format(*interval) if interval else "–"


def _text(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"


def _percent(value: float | None) -> str:
    return "–" if value is None else f"{100.0 * value:.0f} %"


def draw_headings(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Draw the rms heading error of the product against that of the fit for every mooring."""
    title = "True error of the heading, rms, a dot for each mooring\n"
    title += "Below the line the product is better than the fit."
    groups = {"No fault": score.QUIET, "Listed effects": score.KNOWN, "Unlisted effects": ("strange",)}
    with create(path, 2.9, width_in=WIDE_IN, title=title) as figure:
        panels = figure.subplots(1, len(groups), sharex=True, sharey=True)
        for axes, (what, kinds) in zip(panels, groups.items(), strict=True):
            some = [row for row in rows if row["kind"] in kinds and row["before_deg"] and row["after_deg"]]
            axes.axline((1.0, 1.0), (2.0, 2.0), color=GREY, linewidth=0.6)
            axes.plot([row["before_deg"] for row in some], [row["after_deg"] for row in some], "o", color=BLUE,
                      markersize=3, alpha=0.5, markeredgewidth=0.0)  # fmt: skip
            axes.set(xscale="log", yscale="log", title=f"{what}, n = {len(some)}", xlabel="Fit (°)")
            for axis in (axes.xaxis, axes.yaxis):
                axis.set_major_locator(FixedLocator(TICKS_DEG))
                axis.set_major_formatter("{x:g}")
                axis.set_minor_locator(NullLocator())
        panels[0].set_ylabel("Product (°)")
