"""Table of the three papers: the page matches the code, each row's code and test exist, numbers agree."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path

import papers
import pytest

PROJECT = Path(__file__).resolve().parents[1]
ROWS = [pytest.param(row, id=f"{row.place} {row.what[:30]}") for rows in papers.PAPERS.values() for row in rows]


def test_page_matches_the_code():
    page = (PROJECT / "docs/background/papers.md").read_text()
    assert page == papers.page(), "make it anew: python benchmarks/papers.py > docs/background/papers.md"


@pytest.mark.parametrize("row", ROWS)
def test_row_names_existing_code_and_agrees_or_explains(row):
    assert bool(row.code) == bool(row.test) and (row.code or row.why)
    assert row.printed == row.ours or row.why
    if not row.code:
        return
    if "/" in row.code:
        assert (PROJECT / row.code).exists()
    else:
        module, _, name = row.code.partition(":")
        assert not name or hasattr(import_module(f"compasslib.{module}"), name)
        import_module(f"compasslib.{module}")
    file, name = row.test.split("::")
    assert re.search(rf"^def {name}\(", (PROJECT / "tests" / file).read_text(), re.MULTILINE)
