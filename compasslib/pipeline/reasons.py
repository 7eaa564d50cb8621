"""Why a job would run again: its settings, its code and its files held against the record that its last run left."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from compasslib.archive import provenance
from compasslib.pipeline import ledger
from compasslib.pipeline.ledger import KnownHashes

MOST, LONGEST = 4, 40  # reasons in one line; characters of a setting
FOLLOWS = "follows from the lines above"


def lines(jobs: Mapping[str, Any], known: KnownHashes) -> list[str]:
    """Return one line for each mooring, calibration and for the cruise: the first job, how many follow, and why.

    Args:
        jobs: those that would run, in the order of the stages, by what they are called.
        known: hashes of the files as they are.
    """
    return [_line(name, of, known) for name, of in _by_folder(jobs).items()]


def because(job: Any, known: KnownHashes) -> list[str]:
    """Return which settings and files are others than when a job last ran; none where the jobs before it make it run.

    Args:
        job: Snakemake's.
    """
    record = _record(job)
    if not record:
        return ["not made yet"]
    return [*_settings(record, job), *_read(record, job, known), *_wrote(record, job, known)]


def between(old: Path, new: Path) -> list[str]:
    """Return in which settings and raw files two folders of results differ, by the records of their jobs."""
    found: dict[str, None] = {}
    for path in sorted((new / "logs").glob("*.json")):
        before, after = _loaded(old / "logs" / path.name), _loaded(path)
        role = f"{after['of']['role']}: " if "role" in after.get("of", {}) else ""
        differ = _differing(before.get("parameters", {}), after.get("parameters", {})) if before and after else ()
        found |= dict.fromkeys(f"{role}{text}" for text in differ)
        was, now = before.get("read", {}), after.get("read", {})
        other = (file for file in sorted(was.keys() & now.keys()) if not _made(file) and was[file] != now[file])
        found |= dict.fromkeys(f"{role}{file} changed" for file in other)
    return list(found)


def _by_folder(jobs: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    found: dict[str, dict[str, Any]] = {}
    for label, job in jobs.items():
        folder = Path(job.log[0]).parent.parent.relative_to(ledger.RESULTS).as_posix()
        found.setdefault("" if folder == "." else folder, {})[label] = job
    whole = found.pop("", {})
    return found | ({"": whole} if whole else {})


def _line(name: str, jobs: Mapping[str, Any], known: KnownHashes) -> str:
    first = next(iter(jobs)) if name else ", ".join(jobs)
    more = f" and {len(jobs) - 1} more" if name and len(jobs) > 1 else ""
    why = list(dict.fromkeys(reason for job in jobs.values() for reason in because(job, known)))
    edited = [job.rule.name for job in jobs.values() if _edited(job)]
    why += [f"code of {', '.join(dict.fromkeys(edited))} changed"] if edited else []
    rest = [f"and {len(why) - MOST} more reasons"] if len(why) > MOST else []
    return f"{first}{more}: {'; '.join([*why[:MOST], *rest]) or FOLLOWS}"


def _record(job: Any) -> dict[str, Any]:
    return _loaded(Path(job.log[0]).with_suffix(".json"))


def _loaded(path: Path) -> dict[str, Any]:
    try:
        return dict(json.loads(path.read_bytes()))
    except (OSError, ValueError, TypeError):
        return {}


def _settings(record: Mapping[str, Any], job: Any) -> Iterator[str]:
    now = json.loads(json.dumps(dict(job.params.items()), default=str))
    now.pop("code", None)
    yield from _differing(record.get("parameters", {}), now)


def _differing(old: Mapping[str, Any], new: Mapping[str, Any]) -> Iterator[str]:
    before, after = dict(_leaves(old)), dict(_leaves(new))
    for key in dict.fromkeys((*before, *after)):
        if before.get(key) != after.get(key):
            yield f"{key} was {_shown(before.get(key))}, is {_shown(after.get(key))}"


def _leaves(value: Any, *keys: str) -> Iterator[tuple[str, Any]]:
    """Give each setting by its keys; the outermost is the parameter of the rule, which no YAML file knows."""
    if isinstance(value, dict) and value:
        for name, inner in value.items():
            yield from _leaves(inner, *keys, name)
    else:
        yield ".".join(keys[1:] or keys), value


def _shown(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 3]}..."


def _edited(job: Any) -> bool:
    record = _record(job)
    return bool(record) and record.get("code", "") != dict(job.params.items()).get("code", "")


def _read(record: Mapping[str, Any], job: Any, known: KnownHashes) -> Iterator[str]:
    before, now = record.get("read", {}), set(provenance.inputs(job))
    for path in sorted(path for path in {*before, *now} if not _made(path)):
        if path not in now:
            yield f"{path} is not read any more"
        elif path not in before:
            yield f"{path} is read too"
        elif known.sha256(path) != before[path]:
            yield f"{path} changed"


def _made(path: str) -> bool:
    return path.startswith(f"{ledger.RESULTS}/")


def _wrote(record: Mapping[str, Any], job: Any, known: KnownHashes) -> Iterator[str]:
    wrote = record.get("wrote", {})
    for path in map(str, job.output):
        if not (digest := known.sha256(path)):
            yield f"{path} is missing"
        elif path in wrote and digest != wrote[path]:
            yield f"{path} is not what its job wrote"
