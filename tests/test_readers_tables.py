"""Tables as people have them: each is read right, or refused in a line that names the key which settles it."""

from __future__ import annotations

from pathlib import Path

import pytest
import tables

FORMS = tables.VARIANTS | tables.drawn(seed=1, n=20)
OTHERS = [kind for kind in tables.KINDS if kind != "table"]
EACH = [("table", name) for name in FORMS] + [(OTHERS[k % len(OTHERS)], name) for k, name in enumerate(FORMS)]


@pytest.mark.parametrize(("kind", "name"), EACH)
def test_a_table_is_read_right_or_refused_by_the_key_that_settles_it(tmp_path, kind, name):
    found, key = tables.outcome(Path(tmp_path, "table.csv"), FORMS[name], kind), tables.settled_by(FORMS[name])
    assert (found.startswith("refused") and key in found) if key else found == "right"
