"""Check a mooring's netCDF files against CF, ACDD and OceanSITES."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from compasslib.archive import conventions as rules
from compasslib.archive.files import write_json


def run(
    mooring: str, *, products: Sequence[str], records: Sequence[str], conventions: str, say: Callable[[str], None]
) -> None:
    """Write what the files were held against.

    Raises:
        InputError: something stands against one of them.
    """
    write_json(conventions, rules.tell([*products, *records], say))
