"""The measured numbers on README and pages, written from the files that the measurements left.

    python benchmarks/numbers_of_pages.py NAME SCRIPT ...   runs a benchmark and keeps the tables that it prints
    python benchmarks/numbers_of_pages.py                   writes the marked parts of the pages anew

A part between ``<!-- numbers: NAME -->`` and ``<!-- /numbers -->`` gives the command, the version and the date, and
says where the engine has changed since. Tables are kept in ``docs/background/measured.json``.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable, Sequence
from datetime import UTC, date, datetime
from functools import partial
from pathlib import Path
from typing import Any

PROJECT = Path(__file__).resolve().parents[1]
sys.path.append(str(PROJECT))

import targets  # noqa: E402

from benchmarks.proof import standing  # noqa: E402
from compasslib import __version__  # noqa: E402

MEASURED = PROJECT / "docs/background/measured.json"
PAGES = (PROJECT / "README.md", *sorted((PROJECT / "docs").glob("*.md")), *sorted((PROJECT / "docs").glob("*/*.md")))
CARD = PROJECT / "docs/proof/seed-3574276947"  # of record
POWER, MEASURES = PROJECT / "docs/proof/power.json", ("detected", "driver", "effect")
WATERS = {
    "eh2": "real: eh2",
    "papa": "real: papa",
    "aqd9330": "real, unseen, stand-in reference: aqd9330",
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


def keep(name: str, command: Sequence[str]) -> int:
    """Run a benchmark and keep the tables that it prints; return its exit status, 1 where it misses a target."""
    ran = subprocess.run([sys.executable, *command], stdout=subprocess.PIPE, text=True, check=False, cwd=PROJECT)
    print(ran.stdout)
    tables = re.findall(r"^\|.*\|\n\|[-|]+\|\n(?:\|.*\|\n?)*", ran.stdout, re.MULTILINE)
    if not tables:
        sys.exit(f"{' '.join(command)}: expected tables, found none; nothing is kept")
    kept = json.loads(MEASURED.read_text())
    shown = re.sub(r" (/\S+)", " CRUISE", re.sub(r" --\S+ /\S+", "", " ".join(command)))
    kept[name] = {
        "command": shown,
        "version": __version__,
        "commit": standing.commit()[: standing.DIGITS],
        "engine": standing.engine(),
        "date": datetime.now(UTC).date().isoformat(),
        "tables": [table.strip().splitlines() for table in tables],
    }
    MEASURED.write_text(json.dumps(kept, indent=1, ensure_ascii=False, sort_keys=True) + "\n")
    return ran.returncode


def table(rows: Sequence[Sequence[str]], head: Sequence[str] = HEADINGS) -> str:
    """Write rows as a table in Markdown."""
    lines = [f"| {' | '.join(cells)} |" for cells in (head, *rows)]
    return "\n".join([lines[0], "|---" * len(head) + "|", *lines[1:]])


def measured(kept: dict[str, Any]) -> str:
    """Report by which version and when something was measured, and whether its engine has changed since."""
    day = date.fromisoformat(kept["date"])
    older = ", an older engine" if standing.is_older(kept["engine"]) else ""
    commit = f" ({kept['commit']})" if kept["commit"] else ""
    return f"version {kept['version']}{commit}{older}, {day.day} {day:%B %Y}"


def rows_of(kept: dict[str, Any]) -> list[list[str]]:
    """Return the rows of the first table of a measurement."""
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in kept["tables"][0][2:]]


def product() -> str:
    """The product's headings beside the published method, for README."""
    kept = json.loads(MEASURED.read_text())
    column = HEADINGS.index
    after = column("rms after")
    published = {row[0]: row for row in rows_of(kept["products"]) if row[1] == BY_EYE}
    rows, inside = [], []
    for name, way, _, before, corrected, _, sigma, within, *_ in rows_of(kept["products"]):
        if way != BY_EYE:
            share = float(published[name][column("share corrected")].split()[0])
            part = f" ({share:.0f} %)" if share < 100.0 else ""
            rows.append([name + NOTES.get(name, ""), before, corrected, sigma, published[name][after] + part])
            inside.append(int(within.split()[0]))
    return (
        "Heading errors of the demonstration cruise, rms (`.venv/bin/python benchmarks/accuracy.py --product`:\n"
        f"{measured(kept['products'])}):\n\n"
        f"{table(rows, ('mooring', 'before', 'product', 'stated 1σ, rms', 'von Appen (2015)'))}\n\n"
        f"{min(inside)} to {max(inside)} % of the headings lie in their stated 95 % interval.\n"
    )


def tables_of(name: str, most: int | None = None) -> str:
    """Write the tables of one measurement, all or the first ones."""
    kept = json.loads(MEASURED.read_text())[name]
    tables = "\n\n".join("\n".join(lines) for lines in kept["tables"][:most])
    return f"`{kept['command']}`, {measured(kept)}:\n\n{tables}\n"


def goals(folder: str = "../proof/", *, missed_only: bool = False) -> str:
    """The goals of the sealed proof of record, all or those that are missed."""
    made = json.loads((CARD / "scorecard.json").read_text())
    some = [goal for goal in made["goals"] if goal["missed"] or not missed_only]
    figure = "" if missed_only else f"\n![True errors of headings]({folder}{CARD.name}/figures/headings.png)\n"
    return f"[Scorecard]({folder}{CARD.name}/scorecard.md) of {_moorings(made)}:\n\n{_goals(some)}\n{figure}"


def _goals(some: Sequence[dict[str, Any]]) -> str:
    rows = [[goal["what"], goal["value"], goal["target"] + ", missed" * goal["missed"]] for goal in some]
    return table(rows, ("measure", "value (95 % interval)", "wanted"))


def _moorings(made: dict[str, Any]) -> str:
    seal = made["seal"]
    older = ", of an older engine" if standing.is_older(seal["engine"]) else ""
    return f"{seal['count'] + seal['real']} moorings{older}"


def power() -> str:
    """The power of the search over all moorings with a cause, and how often it accuses a sound compass."""
    made = json.loads(POWER.read_text())
    rows = []
    for record, one in made["all"].items():
        rows.append([WATERS.get(record, record), *(targets.text_of(one[what], one["n"]) for what in MEASURES)])
    total = {key: sum(one[key] for one in made["all"].values()) for key in ("n", *MEASURES)}
    rows.insert(0, ["all", *(targets.text_of(total[what], total["n"]) for what in MEASURES)])
    for water, one in made["no_cause"].items():
        rows.append([f"no cause, {water}: falsely", *(targets.text_of(one[what], one["n"]) for what in MEASURES)])
    head = ("water", "fault of the compass detected", "driver named", "effect named")
    return f"`{made['command']}`, commit {made['commit']}:\n\n{table(rows, head)}\n"


def headline() -> str:
    """The power of the search in a sentence, over all moorings: real water, unseen, and stand-ins too."""
    made = json.loads(POWER.read_text())
    (n, *named), (sound, *false) = (
        [sum(one[key] for one in made[part].values()) for key in ("n", *MEASURES)] for part in ("all", "no_cause")
    )
    real, stand_in = n - made["all"]["simulated"]["n"], made["all"]["aqd9330"]["n"]
    shares = [targets.text_of(hits, n).replace(f" of {n}", "") for hits in named]
    return (
        f"Of {n} moorings with a concealed cause, {real} of them in real water ({stand_in} unseen, with a stand-in\n"
        f"reference), a fault was detected in {shares[0]}, its driver named in {shares[1]}, its\n"
        f"effect in {shares[2]}. Of {sound} without a cause {false[0]} were suspected, {false[1]} wrongly named.\n"
    )


PARTS: dict[str, Callable[[], str]] = {
    "headline": headline,
    "power": power,
    "product": product,
    "goals": goals,
    "missed": partial(goals, "", missed_only=True),
    "second": partial(tables_of, "second", 1),
}


def filled(page: Path) -> str:
    """Return a page with its marked parts written anew."""
    write = lambda name: PARTS[name]() if name in PARTS else tables_of(name)  # noqa: E731
    return _PART.sub(lambda part: part[1] + write(part[2]) + part[3], page.read_text())


if __name__ == "__main__":
    if sys.argv[2:]:
        sys.exit(keep(sys.argv[1], sys.argv[2:]))
    for page in PAGES:
        page.write_text(filled(page))
