"""Write the pages of the cruise: the report, and the series of all moorings to look at; neither needs a network."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from compasslib import report as html
from compasslib.archive.summary import STOPPED
from compasslib.report import explore as series
from compasslib.report.results import read_summary
from compasslib.stages.cruise import read_stopped


def report(
    *,
    page: str,
    attributes: Mapping[str, Any],
    moorings: Mapping[str, Mapping[str, Any]],
    calibrations: Sequence[str],
    compasses: Sequence[str],
    usable: str,
    say: Callable[[str], None],
) -> None:
    """Write the page into the folder of the results; arguments as for ``report.gather``.

    Raises:
        InputError: a file of the results is missing or damaged.
    """
    stopped = read_stopped(usable)
    content = html.gather(
        Path(page).parent,
        attributes=attributes,
        moorings=moorings,
        calibrations=[name for name in calibrations if name not in stopped["calibrations"]],
        compasses=[name for name in compasses if name not in stopped["compasses"]],
        stopped=stopped,
    )
    html.write(page, content)
    say(html.log_line(page, content))


def explore(*, page: str, summary: str, project: str, say: Callable[[str], None]) -> None:
    """Write the page of the series of all moorings that have results, in the order of summary.csv.

    Raises:
        InputError: a file of the results is missing or damaged.
    """
    rows = {name: row for name, row in read_summary(summary).items() if row["verdict"] != STOPPED}
    moorings = series.collect(Path(page).parent, list(rows), rows)
    series.write(page, html.title("Series of the moorings", project), moorings)
    say(f"{page}: {len(moorings)} moorings, {Path(page).stat().st_size / 1e6:.1f} MB")
