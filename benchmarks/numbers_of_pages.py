"""The measured numbers on README and pages, written from the files that the measurements kept.

    python benchmarks/numbers_of_pages.py     writes the marked parts of the pages anew

A part stands between ``<!-- numbers: NAME -->`` and ``<!-- /numbers -->``. It says by which version and when it was
measured, and where the engine has changed since. A test holds the pages against the files.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Sequence
from datetime import UTC, date, datetime
from functools import partial
from pathlib import Path
from typing import Any

PROJECT = Path(__file__).resolve().parents[1]
sys.path.append(str(PROJECT))

from benchmarks.proof import standing  # noqa: E402
from compasslib import __version__  # noqa: E402

ACCURACY = PROJECT / "docs/background/accuracy.json"
PAGES = (PROJECT / "README.md", PROJECT / "docs/background/accuracy.md")
CARD = PROJECT / "docs/proof/seed-524331592"  # of record
# Goals of the card, and how README calls them.
GOALS = {
    "nothing wrong with the compass: compass or clock named": "compass or clock named where nothing was wrong",
    "anything named: all that was planted is among the names": "all planted effects among the names",
    "nobody listed it: a bare name": "not in the catalogue: a listed name",
    "headings within their 95 %": "headings within 95 %",
}
BY_EYE = "von_appen, as an author would"  # fitted about the mean deviation, inverted where most pairs lie
HEADINGS = (
    *("mooring", "method", "share corrected", "rms before", "rms after", "median after", "stated 1σ", "within 95 %"),
    *("share sure", "rms where sure"),
)
# What README says of moorings beside their names.
TWICE = ", two pairs a day"
NOTES = {"EG4": ", two-valued", "EG5": TWICE, "EG6": f"{TWICE}, two-valued", "EG7": TWICE}
_PART = re.compile(r"(<!-- numbers: (\S+) -->\n).*?(<!-- /numbers -->)", re.DOTALL)


def keep(name: str, rows: list[list[str]]) -> None:
    """Write the rows of one measurement, with the version and the engine that they are of."""
    kept = json.loads(ACCURACY.read_text()) if ACCURACY.exists() else {}
    today = datetime.now(UTC).date().isoformat()
    kept[name] = {"version": __version__, "engine": standing.engine(), "date": today, "rows": rows}
    ACCURACY.write_text(json.dumps(kept, indent=1, ensure_ascii=False) + "\n")


def table(rows: Sequence[Sequence[str]], head: Sequence[str] = HEADINGS) -> str:
    """Write rows as a table in Markdown."""
    lines = [f"| {' | '.join(cells)} |" for cells in (head, *rows)]
    return "\n".join([lines[0], "|---" * len(head) + "|", *lines[1:]])


def measured(kept: dict[str, Any]) -> str:
    """Say by which version and when something was measured, and whether its engine has changed since."""
    day = date.fromisoformat(kept["date"])
    older = "" if kept["engine"] == standing.engine() else ", an older engine"
    return f"version {kept['version']}{older}, {day.day} {day:%B %Y}"


def product() -> str:
    """The product's headings beside the published method, for README."""
    kept = json.loads(ACCURACY.read_text())
    after = HEADINGS.index("rms after")
    published = {row[0]: row for row in kept["methods"]["rows"] if row[1] == BY_EYE}
    rows, inside = [], []
    for name, _, _, before, corrected, _, sigma, within, *_ in kept["product"]["rows"]:
        if name in published:
            share = float(published[name][HEADINGS.index("share corrected")].split()[0])
            part = f" ({share:.0f} %)" if share < 100.0 else ""
            rows.append([name + NOTES.get(name, ""), before, corrected, sigma, published[name][after] + part])
            inside.append(int(within.split()[0]))
    older = ", an older engine" * (kept["methods"]["engine"] != kept["product"]["engine"])
    return (
        "Heading errors of the demonstration cruise, rms (`.venv/bin/python benchmarks/accuracy.py --product`:\n"
        f"{measured(kept['product'])}):\n\n"
        f"{table(rows, ('mooring', 'before', 'product', 'stated 1σ, rms', f'von Appen (2015){older}'))}\n\n"
        f"{min(inside)} to {max(inside)} % of the headings lie in their stated 95 % interval.\n"
    )


def all_rows(name: str) -> str:
    """Every row of one measurement of the demonstration cruise's headings."""
    kept = json.loads(ACCURACY.read_text())[name]
    return f"By {measured(kept)}:\n\n{table(kept['rows'])}\n"


def card() -> str:
    """Some goals of the sealed proof of record, for README."""
    made = json.loads((CARD / "scorecard.json").read_text())
    seal, goals = made["seal"], {goal["what"]: goal for goal in made["goals"]}
    older = "" if seal["engine"] == standing.engine() else ", of an older engine"
    said = [
        f"{name}: {goals[what]['value']}; wanted: {goals[what]['target']}{', missed' * goals[what]['missed']}"
        for what, name in GOALS.items()
    ]
    moorings = f"{seal['count'] + seal['real']} moorings{older}"
    return (
        "Effects planted in water that the search was not built on "
        f"([scorecard](docs/proof/{CARD.name}/scorecard.md) of\n{moorings}; "
        "[known misses](docs/proof/known-misses.md)):\n\n" + "".join(f"* {line}\n" for line in said)
    )


PARTS = {
    "card": card,
    "product": product,
    "methods": partial(all_rows, "methods"),
    "products": partial(all_rows, "product"),
}


def filled(page: Path) -> str:
    """Return a page with its marked parts written anew."""
    return _PART.sub(lambda part: part[1] + PARTS[part[2]]() + part[3], page.read_text())


if __name__ == "__main__":
    for page in PAGES:
        page.write_text(filled(page))
