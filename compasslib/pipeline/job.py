"""What every job of the workflow does around its one call: say what happens, fail in one line, leave its record."""

from __future__ import annotations

import gc
import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TextIO

from compasslib.archive import provenance
from compasslib.archive.files import atomic_write
from compasslib.errors import InputError
from compasslib.pipeline import ledger, stopped
from compasslib.statistics import single_threaded

_ENDED = {
    True: "ran out of memory; run again with fewer --cores, so that fewer jobs share it, or on a machine with more",
    False: "was interrupted; run again to take it up",
}


def job(snakemake: Any, stage: Callable[..., None]) -> None:
    """Run one stage with what its rule names: the wildcards in order, then inputs, outputs and parameters by name.

    What the rule does not name is there for the order of the jobs alone, and its parameter ``code`` to run it again.
    ``say`` is a line in the job's log, of which ``lines`` shows one; an error of the input becomes such a line, on
    stderr too, and exit 1. A job that ends well leaves what it read and wrote beside its log, NAME.json beside
    NAME.log; one whose input cannot be used leaves the reason, NAME.stopped. What it reads must be what the jobs before
    it wrote.

    Args:
        snakemake: what Snakemake gives its scripts; its log is written anew.

    Raises:
        SystemExit: the input could not be used.
    """
    parts = (snakemake.input, snakemake.output, snakemake.params)
    named = {name: value for part in parts for name, value in part.items() if name != "code"}
    record = Path(snakemake.log[0]).with_suffix(".json")
    with _log(snakemake) as say, _recorded(snakemake, record), single_threaded():
        stage(*snakemake.wildcards, **named, say=say)


@contextmanager
def _log(snakemake: Any) -> Iterator[Callable[[str], None]]:
    """Give what says a line, and say why where the block fails."""
    log, of = Path(snakemake.log[0]), stopped.named(snakemake.wildcards)
    with _opened(log) as stream:

        def say(line: str) -> None:
            try:
                print(line, file=stream, flush=True)
            except OSError:  # a full disk must not hide what was said
                _on_screen(line)

        try:
            yield say
        except InputError as error:
            stopped.leave(snakemake, error)
            say(line := f"error: {of}{error}")
            _on_screen(line)
            sys.exit(1)
        except (MemoryError, KeyboardInterrupt) as error:  # they say nothing about the input
            say(line := f"error: {of}{log.stem} {_ENDED[isinstance(error, MemoryError)]}")
            _on_screen(line)
            sys.exit(1)
        except SystemExit as error:  # from a package beside this one, perhaps with status 0
            say(line := f"error: {of}{stopped.leave(snakemake, error)}")
            _on_screen(line)
            sys.exit(1)
        except Exception as error:  # whatever the program missed: the mooring is stopped by it, the traceback stays
            say(f"error: {of}{stopped.leave(snakemake, error)}")
            raise
        finally:
            gc.freeze()  # the process ends: to look all modules through for cycles is a twentieth of a small job


@contextmanager
def _recorded(snakemake: Any, record: Path) -> Iterator[None]:
    """Hold the inputs against the records of those who wrote them, and leave a record of this job."""
    before = ledger.looked_at(provenance.inputs(snakemake))
    read = {path: digest for path, (_, digest) in before.items()}
    ledger.hold(read)
    yield
    ledger.unchanged(before)
    made = provenance.of_job(snakemake, read)
    with atomic_write(record) as temporary:
        temporary.write_text(json.dumps(made, indent=1, default=str) + "\n")
    raw = {path: seen for path, seen in before.items() if not path.startswith(f"{ledger.RESULTS}/")}
    ledger.remember(raw | {path: (ledger.signature(path), digest) for path, digest in made["wrote"].items()})


def _opened(log: Path) -> TextIO:
    try:
        # Log and benchmark are opened as they stand, which may be a link, or a hard one of an older copy.
        for left in (log, log.parent.parent / "benchmarks" / f"{log.stem}.tsv", log.with_suffix(".json")):
            left.unlink(missing_ok=True)
        return log.open("w", encoding="utf-8")
    except OSError:
        return os.fdopen(os.dup(sys.stderr.fileno()), "w", encoding="utf-8")


def _on_screen(line: str) -> None:
    # Text and newline in one write, so that jobs side by side do not tear each other's lines.
    print(f"{line}\n", end="", file=sys.stderr, flush=True)
