"""Run a stage as a job of the workflow: with its log, its record, and errors of one line.

The record is the file that Snakemake waits for. It states what the job read and wrote or, where a raw file cannot be
used, why the mooring or calibration is stopped. Subsequent jobs inherit that reason.
"""

from __future__ import annotations

import gc
import os
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from inspect import signature
from pathlib import Path
from typing import Any, TextIO

from compasslib.archive import provenance
from compasslib.errors import InputError, Stopped
from compasslib.pipeline import records
from compasslib.pipeline.records import Record
from compasslib.statistics import single_threaded

OUT_OF_MEMORY = "ran out of memory; run again with fewer --cores, so that fewer jobs share it, or on a larger machine"
INTERRUPTED = "was interrupted; run again to take it up"
STOPPING = ("mooring", "calibration")  # subjects that an unusable file stops; jobs of others fail
Say = Callable[[str], None]


def job(snakemake: Any, stage: Callable[..., None]) -> None:
    """Run one stage as the only one of this process; see ``run_job``.

    Raises:
        SystemExit: the job failed.
    """
    try:
        run_job(snakemake, stage)
    finally:
        gc.freeze()  # the garbage collection at exit would take a twentieth of a small job's time


def run_job(snakemake: Any, stage: Callable[..., None]) -> None:
    """Run one stage with its wildcards in order, and the files and settings of its rule by name of argument.

    The argument ``say`` writes a line to the job's log. A job is not run again if its inputs, settings, code and
    results all agree with its record. If the content of a file cannot be used, or the program fails on it, the mooring
    or calibration is stopped: the job succeeds, its record states the reason, and its files are deleted. A full disk,
    lack of memory or an interruption makes the job fail, so that it is tried again.

    Args:
        snakemake: object of the script; ``params.files`` holds the files read and written, by name of argument.

    Raises:
        SystemExit: the job failed.
    """
    log = Path(snakemake.log[0])
    begins = "".join(f"{kind} {name}: " for kind, name in snakemake.wildcards.items() if kind in STOPPING)
    earlier, said = records.read_any(log.with_suffix(".json")), list[str]()
    with _opened(log) as stream, single_threaded():

        def say(line: str) -> None:
            said.append(line)
            try:
                print(line, file=stream, flush=True)
            except OSError:  # a full disk must not suppress the message
                _on_screen(line)

        try:
            made = _run(snakemake, stage, log, say, earlier)
            records.write(log.with_suffix(".json"), made | {"said": said})
        except Stopped as error:
            lines = [str(line) for line in error.args]
        except InputError as error:
            lines = [f"{begins}{error}"]
        except (MemoryError, KeyboardInterrupt) as error:
            lines = [f"{begins}{log.stem} {OUT_OF_MEMORY if isinstance(error, MemoryError) else INTERRUPTED}"]
        except (Exception, SystemExit) as error:
            say(traceback.format_exc().rstrip())
            lines = [f"{begins}{records.reason(log.stem, error)['why']}"]
        else:
            return
        for line in lines:
            say(f"error: {line}")
            _on_screen(f"error: {line}")
        sys.exit(1)


def _run(snakemake: Any, stage: Callable[..., None], log: Path, say: Say, earlier: Record) -> Record:
    """Run the stage unless a preceding job was stopped or nothing changed, and return the record of the job."""
    files: Mapping[str, Any] = snakemake.params.get("files", {"reads": {}, "writes": {}})
    kind, name = next(iter(snakemake.wildcards.items()), ("", ""))
    before = [records.load(path) for path in snakemake.input if records.is_record(path)]
    known = {path: digest for each in before if not each["stopped"] for path, digest in each["wrote"].items()}
    partial = kind not in STOPPING or records.joins_parts(before, name)
    reads = records.made(files["reads"], known) if partial else files["reads"]
    settings = {name: value for name, value in snakemake.params.items() if name not in ("code", "files")}
    made = records.of_job(snakemake, settings)
    if inherited := records.inherited(before, kind, name):
        _clear(files["writes"])
        say(f"{name}: stopped in {inherited['stage']}")
        return records.stopped(made, inherited)
    paths = records.flat(reads)
    made["read"] = dict.fromkeys(paths, "")  # stays so if an input cannot be read
    looked_at: records.Signatures = {}
    try:
        looked_at = records.sign(paths)
        made["read"] = {path: digest for path, (_, digest) in looked_at.items()}
        records.check_inputs(made["read"], known)
        if kind in records.FOLDERS and records.holds(earlier, made, records.flat(files["writes"])):
            for line in earlier["said"]:
                say(line)
            return earlier
        _clear(files["writes"])
        named = {"say": say, "stopped": records.reasons(before), **reads, **files["writes"], **settings}
        taken = {name: named[name] for name in signature(stage).parameters if name in named}
        stage(*(value for _, value in snakemake.wildcards.items()), **taken)
        records.check_unchanged(looked_at)
    except (Exception, SystemExit) as error:
        records.check_unchanged(looked_at)  # a file still being copied is not damaged
        if kind not in STOPPING or snakemake.rule.endswith("conventions") or records.is_transient(error):
            raise
        if not isinstance(error, InputError):
            say(traceback.format_exc().rstrip())
        reason = records.reason(log.stem, error)
        say(f"error: {kind} {name}: {reason['why']}")
        _on_screen(f"stopped: {kind} {name}: {reason['why']}")
        _clear(files["writes"])
        return records.stopped(made, reason)
    made["wrote"] = provenance.hashes(records.flat(files["writes"]))
    records.write_hashes(looked_at | {path: (records.sign_file(path), known) for path, known in made["wrote"].items()})
    return made


def _clear(files: Mapping[str, str | Sequence[str]]) -> None:
    """Delete earlier files of a job, as Snakemake does with outputs; a folder in their place makes the job fail."""
    for path in records.flat(files):
        with suppress(OSError):
            os.unlink(path)


@contextmanager
def _opened(log: Path) -> Iterator[TextIO]:
    """Open a new log, or standard error where that fails, as on a full disk."""
    try:
        # Removed first, because it may be a symbolic link, or a hard link to an older copy.
        for left in (log, log.with_suffix(".json")):
            left.unlink(missing_ok=True)
        stream = log.open("w", encoding="utf-8")
    except OSError:
        stream = os.fdopen(os.dup(sys.stderr.fileno()), "w", encoding="utf-8")
    with stream:
        yield stream


def _on_screen(line: str) -> None:
    # Text and newline in one write, so that parallel jobs do not break each other's lines.
    print(f"{line}\n", end="", file=sys.stderr, flush=True)
