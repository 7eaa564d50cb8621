"""Write one row a mooring."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from compasslib.archive import summary as table


def run(
    *,
    summary: str,
    roles: Mapping[str, Sequence[str]],
    order: Sequence[str],
    stopped: Mapping[str, Mapping[str, str]],
    say: Callable[[str], None],
) -> None:
    """Write the rows of the moorings that were processed and of those that were stopped.

    Args:
        summary: beside the folders of the moorings' results.
        roles: instruments that each mooring uses.
        stopped: why others have no results, by name, of ``moorings`` and of ``calibrations``.
    """
    results = Path(summary).parent
    rows = [table.row(name, results / name, used) for name, used in roles.items()]
    rows += [table.row_of_stopped(name, why) for name, why in stopped["moorings"].items()]
    rows.sort(key=lambda row: order.index(row["name"]))
    table.write(summary, rows)
    say(table.table(rows))
    say(f"{summary}: {len(rows)} mooring{'s' * (len(rows) != 1)}")
