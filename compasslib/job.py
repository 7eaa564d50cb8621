"""What every job of the workflow does around its one call: say what happens, fail in one line, leave its record."""

from __future__ import annotations

import gc
import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TextIO

from compasslib import provenance
from compasslib.archive_files import replacing
from compasslib.errors import InputError


@contextmanager
def job(snakemake: Any) -> Iterator[Callable[[str], None]]:
    """Give a function that says one line on stderr and in the job's log; input errors become such a line and exit 1.

    A job that ends well leaves what it read and wrote beside its log, NAME.json beside NAME.log.

    Args:
        snakemake: what Snakemake gives its scripts; its log is written anew.

    Raises:
        SystemExit: the input could not be used.
    """
    log = Path(snakemake.log[0])
    with _opened(log) as stream:

        def say(line: str) -> None:
            # Text and newline in one write, so that jobs side by side do not tear each other's lines.
            print(f"{line}\n", end="", file=sys.stderr, flush=True)
            with suppress(OSError):  # a full disk must not hide what was said
                print(line, file=stream, flush=True)

        try:
            yield say
            with replacing(log.with_suffix(".json")) as temporary:
                temporary.write_text(json.dumps(provenance.of_job(snakemake), indent=1, default=str) + "\n")
        except InputError as error:
            say(f"error: {error}")
            sys.exit(1)
        finally:
            gc.freeze()  # the process ends: to look all modules through for cycles is a twentieth of a small job


def _opened(log: Path) -> TextIO:
    try:
        return log.open("w", encoding="utf-8")
    except OSError:
        return Path(os.devnull).open("w", encoding="utf-8")
