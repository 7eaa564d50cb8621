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
from pathlib import Path
from typing import Any

PROJECT = Path(__file__).resolve().parents[1]
sys.path.append(str(PROJECT))

from benchmarks.proof import standing  # noqa: E402
from compasslib import __version__  # noqa: E402

MEASURED = PROJECT / "docs/background/measured.json"
PAGES = (PROJECT / "README.md", *sorted((PROJECT / "docs").glob("*.md")), *sorted((PROJECT / "docs").glob("*/*.md")))
CARD = PROJECT / "docs/proof/seed-3574276947"  # of record
# Goals of the card that README gives, by what they begin with.
GOALS = (
    *("no fault: attributed", "all: diagnosis", "effects stated at", "all: headings worsened"),
    "headings within their 95 % interval: all",
)
BY_EYE = "von_appen, as an author would"  # fitted about the mean deviation, inverted where most pairs lie
HEADINGS = (
    *("mooring", "method", "share corrected", "rms before", "rms after", "median after", "stated 1σ", "within 95 %"),
    *("share sure", "rms where sure"),
)
# Columns of stored tables that no page shows.
DROPPED = {
    *("method", "share corrected", "median after", "rms where sure", "cells", "filled within the gaps", "made up"),
    *("CPU s a year", "stated / real rms", "worst", "A off, over its σ, rms"),
}
LEFT_OUT = {"eh2": (1,)}  # tables that no page shows, by measurement
# Measures of real water without a fault.
NULLS = (
    *("attributed to compass or clock", "P(compass) + P(clock) at least 1/2", "unexplained"),
    "rms error in degrees: recorded, published method, fit, product, best five coefficients",
    *("worse than the fit by over 0.1 degree", "headings within 95 %; the same without their mean error"),
)
WATERS = ("eh2", "papa", "aqd9330", "all")  # real records of the water
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


def rows_of(kept: dict[str, Any], which: int = 0) -> list[list[str]]:
    """Return the rows of one table of a measurement."""
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in kept["tables"][which][2:]]


def product() -> str:
    """The product's headings beside the published method, for README."""
    kept = json.loads(MEASURED.read_text())
    column = HEADINGS.index
    after = column("rms after")
    published = {row[0]: row for row in rows_of(kept["methods"]) if row[1] == BY_EYE}
    rows, inside = [], []
    for name, _, _, before, corrected, _, sigma, within, *_ in rows_of(kept["products"]):
        if name in published:
            share = float(published[name][column("share corrected")].split()[0])
            part = f" ({share:.0f} %)" if share < 100.0 else ""
            rows.append([name + NOTES.get(name, ""), before, corrected, sigma, published[name][after] + part])
            inside.append(int(within.split()[0]))
    older = ", an older engine" * (kept["methods"]["engine"] != kept["products"]["engine"])
    untouched, weak, strong = rows_of(kept["eh2"])
    return (
        "Heading errors of the demonstration cruise, rms (`.venv/bin/python benchmarks/accuracy.py --product`:\n"
        f"{measured(kept['products'])}):\n\n"
        f"{table(rows, ('mooring', 'before', 'product', 'stated 1σ, rms', f'von Appen (2015){older}'))}\n\n"
        f"{min(inside)} to {max(inside)} % of the headings lie in their stated 95 % interval.\n\n"
        "On a real record (eh2) re-read by a compass near iron the error falls from "
        f"{weak[column('rms before')]} to {weak[after]},\nnear iron of 1.3 times the earth's field from "
        f"{strong[column('rms before')]} to {strong[after]}; without iron it is {untouched[after]}.\n"
    )


def tables_of(name: str) -> str:
    """Write the tables of one measurement, without the columns that no page needs."""
    kept = json.loads(MEASURED.read_text())[name]
    parts = [_measured_by(kept)]
    for which, lines in enumerate(kept["tables"]):
        if which in LEFT_OUT.get(name, ()):
            continue
        head = [cell.strip() for cell in lines[0].strip("|").split("|")]
        shown = [column for column, title in enumerate(head) if title not in DROPPED]
        rows = [[row[column] for column in shown] for row in rows_of(kept, which)]
        parts.append(table(rows, [head[column] for column in shown]))
    return "\n\n".join(parts) + "\n"


def _measured_by(kept: dict[str, Any]) -> str:
    return f"`{kept['command']}`, {measured(kept)}:"


def methods() -> str:
    """The errors of the product beside those of the fit alone and of the published method, per mooring."""
    kept = json.loads(MEASURED.read_text())
    column = HEADINGS.index
    after, share = column("rms after"), column("share corrected")
    known = {(row[0], row[1]): row for row in rows_of(kept["methods"])}
    head = ("mooring", "recorded", "`exact` alone", "product", "stated 1σ", "within 95 %", "`von_appen`", "by eye")
    rows = []
    for row in rows_of(kept["products"]):
        published = (known[row[0], name] for name in ("von_appen", BY_EYE))
        errors = (f"{one[after]} ({float(one[share].split()[0]):.0f} %)" for one in published)
        stated = (row[after], row[column("stated 1σ")], row[column("within 95 %")])
        fit = known[row[0], "exact"][after]
        rows.append([row[0], row[column("rms before")], fit, *stated, *errors])
    commands = f"{_measured_by(kept['products'])[:-1]};\n{_measured_by(kept['methods'])}"
    return f"{commands}\n\n{table(rows, head)}\n"


def calibrations() -> str:
    """The coverage of the intervals of simulated calibrations: lowest and highest of all kinds."""
    kept = json.loads(MEASURED.read_text())["calibrations"]
    rows = []
    for what in ("coefficients", "table", "tilts"):
        some = [row for row in rows_of(kept, 1) if what in row[0]]
        shares = sorted((float(value.split()[0]), value) for _, value, _ in some)
        missed = sum("MISSED" in row[2] for row in some)
        rows.append([what, str(len(some)), shares[0][1], shares[-1][1], f"{some[0][2]}, {missed} missed"])
    head = ("within 95 %", "kinds", "lowest", "highest", "target")
    return f"{_measured_by(kept)}\n\n{table(rows, head)}\n"


def injected() -> str:
    """The results of the search in real water without a fault, a column per record."""
    kept = json.loads(MEASURED.read_text())["injected"]
    found: dict[str, dict[str, str]] = {}
    what = ""
    for measure, value, _ in rows_of(kept):
        if measure.startswith("no effect: "):
            what, place = measure.removeprefix("no effect: "), "all"
        elif measure.startswith("null, "):
            place, _, what = re.sub(r" \(\d+ of \d+ fitted\)", "", measure.removeprefix("null, ")).partition(": ")
        else:
            place = measure.removeprefix("- ")
        found.setdefault(what, {})[place] = value
    rows = [[name, *(found[name][place] for place in WATERS)] for name in NULLS]
    return f"{_measured_by(kept)}\n\n{table(rows, ('no effect', *WATERS))}\n"


def card() -> str:
    """Some goals of the sealed proof of record, for README."""
    made = json.loads((CARD / "scorecard.json").read_text())
    chosen = [goal for what in GOALS for goal in made["goals"] if goal["what"].startswith(what)]
    rows = [[goal["what"], goal["value"], goal["target"] + ", missed" * goal["missed"]] for goal in chosen]
    return (
        "Concealed effects in an independent simulation "
        f"([scorecard](docs/proof/{CARD.name}/scorecard.md) of\n{_moorings(made)}; "
        f"[why some are missed](docs/background/proof.md#missed-targets)):\n\n"
        f"{table(rows, ('measure', 'value (95 % interval)', 'wanted'))}\n"
    )


def goals() -> str:
    """The rates of the sealed proof of record beside those of the second world."""
    made, kept = json.loads((CARD / "scorecard.json").read_text()), json.loads(MEASURED.read_text())["second"]
    second = {what: value + ", missed" * ("MISSED" in target) for what, value, target in rows_of(kept)}
    rows = [
        [goal["what"], goal["value"] + ", missed" * goal["missed"], second[goal["what"]], goal["target"]]
        for goal in made["goals"]
        if goal["what"] in second and goal["target"] != "> 0"
    ]
    return (
        f"[Scorecard](../proof/{CARD.name}/scorecard.md) of {_moorings(made)};\nsecond world: {_measured_by(kept)}\n\n"
        f"{table(rows, ('measure', 'value (95 % interval)', 'second world', 'wanted'))}\n\n"
        f"![True errors of headings](../proof/{CARD.name}/figures/headings.png)\n"
    )


def _moorings(made: dict[str, Any]) -> str:
    seal = made["seal"]
    older = ", of an older engine" if standing.is_older(seal["engine"]) else ""
    return f"{seal['count'] + seal['real']} moorings{older}"


PARTS: dict[str, Callable[[], str]] = {
    "card": card,
    "product": product,
    "goals": goals,
    "methods": methods,
    "calibrations": calibrations,
    "injected": injected,
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
