"""Run a stage as a job of the workflow: with its log, errors of one line, and a record for provenance.

The record, ``logs/STAGE.json``, states settings, software and the hashes of the files read and written; no decision of
the workflow reads it. If the content of a file cannot be used, the stages before the checkpoint ``usable`` end all the
same: they write the reason into their outputs, which ``usable`` reads.
"""

from __future__ import annotations

import json
import os
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from importlib import import_module
from inspect import signature
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote

from compasslib.archive import provenance
from compasslib.archive.files import write_json, write_reason
from compasslib.errors import InputError, Stopped, TransientError, Unusable
from compasslib.stages import Files, Say
from compasslib.statistics import single_threaded

OUT_OF_MEMORY = "ran out of memory; run again with fewer --cores, so that fewer jobs share it, or on a larger machine"
ROOT = "COMPASSLIB_ROOT"  # environment variable: folder to which the paths of a job are relative
ALWAYS_END = ("read.read", "read.overlap", "fit.calibrate")  # stages before the checkpoint ``usable``
INTERRUPTED = "was interrupted; run again to take it up"
Paths = str | list[str]


def run_job(snakemake: Any) -> None:
    """Run the stage that the parameter ``stage`` names as MODULE.FUNCTION of ``compasslib.stages``."""
    name = snakemake.params.stage
    module, _, function = name.partition(".")
    stage = getattr(import_module(f"compasslib.stages.{module}"), function)
    run_stage(snakemake, stage, always_ends=name in ALWAYS_END)


def run_stage(snakemake: Any, stage: Callable[..., None], *, always_ends: bool = False) -> None:
    """Run one stage with the wildcards, files and settings of its rule.

    If the content of a file cannot be used, a job that ``always_ends`` writes the reason into its outputs; any other
    ends with exit status 1.
    """
    log, wildcards = Path(snakemake.log[0]).absolute(), dict(snakemake.wildcards.items())
    subject = "".join(f"{kind} {name}: " for kind, name in wildcards.items() if kind != "role")

    def say(line: str) -> None:
        with suppress(OSError), log.open("a", encoding="utf-8") as stream:  # on a full disk, errors are on the screen
            print(line, file=stream)

    def show(line: str, title: str = "error") -> None:
        say(f"error: {line}")
        # Text and newline in one write, so that parallel jobs do not break each other's lines.
        print(f"{title}: {line}\n", end="", file=sys.stderr, flush=True)

    try:
        with suppress(OSError):
            log.unlink(missing_ok=True)  # it may be a link, or a hard link to an older copy
            log.touch()
        with single_threaded():
            unusable = _run(snakemake, stage, say, always_ends=always_ends)
        if isinstance(unusable, Unusable):  # the stage that met the reason has told it on the screen
            say(f"error: {subject}{unusable}")
        elif unusable:
            show(f"{subject}{unusable}", "stopped")
        return
    except Stopped as error:
        for line in error.args:
            show(line)
    except InputError as error:
        show(f"{subject}{error}")
    except (MemoryError, KeyboardInterrupt) as error:
        show(f"{subject}{log.stem} {OUT_OF_MEMORY if isinstance(error, MemoryError) else INTERRUPTED}")
    except (Exception, SystemExit) as error:
        say(traceback.format_exc().rstrip())
        what = f"an error of this program in {log.stem}, {type(error).__name__}: {error}; report it"
        names = [name for kind, name in wildcards.items() if kind in ("mooring", "calibration")]
        advice = ", and make the pages of the cruise without it: --config without=" if names else ""
        show(f"{subject}{' '.join(what.split())}{advice}{''.join(names)}")
    sys.exit(1)


def _run(snakemake: Any, stage: Callable[..., None], say: Say, *, always_ends: bool) -> InputError | None:
    """Run the stage and write its record; return why a file is unusable where the job ends all the same."""
    reads, writes = _enter_cruise(snakemake)
    record, unusable = str(writes.pop("job")), None
    texts = [value for value in snakemake.params if isinstance(value, str) and "=" in value]
    settings = unflatten(texts)
    made = {
        "rule": snakemake.rule,
        "of": dict(snakemake.wildcards.items()),
        "software": provenance.software(),
        "library": settings.pop("library", ""),
        # Sorted, since their order in the rule depends on other moorings.
        "parameters": unflatten(sorted(text for text in texts if not text.startswith("library="))),
    }
    try:
        made["read"] = {path: hash_input(path) for path in _flat(reads)}
        call_stage(stage, snakemake.wildcards, Files(**reads, **writes), say, settings)
    except InputError as error:
        unusable = error
    if unusable and (not always_ends or isinstance(unusable, TransientError)):
        raise unusable
    if unusable:
        place = unusable.where.split(": ")[0]  # a file, or words such as "affected instrument"
        file = place if os.path.exists(place) else None
        reason = {"stage": Path(record).stem, "why": str(unusable), "file": file, "advice": unusable.advice}
        for path in _flat(writes):
            write_reason(path, unusable.reason if isinstance(unusable, Unusable) else reason)
    made["wrote"] = provenance.hashes(_flat(writes))
    write_json(record, made)
    return unusable


def call_stage(
    stage: Callable[..., None], wildcards: Iterable[str], files: Files, say: Say, settings: Mapping[str, Any]
) -> None:
    """Call a stage with those settings that are its arguments; others only state the order of its files."""
    asked = signature(stage).parameters
    stage(*wildcards, files, say, **{name: value for name, value in settings.items() if name in asked})


def _enter_cruise(snakemake: Any) -> tuple[dict[str, Paths], dict[str, Paths]]:
    """Change to the cruise folder, or to a storage plug-in's copies; return inputs and outputs relative to it, by name.

    Inputs without a name are only waited for. The YAML files, which are not in a storage, are linked beside the copies.
    """
    root = os.environ.get(ROOT, ".")

    def inside(given: Any) -> Paths:
        return given.removeprefix(f"{root}/") if isinstance(given, str) else [str(inside(path)) for path in given]

    reads, writes = (
        {name: inside(given) for name, given in files.items()} for files in (snakemake.input, snakemake.output)
    )
    if root != ".":
        with suppress(FileExistsError):
            Path(root, "config").symlink_to(Path("config").absolute())
        os.chdir(root)
    return reads, writes


def _flat(files: Mapping[str, Paths]) -> list[str]:
    return [path for given in files.values() for path in ([given] if isinstance(given, str) else given)]


def hash_input(path: str) -> str:
    """Hash an input of a job; if it cannot be read, a raw file is unusable, and a result can be made again."""
    try:
        return provenance.sha256(path)
    except OSError as error:
        expected, advice = "a file that can be read", "correct its permissions or repair the disk"
        kind = TransientError if path.startswith("results/") else InputError
        raise kind(path, expected=expected, found=error.strerror, advice=advice) from error


# Settings as parameters of rules: each value is a text ``key=value``, which Snakemake compares and prints.


def flatten(arguments: Mapping[str, Any]) -> dict[str, str]:
    """Convert arguments of a stage to texts ``key=value``, one for each number, text or switch, with values as JSON."""
    return {path: f"{path}={json.dumps(value, ensure_ascii=False)}" for path, value in _leaves(arguments)}


def _leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the values in mappings and lists, with their paths; other signs in a name than letters are escaped."""
    if isinstance(value, Mapping) and value:
        for name, each in value.items():
            escaped = quote(name, safe="/ ").replace(".", "%2E")
            yield from _leaves(each, f"{path}.{escaped}" if path else escaped)
    elif isinstance(value, list | tuple) and value:
        for k, each in enumerate(value):
            yield from _leaves(each, f"{path}[{k}]")
    elif path:
        yield path, value


def unflatten(texts: Iterable[str]) -> dict[str, Any]:
    """Return the arguments that ``flatten`` converted, with lists in place of tuples."""
    tree: dict[str, Any] = {}
    for text in texts:
        path, value = text.split("=", 1)
        *outer, last = path.replace("[", ".[").split(".")
        inner = tree
        for name in outer:
            inner = inner.setdefault(name, {})
        inner[last] = json.loads(value)
    return _with_lists(tree)


def _with_lists(tree: Any) -> Any:
    if not isinstance(tree, dict):
        return tree
    if "[0]" in tree:
        return [_with_lists(tree[f"[{k}]"]) for k in range(len(tree))]
    return {unquote(name): _with_lists(value) for name, value in tree.items()}


def parameters(settings: Callable[..., dict[str, Any]], subjects: Iterable[tuple[str, ...]]) -> dict[str, Any]:
    """Compose the parameters of a rule, one function for each key; it returns None where a job does not have the key.

    The arguments of the stage are ``settings(*subject)`` by the values of the wildcards; those of () are for all jobs.
    """
    known = {subject: flatten(settings(*subject)) for subject in subjects}
    names = dict.fromkeys(name for texts in known.values() for name in texts)

    def of(name: str) -> Callable[[Any], str | None]:
        return lambda wildcards: known.get(tuple(wildcards), known.get((), {})).get(name)

    # Snakemake compares the sets of values: None is in all of them, so that a key of one job does not concern others.
    return {"none": None} | {f"key{k}": of(name) for k, name in enumerate(names)}
