"""Series of a covariate that no other reader knows: one column of a text table along time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from compasslib.errors import InputError
from compasslib.readers.cells import Layout, said, table_of
from compasslib.types import Floats


def series(covariate: Mapping[str, Any]) -> tuple[Floats, Floats, tuple[str, ...]]:
    """Return UTC seconds since 1970, increasing, and values of a covariate's table, (n,) each and finite; and notes.

    Of rows that share a time the first counts where all agree, none where they differ.

    Args:
        covariate: its part of the mooring file, as ``Covariate.model_dump`` gives it: ``files``, ``columns`` (time or
            date and clock, value) and the keys of tables.

    Raises:
        InputError: a file or a column is absent, a cell cannot be read, or no row holds both time and value.
    """
    headers = {role: header for role, header in covariate["columns"].items() if header is not None}
    paths = [Path(file) for file in covariate["files"]]
    advice = "correct columns of the covariate in the mooring file"
    parts = [table_of(path, headers, advice, Layout.of(covariate)) for path in paths]
    time_s, value = (np.concatenate([part.columns[role] for part in parts]) for role in ("time", "value"))
    known = np.isfinite(time_s) & np.isfinite(value)
    time_s, first, which = np.unique(time_s[known], return_index=True, return_inverse=True)
    values = value[known]
    torn = np.bincount(which, values != values[first][which], minlength=len(time_s)) > 0
    if torn.all():
        where, found = ", ".join(str(path) for path in paths), "none"
        raise InputError(
            where, expected="rows with a time and a value", found=found, advice="check columns and missing"
        )
    return time_s[~torn], values[first][~torn], said(parts)
