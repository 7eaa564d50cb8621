"""Pages of docs/background written by code: the table of the three papers, and the constants of the search.

A row of a paper names code and a test that exist, and agrees in its number or says why not. Every named number of the
search is listed, under the error that it controls.
"""

from __future__ import annotations

import ast
import re
from importlib import import_module
from pathlib import Path

import papers
import pytest

PROJECT = Path(__file__).resolve().parents[1]
ROWS = papers.rows()
NONE = "–"


def test_page_matches_the_code():
    assert papers.PAGE.read_text() == papers.filled(), "write its numbers anew: python benchmarks/papers.py"
    assert sum(ours != NONE for *_, ours in ROWS) == len(papers.ours())


def test_page_counts_the_rows_that_are_in_the_software():
    for table in papers.PAGE.read_text().split("\n## ")[1:]:
        done, count = map(int, re.search(r"^(\d+) of (\d+) rows are in the software", table, re.MULTILINE).groups())
        where = re.findall(r"^\| (?:[^|]*\|){2} (`.*?`|–) \|", table, re.MULTILINE)
        assert (sum(one != NONE for one in where), len(where)) == (done, count)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row[0]} {row[1][:30]}")
def test_row_names_existing_code_and_agrees_or_explains(row):
    _, what, code, test, printed, ours = row
    explained = what.endswith(")")
    assert (code == NONE) == (test == NONE) and (code != NONE or explained)
    assert printed == ours or explained
    if code == NONE:
        return
    code, test = code.strip("`"), test.strip("`")
    if "/" in code:
        assert (PROJECT / code).exists()
    else:
        module, _, name = code.partition(":")
        assert not name or hasattr(import_module(f"compasslib.{module}"), name)
        import_module(f"compasslib.{module}")
    file, name = test.split("::")
    assert re.search(rf"^def {name}\(", (PROJECT / "tests" / file).read_text(), re.MULTILINE)


PAGE = PROJECT / "docs/background/constants.md"
ROOT = PROJECT / "compasslib"
ENGINE = [
    *ROOT.glob("inference/**/*.py"),
    *ROOT.glob("statistics/*.py"),
    ROOT / "effects/effect.py",
    ROOT / "effects/composed.py",
]
LONGEST = 40  # characters of a value as shown on the page


def numbers(path: Path) -> dict[tuple[str, str], str]:
    """Return the source of each constant that contains a number, by name and module."""
    source, found = path.read_text(), {}
    for node in ast.parse(source).body:
        if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
            continue
        target, value = (node.targets[0] if isinstance(node, ast.Assign) else node.target), node.value
        together = isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple)
        each = zip(target.elts, value.elts, strict=True) if together else [(target, value)]
        for name, one in each:
            if re.fullmatch(r"_?[A-Z][A-Z0-9_]*", getattr(name, "id", "")) and any(map(is_number, ast.walk(one))):
                text = re.sub(r"\s#\s.*$", "", ast.get_source_segment(source, one), flags=re.MULTILINE)
                found[name.id, str(path.relative_to(ROOT))] = shown(" ".join(text.split()))
    return found


def is_number(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool)


def shown(text: str) -> str:
    return text if len(text) <= LONGEST else text[: LONGEST - 3] + "..."


def test_page_lists_every_constant_of_the_search_with_its_value():
    row = r"^\| `(\w+)` \| `([\w/]+\.py)` \| `(.+)` \| (.+) \|$"
    told = {(name, module): value for name, module, value, _ in re.findall(row, PAGE.read_text(), re.MULTILINE)}
    there = {key: value for path in ENGINE for key, value in numbers(path).items()}
    assert there.keys() - told.keys() == set(), "say in docs/background/constants.md which error they set"
    assert told.keys() - there.keys() == set(), "gone: take them from docs/background/constants.md"
    assert {key for key, value in there.items() if value != told[key]} == set(), "their values changed"


def test_counts_on_the_page_match_its_rows():
    text = PAGE.read_text()
    sections = text.split("\n## ")[1:]
    listed = {part.split("\n")[0]: part.count("\n| `") for part in sections}
    counted = {title: int(count) for title, count in re.findall(r"^\| ([A-Z][\w ]+) \| (\d+) \|$", text, re.MULTILINE)}
    assert counted == listed and f"The {sum(listed.values())} numbers" in text
