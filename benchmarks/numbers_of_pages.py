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
from collections.abc import Callable, Collection, Sequence
from datetime import UTC, date, datetime
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
VALUE = "value (95 % interval)"
BY_EYE = "von_appen, as an author would"  # fitted about the mean deviation, inverted where most pairs lie
# What README says of moorings beside their names.
TWICE = ", two pairs a day"
NOTES = {"EG4": ", two-valued", "EG5": TWICE, "EG6": f"{TWICE}, two-valued", "EG7": TWICE}
# Columns, and rows of ``injected``, that no page shows.
DROPPED = {
    *("method", "share corrected", "median after", "rms where sure", "cells", "filled within the gaps", "made up"),
    *("CPU s a year", "stated / real rms", "worst", "A off, over its σ, rms", "attributed to anything"),
}
_PART = re.compile(r"(<!-- numbers: (\S+) -->\n).*?(<!-- /numbers -->)", re.DOTALL)
Rows = list[dict[str, str]]


def keep(name: str, command: Sequence[str]) -> int:
    """Run a benchmark and keep the tables that it prints; return its exit status, 1 where it misses a target."""
    ran = subprocess.run([sys.executable, *command], stdout=subprocess.PIPE, text=True, check=False, cwd=PROJECT)
    print(ran.stdout)
    tables = re.findall(r"^\|.*\|\n\|[-|]+\|\n(?:\|.*\|\n?)*", ran.stdout, re.MULTILINE)
    if not tables:
        sys.exit(f"{' '.join(command)}: expected tables, found none; nothing is kept")
    shown = re.sub(r" (/\S+)", " CRUISE", re.sub(r" --\S+ /\S+", "", " ".join(command)))
    made = {
        "command": shown,
        "version": __version__,
        "commit": standing.commit()[: standing.DIGITS],
        "engine": standing.engine(),
        "date": datetime.now(UTC).date().isoformat(),
        "tables": [table.strip().splitlines() for table in tables],
    }
    kept = json.loads(MEASURED.read_text()) | {name: made}
    MEASURED.write_text(json.dumps(kept, indent=1, ensure_ascii=False, sort_keys=True) + "\n")
    return ran.returncode


def table(rows: Rows, dropped: Collection[str] = DROPPED) -> str:
    """Write rows as a table in Markdown, by default without the columns that no page shows."""
    shown = [{title: cell for title, cell in row.items() if title not in dropped} for row in rows]
    lines = [f"| {' | '.join(cells)} |" for cells in (shown[0], *(row.values() for row in shown))]
    return "\n".join([lines[0], "|---" * len(shown[0]) + "|", *lines[1:]]) + "\n"


def measured(name: str) -> tuple[list[Rows], str]:
    """Return the tables of a measurement, and by which version and when they were measured."""
    kept = json.loads(MEASURED.read_text())[name]
    cells = [[[cell.strip() for cell in line.strip("|").split("|")] for line in lines] for lines in kept["tables"]]
    day = date.fromisoformat(kept["date"])
    older = ", an older engine" if standing.is_older(kept["engine"]) else ""
    commit = f" ({kept['commit']})" if kept["commit"] else ""
    made = f"`{kept['command']}`, version {kept['version']}{commit}{older}, {day.day} {day:%B %Y}"
    return [[dict(zip(head, row, strict=True)) for row in rows] for head, _, *rows in cells], made


def tables_of(name: str) -> str:
    """Write the tables of one measurement."""
    tables, made = measured(name)
    return "\n".join([f"{made}:\n", *(table(rows) for rows in tables if "a corrected mean per bin" not in rows[0])])


def methods() -> Rows:
    """Return the errors of the product beside those of the fit alone and of the published method, per mooring."""
    known = {(row["mooring"], row["method"]): row for row in measured("methods")[0][0]}
    rows = []
    for row in measured("products")[0][0]:
        fit, *published = (known[row["mooring"], method] for method in ("exact", "von_appen", BY_EYE))
        shares = (f"{float(one['share corrected'].split()[0]):.0f} %" for one in published)
        parts = [f" ({share})" * (share != "100 %") for share in shares]
        literal, by_eye = (one["rms after"] + part for one, part in zip(published, parts, strict=True))
        errors = {"recorded": row["rms before"], "`exact` alone": fit["rms after"], "product": row["rms after"]}
        stated = {title: row[title] for title in ("stated 1σ", "within 95 %")}
        rows.append({"mooring": row["mooring"], **errors, **stated, "`von_appen`": literal, "by eye": by_eye})
    return rows


def product() -> str:
    """The product's headings beside the published method, for README."""
    rows, made = methods(), measured("products")[1]
    inside = [int(row["within 95 %"].split()[0]) for row in rows]
    published = "von Appen (2015)" + ", an older engine" * ("an older engine" in measured("methods")[1])
    titles = {"recorded": "before", "product": "product", "stated 1σ": "stated 1σ, rms", "by eye": published}
    named = [
        {"mooring": row["mooring"] + NOTES.get(row["mooring"], "")} | {new: row[old] for old, new in titles.items()}
        for row in rows
    ]
    untouched, weak, strong = measured("eh2")[0][0]
    command, _, version = made.partition(", ")
    return (
        f"Heading errors of the demonstration cruise, rms (`.venv/bin/python {command[1:]}:\n"
        f"{version}):\n\n{table(named)}\n"
        f"{min(inside)} to {max(inside)} % of the headings lie in their stated 95 % interval.\n\n"
        "On a real record (eh2) re-read by a compass near iron the error falls from "
        f"{weak['rms before']} to {weak['rms after']},\nnear iron of 1.3 times the earth's field from "
        f"{strong['rms before']} to {strong['rms after']}; without iron it is {untouched['rms after']}.\n"
    )


def calibrations() -> str:
    """The coverage of the intervals of simulated calibrations: lowest and highest of all kinds."""
    (_, coverage), made = measured("calibrations")
    rows = []
    for what in ("coefficients", "table", "tilts"):
        some = sorted((float(x["value"].split()[0]), x["value"], x["target"]) for x in coverage if what in x["measure"])
        missed = sum("MISSED" in target for *_, target in some)
        row = {"within 95 %": what, "kinds": str(len(some)), "lowest": some[0][1], "highest": some[-1][1]}
        rows.append(row | {f"outside {some[0][2]}": str(missed)})
    return f"{made}:\n\n{table(rows)}"


def injected() -> str:
    """The results of the search in real water without a fault, a column per record."""
    (listed,), made = measured("injected")
    found: dict[str, dict[str, str]] = {}
    what = ""
    for row in listed:
        place = row["measure"].removeprefix("- ")
        if place.startswith("no effect: "):
            what, place = place.removeprefix("no effect: "), "all"
        elif place.startswith("null, "):
            place, _, what = re.sub(r" \(\d+ of \d+ fitted\)", "", place.removeprefix("null, ")).partition(": ")
        found.setdefault(what, {})[place] = row["value"]
    places = ("eh2", "papa", "aqd9330", "all")
    rows = [
        {"no effect": name, **{place: values[place] for place in places}}
        for name, values in found.items()
        if {*places} <= {*values} and name not in DROPPED
    ]
    return f"{made}:\n\n{table(rows)}"


def _card() -> tuple[list[dict[str, Any]], str]:
    made = json.loads((CARD / "scorecard.json").read_text())
    older = ", of an older engine" if standing.is_older(made["seal"]["engine"]) else ""
    moorings = f"{made['seal']['count'] + made['seal']['real']} moorings{older}"
    return made["goals"], f"{CARD.name}/scorecard.md) of\n{moorings}"


def goals() -> str:
    """The rates of the sealed proof of record beside those of the second world."""
    given, moorings = _card()
    (targets, *_), made = measured("second")
    second = {x["measure"]: x["value"] + ", missed" * ("MISSED" in x["target"]) for x in targets}
    rows = [
        {"measure": x["what"], VALUE: x["value"] + ", missed" * x["missed"], "second world": second[x["what"]]}
        | {"wanted": x["target"]}
        for x in given
        if x["what"] in second and x["target"] != "> 0"
    ]
    figure = f"![True errors of headings](../proof/{CARD.name}/figures/headings.png)"
    return f"[Scorecard](../proof/{moorings};\nsecond world: {made}:\n\n{table(rows)}\n{figure}\n"


def power() -> str:
    """The power of the search over all moorings with a cause, and how often it accuses a sound compass."""
    made = json.loads(POWER.read_text())
    titles = dict(zip(MEASURES, ("fault of the compass detected", "driver named", "effect named"), strict=True))
    total = {key: sum(part[key] for part in made["all"].values()) for key in ("n", *MEASURES)}
    parts = {"all": total} | {WATERS.get(record, record): part for record, part in made["all"].items()}
    parts |= {f"no cause, {water}: falsely": part for water, part in made["no_cause"].items()}
    rows = [
        {"water": water} | {title: targets.text_of(part[what], part["n"]) for what, title in titles.items()}
        for water, part in parts.items()
    ]
    return f"`{made['command']}`, commit {made['commit']}:\n\n{table(rows)}"


def headline() -> str:
    """The power of the search in a sentence, over all moorings: real water, unseen, and stand-ins too."""
    made = json.loads(POWER.read_text())
    (n, *named), (sound, *false) = (
        [sum(part[key] for part in made[kind].values()) for key in ("n", *MEASURES)] for kind in ("all", "no_cause")
    )
    real, stand_in = n - made["all"]["simulated"]["n"], made["all"]["aqd9330"]["n"]
    shares = [targets.text_of(hits, n).replace(f" of {n}", "") for hits in named]
    return (
        f"Of {n} moorings with a concealed cause, {real} of them in real water ({stand_in} unseen, with a stand-in\n"
        f"reference), a fault was detected in {shares[0]}, its driver named in {shares[1]}, its\n"
        f"effect in {shares[2]}. Of {sound} without a cause {false[0]} were suspected, {false[1]} wrongly named.\n"
    )


PARTS: dict[str, Callable[[], str]] = {
    **{part.__name__: part for part in (headline, power, product, goals, calibrations, injected)},
    "methods": lambda: f"{measured('products')[1]};\n{measured('methods')[1]}:\n\n{table(methods())}",
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
