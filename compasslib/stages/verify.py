"""Verify the archive: the files of the cruise against its manifest."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence

from compasslib.archive import verification


def run(*, configured: Sequence[str], say: Callable[[str], None]) -> None:
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
