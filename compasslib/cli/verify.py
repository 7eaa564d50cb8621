"""``compass verify``: a cruise's files against its manifest, and removal of what is configured no more."""

from __future__ import annotations

import sys
from argparse import Namespace
from contextlib import chdir
from pathlib import Path

from compasslib.archive import verification
from compasslib.archive.provenance import PROJECT
from compasslib.config import cruise
from compasslib.errors import InputError
from compasslib.pipeline import guard, plan


def run(asked: Namespace) -> int:
    """Print what differs from the manifest; with ``clear``, what is configured no more, and delete it where asked.

    Args:
        asked: ``cruise``, ``clear`` and ``yes``.

    Raises:
        InputError: something differs, there is no manifest, or the configuration cannot be read that tells what to
            clear.
    """
    if not Path(asked.cruise).is_dir():
        advice = "name the folder of a cruise"
        raise InputError(asked.cruise, expected="a cruise folder", found="no such folder", advice=advice)
    with chdir(asked.cruise):
        return _clear(asked.yes) if asked.clear else _verify()


def _verify() -> int:
    try:
        configured = _configured()
    except InputError as error:  # an archive may stand without its raw files
        configured = None
        print(f"what is configured no more cannot be told: {error}", file=sys.stderr)
    verification.verify(Path(), configured, print)
    return 0


def _clear(confirmed: bool) -> int:
    guard.refuse_links([])
    if confirmed:
        guard.alone()
    configured = _configured()
    results = verification.Results(Path(), configured)
    word = "removed" if confirmed else "would be removed"
    lines = [f"{word}: {file}" for file in results.former]
    lines += [f"kept: {file}, which no job wrote as it is" for file in results.foreign(configured)]
    if confirmed:
        results.clear()
    more = "; add --yes to remove them" if results.former and not confirmed else ""
    print(
        *map(verification.escaped, lines), f"{len(results.former)} files of what is configured no more{more}", sep="\n"
    )
    return 0


def _configured() -> list[str]:
    return plan.plan(cruise.load(Path()), PROJECT / "workflow/scripts").configured()
