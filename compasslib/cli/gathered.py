"""Warnings of a command: kept while it works, and told together at its end, where a person still sees them."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import TextIO

MARK = ": warning: "  # as the lines of the stages' logs have it


def apart(said: str) -> tuple[list[str], list[str]]:
    """Return the lines of a log that are no warnings, and the warnings, without the word."""
    lines = said.splitlines()
    return [line for line in lines if MARK not in line], [line.replace(MARK, ": ", 1) for line in lines if MARK in line]


def tell(warnings: Sequence[str], stream: TextIO | None = None) -> None:
    """Print warnings, each once.

    Args:
        stream: stderr where absent.
    """
    once = list(dict.fromkeys(warnings))
    if once:
        print(f"{len(once)} warning{'s' * (len(once) != 1)}:", *once, sep="\n  ", file=stream or sys.stderr, flush=True)
