"""Stages of the whole cruise: summary, manifest, and checks of the archive."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from compasslib.archive import conventions as rules
from compasslib.archive import crate, verification
from compasslib.archive import summary as table
from compasslib.archive.files import write_json
from compasslib.errors import Stopped
from compasslib.pipeline.records import FOLLOWS


def summary(
    *,
    summary: str,
    roles: Mapping[str, Sequence[str]],
    stopped: Mapping[str, Mapping[str, str]],
    say: Callable[[str], None],
) -> None:
    """Write the rows of the moorings that were processed and of those that were stopped.

    Args:
        summary: beside the folders of the moorings' results.
        roles: instruments that each mooring uses, in the order of the rows.
        stopped: why some have no results, by name, of ``moorings`` and of ``calibrations``.
    """
    results = Path(summary).parent
    why = stopped["moorings"]
    rows = [
        table.stopped_row(name, why[name]) if name in why else table.summary_row(name, results / name, used)
        for name, used in roles.items()
    ]
    table.write_summary(summary, rows)
    say(table.format_table(rows))
    say(f"{summary}: {len(rows)} mooring{'s' * (len(rows) != 1)}")


def provenance(
    *,
    products: Sequence[str],
    manifest: str,
    configuration: Mapping[str, Sequence[str]],
    attributes: Mapping[str, Any],
    stopped: Mapping[str, Mapping[str, str]],
    say: Callable[[str], None],
) -> None:
    """Write the lineage of the products, as ``crate.crate`` takes it.

    Raises:
        InputError: a product, or a result that it was made from, is not what a job wrote.
    """
    jobs = crate.lineage(crate.records(), products)
    page = crate.crate(jobs, configuration=configuration, attributes=attributes, stopped=_named(stopped))
    write_json(manifest, page)
    say(crate.log_line(page))


def complete(*, folders: Sequence[str], stopped: Mapping[str, Mapping[str, str]], say: Callable[[str], None]) -> None:
    """End the run: what is no longer stopped loses its ``stopped.json``.

    Args:
        folders: of the results of moorings, calibrations and compasses.

    Raises:
        Stopped: a mooring or calibration has no results.
    """
    left = {f"results/{name}" for name in stopped["moorings"]}
    left |= {f"results/calibrations/{name}" for name in stopped["calibrations"]}
    for folder in folders:
        if folder not in left:
            Path(folder, "stopped.json").unlink(missing_ok=True)
    lines = [f"{of}: {why}" for of, why in _named(stopped).items()]
    for line in lines:
        say(line)
    if lines:
        raise Stopped(*(line for line in lines if FOLLOWS not in line))
    say(f"{len(folders)} folders of results, none was stopped")


def _named(stopped: Mapping[str, Mapping[str, str]]) -> dict[str, str]:
    """Name what was stopped by kind and name, as the configuration behind it is named."""
    kinds = ("mooring", "calibration")
    return {f"{kind} {name}": why for kind in kinds for name, why in stopped[f"{kind}s"].items()}


def verify(*, configured: Sequence[str], say: Callable[[str], None]) -> None:
    """Report what differs from the manifest of the working folder, a line each.

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
    mooring: str,
    *,
    products: Sequence[str],
    gridded: Sequence[str],
    records: Sequence[str],
    conventions: str,
    say: Callable[[str], None],
) -> None:
    """Write what the files were held against.

    Raises:
        InputError: something stands against one of them.
    """
    write_json(conventions, rules.report_remarks([*products, *gridded, *records], say))
