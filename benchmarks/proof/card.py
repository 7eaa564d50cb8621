"""Writes the scorecard: as JSON, as Markdown, and as one page that needs nothing else."""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.proof import recordings, score, tally

TOOLS = {
    "this pipeline": None,
    "always says unexplained": score.always_unexplained,
    "always lists the whole catalogue": score.whole_catalogue,
    "knows the truth": score.perfect,
}
DEFINITIONS = (
    "Visible size: rms of what five coefficients, fitted to the true headings, leave of an effect. "
    "Oracle: those five coefficients with every effect known; what is left is the compass's own noise. "
    "Five: the same without the effects known. Before: the configured fit alone, on the right branch. After: the "
    "product. Sampled: what the configured fit, made again, leaves where every effect but a wrong clock was taken out "
    "of readings and water. Oracle and five know the true headings; who has only the other instrument's currents can "
    "at best come near sampled, the error that the water's own scatter makes. "
    "Gain: variance that held-out days gave back over the planted one. Points: 1 for what a perfect tool "
    "says, 1/n for a right name in a set of n, 0 for what is wrong."
)
Table = tuple[str, list[str], list[list[str]]]


def content(
    sealed: dict[str, Any],
    truths: Sequence[dict[str, Any]],
    rows: Sequence[dict[str, Any]],
    paper: dict[str, Any] | None,
    concealed: Sequence[list[str]],
) -> dict[str, Any]:
    """Return all that the card says.

    Args:
        truths: of all moorings.
        paper: the case of the paper, where it was run.
        concealed: real recordings with an effect concealed.
    """
    ours = sum(row["points"] for row in rows) / len(rows)
    points = {name: ours if tool is None else score.mean_points(truths, tool) for name, tool in TOOLS.items()}
    return {
        "seal": {key: sealed[key] for key in ("seed", "count", "hours", "code", "sha256")},
        "points": points,
        "measures": tally.measures(rows),
        "numbers": tally.numbers(rows),
        "power": tally.power(rows),
        "confusion": tally.confusion(rows),
        "published": paper,
        "recordings": list(concealed),
        "moorings": list(rows),
    }


def write(out: Path, made: dict[str, Any]) -> None:
    """Write scorecard.json, .md and .html."""
    out.mkdir(parents=True, exist_ok=True)
    (out / "scorecard.json").write_text(json.dumps(made, indent=1) + "\n")
    tables = [table for table in _tables(made) if table[2]]
    (out / "scorecard.md").write_text("\n\n".join([_heading(made), DEFINITIONS, *map(_markdown, tables)]) + "\n")
    (out / "scorecard.html").write_text(_page(out / "figures", made, tables))


def jobs(cruise: Path) -> dict[str, float]:
    """Return the seconds that each rule took, all moorings together."""
    total: dict[str, float] = {}
    for path in sorted(cruise.glob("results/*/benchmarks/*.tsv")):
        rule = path.stem.removesuffix("_top").removesuffix("_deep")
        total[rule] = round(total.get(rule, 0.0) + float(path.read_text().splitlines()[1].split()[0]), 2)
    return total


def _heading(made: dict[str, Any]) -> str:
    seal = made["seal"]
    title = f"# Sealed proof, seed {seal['seed']}, {seal['count']} moorings of {seal['hours']} hours"
    return f"{title}\n\nTruth sealed as {seal['sha256']}, before {seal['code']} ran."


def _tables(made: dict[str, Any]) -> list[Table]:
    of_headings = ["moorings", "n", *tally.HEADINGS, "after ≤ sampled + 0.3°", "after ≤ oracle + 0.3°"]
    of_headings += ["within stated 95 %"]
    of_moorings = ["mooring", "kind", "planted (visible)", "named", "unexplained", "outcome", "points"]
    of_moorings += ["heading before, after, sampled, oracle", "why not named"]
    named = [[name, ", ".join(f"{x} {n}" for x, n in said.items())] for name, said in made["confusion"].items()]
    return [
        ("Points", ["tool", "points"], [[name, f"{value:.2f}"] for name, value in made["points"].items()]),
        ("Shares", ["measure", "share", "95 % interval"], [_share(one) for one in made["measures"]]),
        ("Numbers", ["measure", "value"], _numbers(made["numbers"])),
        ("Errors of the heading, rms", of_headings, _headings(made["numbers"]["headings"])),
        ("Single effects by visible size", ["visible", "n", "seen", "named"], [_size(one) for one in made["power"]]),
        ("What was named first", ["planted", "said"], named),
        ("The case of the paper, fitted by its method", ["measure", "value"], _paper(made["published"])),
        ("Real recordings with an effect concealed", list(recordings.COLUMNS), made["recordings"]),
        ("Every mooring", of_moorings, [_mooring(row) for row in made["moorings"]]),
    ]


def _size(one: dict[str, Any]) -> list[str]:
    return [f"{one['from_deg']:g} to {one['to_deg']:g}°", *(str(one[key]) for key in ("count", "seen", "named"))]


def _share(one: dict[str, Any]) -> list[str]:
    low, high = (100.0 * x for x in one["interval"])
    hits, count = one["hits"], one["count"]
    return [one["what"], f"{hits} of {count} ({100.0 * hits / count:.0f} %)", f"{low:.0f} to {high:.0f} %"]


def _numbers(found: dict[str, Any]) -> list[list[str]]:
    z, clocks, dates, gain = found["z"], found["z_clocks"], found["dates"], found["gain"]
    table = [
        ["names in a set, mean", _text(found["names_in_a_set"])],
        [f"errors of parameters in their own σ, clocks apart, rms (n = {z['count']})", _text(z["rms"])],
        ["the same, share within 1.96", _text(z["within_196"])],
        [f"the same of clocks, rms (n = {clocks['count']})", _text(clocks["rms"])],
        [f"dates of steps, median error, days (n = {dates['count']})", _text(dates["median_d"])],
        ["the same, largest", _text(dates["largest_d"])],
        [f"held-out gain over the planted variance, median (n = {gain['count']})", _text(gain["median"])],
    ]
    return [line for line in table if line[1] != "–"]


def _headings(groups: dict[str, dict[str, Any]]) -> list[list[str]]:
    keys, shares = [f"{key}_deg" for key in tally.HEADINGS], ("near_sampled", "near_oracle", "covered_95")
    return [
        [name, str(one["count"]), *(f"{one[key]:.2f}°" for key in keys), *(_percent(one[key]) for key in shares)]
        for name, one in groups.items()
        if one["count"]
    ]  # fmt: skip


def _paper(paper: dict[str, Any] | None) -> list[list[str]]:
    if paper is None:
        return []
    found, series = paper["found"], paper["series"]
    lost, still = 1.0 - series["share_corrected"], 1.0 - found["share_corrected"]
    recovered = "none was discarded" if lost <= 0.0 else _percent(max(0.0, 1.0 - still / lost))
    return [
        ["verdict", found["verdict"]],
        ["effects", ", ".join(found["effects"]) or "none"],
        ["share corrected by the published series alone (published: 87 %)", _percent(series["share_corrected"])],
        ["share corrected with what was found applied", _percent(found["share_corrected"])],
        ["of the headings that the series discards, recovered", recovered],
        ["true error of the heading by the series alone, rms, median", _errors(series)],
        ["the same with what was found applied", _errors(found)],
    ]


def _errors(one: dict[str, Any]) -> str:
    return f"{_text(one['after_deg'])}°, {_text(one['median_deg'])}°"


def _mooring(row: dict[str, Any]) -> list[str]:
    planted = ", ".join(f"{n} {v:.1f}°" for n, v in zip(row["truth"], row["visible_deg"], strict=True)) or "–"
    named = "; ".join(" or ".join(one) for one in row["sets"]) or "–"
    left = "–" if row["unexplained"] is None else f"{row['unexplained'][1]:.1f}° {row['unexplained'][0]}"
    errors = ", ".join(_text(row[key]) for key in ("before_deg", "after_deg", "sampled_deg", "oracle_deg"))
    kind = f"{row['kind']}, {'wide' if row['wide'] else 'narrow'}"
    return [row["name"], kind, planted, named, left, row["outcome"], _text(row["points"]), errors, row["why"] or "–"]


def _text(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"


def _percent(value: float | None) -> str:
    return "–" if value is None else f"{100.0 * value:.0f} %"


def _markdown(table: Table) -> str:
    title, head, rows = table
    lines = [f"## {title}", "", "| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows])


def _page(figures: Path, made: dict[str, Any], tables: Sequence[Table]) -> str:
    title, sealed = _heading(made).removeprefix("# ").split("\n\n")
    images = [base64.b64encode(path.read_bytes()).decode() for path in sorted(figures.glob("*.png"))]
    parts = [f"<h1>{html.escape(title)}</h1><p>{html.escape(sealed)}</p><p>{html.escape(DEFINITIONS)}</p>"]
    parts += [f'<p><img alt="figure" src="data:image/png;base64,{image}"></p>' for image in images]
    parts += [_html(table) for table in tables]
    style = "body{font:15px sans-serif;max-width:75em;margin:2em auto}table{border-collapse:collapse}"
    style += "td,th{border-bottom:1px solid #ccc;padding:.2em .6em;text-align:left;vertical-align:top}img{width:48em}"
    begin = f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{html.escape(title)}</title>'
    return f"{begin}<style>{style}</style><body>{''.join(parts)}</body></html>\n"


def _html(table: Table) -> str:
    title, head, rows = table
    top = "".join(f"<th>{html.escape(one)}</th>" for one in head)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<h2>{html.escape(title)}</h2><table><tr>{top}</tr>{body}</table>"
