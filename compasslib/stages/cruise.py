"""Stages of the whole cruise: summary, report, manifest, and checks of the archive."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from compasslib import report as html
from compasslib.archive import conventions as rules
from compasslib.archive import crate, verification
from compasslib.archive import summary as table
from compasslib.archive.files import write_json


def summary(
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
    rows = [table.summary_row(name, results / name, used) for name, used in roles.items()]
    rows += [table.stopped_row(name, why) for name, why in stopped["moorings"].items()]
    rows.sort(key=lambda row: order.index(row["name"]))
    table.write_summary(summary, rows)
    say(table.format_table(rows))
    say(f"{summary}: {len(rows)} mooring{'s' * (len(rows) != 1)}")


def report(
    *,
    page: str,
    attributes: Mapping[str, Any],
    moorings: Mapping[str, Mapping[str, Any]],
    calibrations: Sequence[str],
    compasses: Sequence[str],
    stopped: Mapping[str, Mapping[str, str]],
    say: Callable[[str], None],
) -> None:
    """Write the page beside the results that it shows, as ``report.gather`` takes them.

    Raises:
        InputError: a file of the results is absent or damaged.
    """
    gathered = html.gather(
        Path(page).parent,
        attributes=attributes,
        moorings=moorings,
        calibrations=calibrations,
        compasses=compasses,
        stopped=stopped,
    )
    html.write(page, gathered)
    say(html.log_line(page, gathered))


def provenance(
    *,
    products: Sequence[str],
    manifest: str,
    configuration: Mapping[str, Sequence[str]],
    attributes: Mapping[str, Any],
    stopped: Mapping[str, str],
    say: Callable[[str], None],
) -> None:
    """Write the lineage of the products, as ``crate.crate`` takes it.

    Raises:
        InputError: a product, or a result that it was made from, is not what a job wrote.
    """
    jobs = crate.lineage(crate.records(), products)
    page = crate.crate(jobs, configuration=configuration, attributes=attributes, stopped=stopped)
    write_json(manifest, page)
    say(crate.log_line(page))


def verify(*, configured: Sequence[str], say: Callable[[str], None]) -> None:
    """Say what differs from the manifest of the working folder, a line each.

    Args:
        configured: files that the rules make.

    Raises:
        InputError: something differs, or there is no manifest.
    """

    def shown(line: str) -> None:
        say(line)
        print(line, file=sys.stderr)  # these lines are what was asked for

    verification.verify(".", configured, shown)


def conventions(
    mooring: str, *, products: Sequence[str], records: Sequence[str], conventions: str, say: Callable[[str], None]
) -> None:
    """Write what the files were held against.

    Raises:
        InputError: something stands against one of them.
    """
    write_json(conventions, rules.tell([*products, *records], say))
