"""Tables as people have them: each is read right, or refused in a line that names the key which settles it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tables

from compasslib import readers
from compasslib.core.errors import InputError

FORMS = tables.VARIANTS | tables.drawn(seed=1, n=20)


@pytest.mark.parametrize("name", FORMS)
def test_a_table_is_read_right_or_refused_by_the_key_that_settles_it(tmp_path, name):
    form, path = FORMS[name], Path(tmp_path, "table.csv")
    truth, settings = tables.write(path, form)
    if tables.ambiguous(form):
        with pytest.raises(InputError, match="time_format"):
            readers.read("table", [path], settings)
        return
    record = readers.read("table", [path], settings)
    assert np.abs(record.time_s - truth.time_s).max() < tables.SURE_S
    for found, known in ((record.east, truth.east), (record.north, truth.north)):
        assert np.array_equal(np.isnan(found[:, 0]), np.isnan(known)) and np.nanmax(np.abs(found[:, 0] - known)) < 1e-9
