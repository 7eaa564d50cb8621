"""Write the manifest: what was made from what and by what, from the jobs' records."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from compasslib.archive import crate
from compasslib.archive.files import write_json


def run(
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
