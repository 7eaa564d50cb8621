"""What every job of the workflow does around its one call: say what happens, and fail in one line."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TextIO

from compasslib.errors import InputError


@contextmanager
def job(log: str | Path) -> Iterator[Callable[[str], None]]:
    """Give a function that says one line on stderr and in the job's log; input errors become such a line and exit 1.

    Args:
        log: the job's log file, written anew.

    Raises:
        SystemExit: the input could not be used.
    """
    with _opened(log) as stream:

        def say(line: str) -> None:
            # Text and newline in one write, so that jobs side by side do not tear each other's lines.
            print(f"{line}\n", end="", file=sys.stderr, flush=True)
            with suppress(OSError):  # a full disk must not hide what was said
                print(line, file=stream, flush=True)

        try:
            yield say
        except InputError as error:
            say(f"error: {error}")
            sys.exit(1)


def _opened(log: str | Path) -> TextIO:
    try:
        return Path(log).open("w", encoding="utf-8")
    except OSError:
        return Path(os.devnull).open("w", encoding="utf-8")
