"""Page of docs/background written by code: the table of the three papers.

A row of a paper names code and a test that exist, and agrees in its number or says why not.
"""

from __future__ import annotations

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
