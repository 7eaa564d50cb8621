"""Run a stage as a job of the workflow: with its log, errors of one line, and a record for provenance.

The record, ``logs/STAGE.json``, states settings, software and the hashes of the files read and written; no decision of
the workflow reads it. If the content of a file cannot be used, the stages before the checkpoint ``usable`` end all the
same: they write the reason into their outputs, which ``usable`` reads.
"""

from __future__ import annotations

import gc
import os
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from inspect import signature
from pathlib import Path
from typing import Any, TextIO

from compasslib.archive import provenance
from compasslib.archive.files import write_json, write_reason
from compasslib.errors import InputError, Stopped, TransientError, Unusable
from compasslib.pipeline.keys import unflatten
from compasslib.statistics import single_threaded

OUT_OF_MEMORY = "ran out of memory; run again with fewer --cores, so that fewer jobs share it, or on a larger machine"
ROOT = "COMPASSLIB_ROOT"  # environment variable: folder to which the paths of a job are relative
ALWAYS_END = ("read.read", "overlap.overlap", "calibrate.calibrate")  # stages before the checkpoint ``usable``
INTERRUPTED = "was interrupted; run again to take it up"
Paths = str | list[str]


def run_job(snakemake: Any) -> None:
    """Run the stage that the parameter ``stage`` names as MODULE.FUNCTION of ``compasslib.stages``; see ``run_stage``.

    Raises:
        SystemExit: the job failed.
    """
    module, _, function = snakemake.params.stage.partition(".")
    stage = getattr(import_module(f"compasslib.stages.{module}"), function)
    run_stage(snakemake, stage, always_ends=snakemake.params.stage in ALWAYS_END)


def run_stage(snakemake: Any, stage: Callable[..., None], *, always_ends: bool = False) -> None:
    """Run one stage with its wildcards in order, and the files and settings of its rule by name of argument.

    The argument ``say`` writes a line to the job's log.

    Args:
        snakemake: object of the script; of its outputs, ``job`` is the record.
        always_ends: whether the job ends without an error if the content of a file cannot be used, with the reason in
            its outputs.

    Raises:
        SystemExit: the job failed.
    """
    log, label = Path(snakemake.log[0]).absolute(), Path(snakemake.log[0]).stem
    subject = "".join(f"{kind} {name}: " for kind, name in snakemake.wildcards.items() if kind != "role")
    with _opened(log) as stream, single_threaded():

        def say(line: str) -> None:
            with suppress(OSError):  # on a full disk, errors are on the screen alone
                print(line, file=stream, flush=True)

        def end(line: str) -> None:
            say(f"error: {line}")
            _on_screen(f"error: {line}")

        try:
            _run(snakemake, stage, say, subject if always_ends else None)
        except Stopped as error:
            for line in error.args:
                end(line)
        except InputError as error:
            end(f"{subject}{error}")
        except (MemoryError, KeyboardInterrupt) as error:
            end(f"{subject}{label} {OUT_OF_MEMORY if isinstance(error, MemoryError) else INTERRUPTED}")
        except (Exception, SystemExit) as error:
            say(traceback.format_exc().rstrip())
            what = f"an error of this program in {label}, {type(error).__name__}: {error}; report it"
            names = [name for kind, name in snakemake.wildcards.items() if kind in ("mooring", "calibration")]
            advice = ", and make the pages of the cruise without it: --config without=" if names else ""
            end(f"{subject}{' '.join(what.split())}{advice}{''.join(names)}")
        else:
            gc.freeze()  # the garbage collection at exit would take a twentieth of a small job's time
            return
    sys.exit(1)


def _run(snakemake: Any, stage: Callable[..., None], say: Callable[[str], None], subject: str | None) -> None:
    """Run the stage and write its record; where ``subject`` is given, an unusable file is a reason, not an error."""
    reads, writes = _enter_cruise(snakemake)
    record = str(writes.pop("job"))
    settings = unflatten(value for value in snakemake.params if isinstance(value, str) and "=" in value)
    made = {
        "rule": snakemake.rule,
        "of": dict(snakemake.wildcards.items()),
        "software": provenance.software(),
        "library": settings.pop("library", ""),
        "parameters": settings,
    }
    signatures = {path: _sign(path) for path in _flat(reads.values())}
    try:
        made["read"] = _hashes(signatures)
        taken = signature(stage).parameters
        named = {"say": say, **reads, **writes, **settings}
        stage(*snakemake.wildcards, **{name: value for name, value in named.items() if name in taken})
    except InputError as error:
        _refuse_changed(signatures)  # a file still being copied is not damaged
        if subject is None or isinstance(error, TransientError):
            raise
        place = error.where.split(": ")[0]  # a file, or words such as "affected instrument"
        file = place if os.path.exists(place) else None
        reason = {"stage": Path(record).stem, "why": str(error), "file": file, "advice": error.advice}
        reason = error.reason if isinstance(error, Unusable) else reason
        for path in _flat(writes.values()):
            write_reason(path, reason)
        say(f"error: {subject}{reason['why']}")
        if not isinstance(error, Unusable):  # else the stage that met the reason has told it
            _on_screen(f"stopped: {subject}{reason['why']}")
    _refuse_changed(signatures)
    made["wrote"] = provenance.hashes(_flat(writes.values()))
    write_json(record, made)


def _enter_cruise(snakemake: Any) -> tuple[dict[str, Paths], dict[str, Paths]]:
    """Change to the cruise folder, or to a storage plug-in's copies; return inputs and outputs relative to it, by name.

    Inputs without a name are only waited for. The YAML files, which are not in a storage, are linked beside the copies.
    """
    root = os.environ.get(ROOT, ".")
    reads, writes = (
        {
            name: given.removeprefix(f"{root}/")
            if isinstance(given, str)
            else [path.removeprefix(f"{root}/") for path in given]
            for name, given in files.items()
        }
        for files in (snakemake.input, snakemake.output)
    )
    if root != ".":
        with suppress(FileExistsError):
            Path(root, "config").symlink_to(Path("config").absolute())
        os.chdir(root)
    return reads, writes


def _flat(files: Any) -> list[str]:
    return list(dict.fromkeys(path for given in files for path in ([given] if isinstance(given, str) else given)))


def _sign(path: str) -> tuple[int, int]:
    status = os.stat(path)
    return status.st_size, status.st_mtime_ns


def _hashes(signatures: Sequence[str] | dict[str, tuple[int, int]]) -> dict[str, str]:
    """Hash the inputs of a job.

    Raises:
        InputError: a raw file cannot be read.
        TransientError: a result cannot be read.
    """
    known = {}
    for path in signatures:
        try:
            known[path] = provenance.sha256(path)
        except OSError as error:
            expected, advice = "a file that can be read", "correct its permissions or repair the disk"
            kind = TransientError if path.startswith("results/") else InputError
            raise kind(path, expected=expected, found=error.strerror, advice=advice) from error
    return known


def _refuse_changed(before: dict[str, tuple[int, int]]) -> None:
    """Raise TransientError if an input changed while the job read it."""
    for path, known in before.items():
        if _sign(path) != known:
            advice = "start the run again when it is whole"
            raise TransientError(path, expected="a file that stays as it is", found="one that changed", advice=advice)


@contextmanager
def _opened(log: Path) -> Iterator[TextIO]:
    """Open a new log, or none where that fails, as on a full disk."""
    try:
        log.unlink(missing_ok=True)  # it may be a link, or a hard link to an older copy
        stream = log.open("w", encoding="utf-8")
    except OSError:
        stream = os.fdopen(os.open(os.devnull, os.O_WRONLY), "w", encoding="utf-8")
    try:
        yield stream
    finally:
        with suppress(OSError):  # raised by lines that did not fit on the disk
            stream.close()


def _on_screen(line: str) -> None:
    # Text and newline in one write, so that parallel jobs do not break each other's lines.
    print(f"{line}\n", end="", file=sys.stderr, flush=True)
