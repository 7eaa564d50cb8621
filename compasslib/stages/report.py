"""Write the report: all results on one page that needs no network."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from compasslib import report as html
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
