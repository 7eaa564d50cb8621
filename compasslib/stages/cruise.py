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
    """Write summary.csv, one row for each mooring, processed or stopped.

    Args:
        summary: path of summary.csv, in the folder that contains the moorings' result folders.
        roles: instruments that each mooring uses, in the order of the rows.
        stopped: reasons for missing results by name, under ``moorings`` and ``calibrations``.
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
    """Write the manifest, a crate of the jobs that led to the products; arguments as for ``crate.crate``.

    Raises:
        InputError: a product, or a result that it was made from, is not as a job wrote it.
    """
    jobs = crate.lineage(crate.records(), products)
    page = crate.crate(jobs, configuration=configuration, attributes=attributes, stopped=_named(stopped))
    write_json(manifest, page)
    say(f"{manifest}: {len(crate.listed(page))} files, {len(jobs)} jobs")


def complete(*, folders: Sequence[str], stopped: Mapping[str, Mapping[str, str]], say: Callable[[str], None]) -> None:
    """End the run: report what was stopped, and delete outdated ``stopped.json`` from the folders of results.

    Raises:
        Stopped: a mooring or calibration was stopped and has no results.
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
    """Return the reasons by kind and name, such as "mooring EG4", the keys of the configuration."""
    kinds = ("mooring", "calibration")
    return {f"{kind} {name}": why for kind in kinds for name, why in stopped[f"{kind}s"].items()}


def verify(*, configured: Sequence[str], say: Callable[[str], None]) -> None:
    """Report differences of the working folder, with the files that the rules can make, from its manifest.

    Raises:
        InputError: there are differences, or there is no manifest.
    """

    def shown(line: str) -> None:
        say(line)
        print(line, file=sys.stderr)  # these lines are the requested output

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
    """Check files against conventions, and write which conventions were checked.

    Raises:
        InputError: there are remarks on a file.
    """
    write_json(conventions, rules.report_remarks([*products, *gridded, *records], say))
