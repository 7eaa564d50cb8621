"""Records of the jobs: hashes of the files read and written, and the reason why a mooring or calibration was stopped.

Snakemake compares modification times, which ``cp -p`` and rsync preserve, and knows only the record of a job, not its
results. Comparing the records with the present files shows which jobs must run again. All paths are relative to the
cruise folder, which is the working folder.
"""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from compasslib.archive import provenance
from compasslib.archive.files import atomic_write, write_json
from compasslib.errors import InputError, TransientError

RESULTS = "results"
CONCEALED = tuple(f"C{k}" for k in range(1, 5))  # demonstration moorings whose truth is read for one page only
HASHES = ".snakemake/compasslib.hashes"
SIMULATED = ".snakemake/compasslib.simulated"  # files that simulations are about to move into place, by mooring
MANY = 1000
FOLLOWS = "it needs calibration"
FOLDERS = {"mooring": RESULTS, "calibration": f"{RESULTS}/calibrations", "compass": f"{RESULTS}/compasses"}
_MACHINE = (errno.ENOSPC, errno.EDQUOT, errno.ENOMEM, errno.EROFS, errno.EIO, errno.EMFILE, errno.ENFILE, errno.ESTALE)

Signature = tuple[int, ...]  # size, time of modification, time of change (which nobody can set), inode
Signatures = dict[str, tuple[Signature, str]]  # with the SHA-256, by path
Record = dict[str, Any]


@dataclass(frozen=True)
class KnownHashes:
    """Cache of file hashes, by which a cruise of some hundred gigabytes is planned in seconds."""

    known: Signatures = field(default_factory=dict)
    fresh: list[str] = field(default_factory=list)  # files hashed since the cache was read
    digests: dict[str, str] = field(default_factory=dict)  # of files requested, each checked once
    lines: int = 0  # in the cache file, outdated ones included

    def sha256(self, path: str) -> str:
        """Return the SHA-256 of a file, empty where it cannot be read."""
        if path not in self.digests:
            self.digests[path] = ""
            with suppress(OSError):
                now = sign_file(path)
                if path not in self.known or self.known[path][0] != now:
                    self.known[path] = (now, provenance.sha256(path))
                    self.fresh.append(path)
                self.digests[path] = self.known[path][1]
        return self.digests[path]

    def keep(self) -> None:
        """Append new hashes to the cache file, or rewrite the file where most of its lines are outdated."""
        if self.lines > 2 * len(self.known) + MANY:
            with suppress(OSError):
                os.unlink(HASHES)
            self.fresh[:] = self.known
        write_hashes({path: self.known[path] for path in self.fresh})
        self.fresh.clear()


def read_hashes() -> KnownHashes:
    """Read the hashes that earlier runs and jobs stored; a file whose line is incomplete will be hashed again."""
    known: Signatures = {}
    lines = 0
    with suppress(OSError), open(HASHES, encoding="utf-8", errors="surrogateescape") as stream:
        for line in stream:
            lines += 1
            with suppress(ValueError):
                digest, *numbers, path = line.rstrip("\n").split(" ", 5)
                known[path] = (tuple(int(number) for number in numbers), digest)
    return KnownHashes(known, lines=lines)


def write_hashes(known: Mapping[str, tuple[Signature, str]]) -> None:
    """Append hashes to the cache file for the next start; if it cannot be written, that start only takes longer."""
    lines = [f"{digest} {' '.join(map(str, signature))} {path}\n" for path, (signature, digest) in known.items()]
    with suppress(OSError), open(HASHES, "a", encoding="utf-8", errors="surrogateescape") as stream:
        stream.write("".join(lines))


def sign_file(path: str | Path) -> Signature:
    """Return the signature of a file, for which its stored hash is valid."""
    status = os.stat(path)
    return (status.st_size, status.st_mtime_ns, status.st_ctime_ns, status.st_ino)


def sign(paths: Iterable[str]) -> Signatures:
    """Return signature and SHA-256 of each input of a job.

    Raises:
        InputError: a file cannot be read; a ``TransientError`` if a job wrote it or the machine is at fault.
    """
    signed: Signatures = {}
    for path in paths:
        try:
            signed[path] = (sign_file(path), provenance.sha256(path))
        except OSError as error:
            of_machine = path.startswith(f"{RESULTS}/") or error.errno in _MACHINE
            expected, advice = "a file that can be read", "correct its permissions or repair the disk"
            kind = TransientError if of_machine else InputError
            raise kind(path, expected=expected, found=error.strerror, advice=advice) from error
    return signed


def check_inputs(read: Mapping[str, str], known: Mapping[str, str]) -> None:
    """Refuse an input, by path and SHA-256, that differs from what preceding jobs wrote.

    Raises:
        TransientError: an input differs.
    """
    for path, digest in read.items():
        if path.startswith(f"{RESULTS}/") and digest != known.get(path):
            advice = "start the run again, and it is made again"
            raise TransientError(path, expected="the file that its job wrote", found="another", advice=advice)


def check_unchanged(before: Mapping[str, tuple[Signature, str]]) -> None:
    """Refuse a file that was replaced since its signature and SHA-256 were read.

    Raises:
        TransientError: a file has changed.
    """
    for path, (signature, digest) in before.items():
        if sign_file(path) != signature and provenance.sha256(path) != digest:
            advice = "start the run again when it is whole"
            raise TransientError(path, expected="a file that stays as it is", found="one that changed", advice=advice)


def of_job(snakemake: Any, settings: Mapping[str, Any]) -> Record:
    """Create the record of a job that begins: its rule, subject, software, code and settings."""
    return {
        "rule": snakemake.rule,
        "of": dict(snakemake.wildcards.items()),
        "software": provenance.software(),
        "code": dict(snakemake.params.items()).get("code", ""),
        "parameters": dict(settings),
        "read": {},
        "wrote": {},
        "stopped": None,
    }


def write(path: Path, record: Record) -> None:
    """Write the record of a job."""
    with atomic_write(path) as temporary:
        temporary.write_text(json.dumps(record, indent=1, default=str) + "\n")


def holds(earlier: Record, now: Record, writes: Sequence[str]) -> bool:
    """Return whether the results of a job are still valid: unchanged, as are its inputs, settings and code.

    Args:
        earlier: record of the job's previous run, empty where there is none.
        now: record of the present run, with its inputs hashed.
        writes: files that the job writes.
    """
    if earlier.get("stopped", now) is not None or not isinstance(earlier.get("said"), list):
        return False
    as_written = json.loads(json.dumps(now, default=str))
    if any(earlier.get(part) != as_written[part] for part in ("rule", "of", "code", "parameters", "read")):
        return False
    hashes = KnownHashes()
    return earlier.get("wrote") == {path: hashes.sha256(path) for path in writes}


def load(path: str | Path) -> Record:
    """Read a record; a damaged one, or one of an earlier version, is returned empty, and its job must run again."""
    with suppress(OSError, ValueError, TypeError, KeyError):
        record = json.loads(Path(path).read_bytes())
        return {"rule": record["rule"], "of": record["of"], "stopped": record["stopped"]} | {
            part: dict(record[part]) for part in ("read", "wrote")
        }
    return {"rule": "", "of": {}, "read": {}, "wrote": {}, "stopped": None}


def is_record(path: str) -> bool:
    """Return whether a path is that of a record."""
    return path.startswith(f"{RESULTS}/") and path.endswith(".json") and Path(path).parent.name == "logs"


def flat(files: Mapping[str, str | Sequence[str]]) -> list[str]:
    """List the files of a job, given by name of argument, without duplicates."""
    paths = [[given] if isinstance(given, str) else given for given in files.values()]
    return list(dict.fromkeys(str(path) for group in paths for path in group))


def made(files: Mapping[str, str | Sequence[str]], known: Mapping[str, str]) -> dict[str, Any]:
    """Omit from lists of files the results that do not exist because a preceding job was stopped."""

    def there(path: str) -> bool:
        return path in known or not path.startswith(f"{RESULTS}/")

    return {
        name: given if isinstance(given, str) else [path for path in given if there(path)]
        for name, given in files.items()
    }


def is_transient(error: BaseException) -> bool:
    """Return whether an error concerns disk or memory, or a file that the next run will make again."""
    return isinstance(error, (TransientError, MemoryError)) or (isinstance(error, OSError) and error.errno in _MACHINE)


def reason(stage: str, error: BaseException) -> dict[str, Any]:
    """Explain why a mooring or calibration is stopped, as the content of ``stopped.json``."""
    if isinstance(error, InputError):
        return {"stage": stage, "why": str(error), "file": error.where.split(": ")[0], "advice": error.advice}
    what = f"an error of this program in {stage}, {type(error).__name__}: {error}; report it"
    return {"stage": stage, "why": " ".join(what.split()), "file": None, "advice": "report it"}


def inherited(before: Sequence[Record], kind: str, name: str) -> dict[str, Any] | None:
    """Return the reason of a preceding job that stops this one too; a compass is stopped only if all of them were."""
    stops = [record for record in before if record["stopped"]]
    if kind not in FOLDERS or not stops:
        return None
    if kind == "compass" and len(stops) < len(before):
        return None
    if joins_parts(before, name) and {_owner(each) for each in stops} < {_owner(each) for each in before}:
        return None
    first = stops[0]
    its_kind, its_name = next(iter(first["of"].items()))
    if its_kind == "calibration" and (its_kind, its_name) != (kind, name) and kind != "compass":
        return first["stopped"] | {"why": f"{FOLLOWS} {its_name}, which was stopped: {first['stopped']['why']}"}
    return dict(first["stopped"])


def joins_parts(before: Sequence[Record], name: str) -> bool:
    """Return whether a job joins the parts NAME/ROLE of a mooring, for which it can omit stopped parts."""
    return any(_owner(record).startswith(f"{name}/") for record in before)


def _owner(record: Record) -> str:
    return str(next(iter(record["of"].values()), ""))


def stopped(record: Record, why: Mapping[str, Any]) -> Record:
    """Write ``stopped.json`` in place of results, except for a compass, and return the record that states it."""
    kind, name = next(iter(record["of"].items()))
    path = f"{FOLDERS[kind]}/{name}/stopped.json"
    if kind != "compass":
        write_json(path, why)
    return record | {"wrote": provenance.hashes([path] if kind != "compass" else []), "stopped": dict(why)}


def reasons(before: Iterable[Record]) -> dict[str, dict[str, str]]:
    """Collect the reasons why moorings, calibrations and compasses were stopped, by kind and name."""
    plural = {"mooring": "moorings", "calibration": "calibrations", "compass": "compasses"}
    by_kind: dict[str, dict[str, str]] = {kind: {} for kind in plural.values()}
    for record in before:
        if record["stopped"]:
            kind, name = next(iter(record["of"].items()))
            by_kind[plural[kind]].setdefault(name, record["stopped"]["why"])
    return by_kind


def stale(paths: Iterable[str], known: KnownHashes) -> dict[str, str]:
    """Explain for each record of a job with outdated results why it must run again, whatever the times of its files.

    A file that it wrote has been modified or removed, or a file that it read has changed since.
    """
    reasons = {}
    for path in filter(os.path.lexists, paths):
        record = load(path)
        files = record["read"] | record["wrote"]
        other = [
            f"{file} {'changed' if known.sha256(file) else 'is missing'}"
            for file, digest in files.items()
            if known.sha256(file) != digest
        ]
        if other or not record["rule"]:
            reasons[path] = ", ".join(other[:3]) + f" and {len(other) - 3} more" * (len(other) > 3)
            reasons[path] = reasons[path] or "its record cannot be read"
    return reasons


def restore_times(paths: Iterable[str], known: KnownHashes, now: float) -> list[str]:
    """Set the times of unmodified results that are dated after ``now`` to it; return their paths.

    Snakemake fails each job that reads such a file, and finds no input newer than it.
    """
    restored = []
    for record in paths:
        wrote = load(record)["wrote"].items()
        for path in [record, *(path for path, digest in wrote if known.sha256(path) == digest)]:
            if is_future(path, now) and not os.path.islink(path):
                with suppress(OSError):
                    os.utime(path, (now, now))
                    restored.append(path)
    return restored


def is_future(path: str, now: float) -> bool:
    """Return whether a file is dated after the present, ``now``."""
    with suppress(OSError):
        return os.stat(path).st_mtime > now
    return False


def truth_file(name: str) -> str:
    """Return the path of the truth of a simulated mooring, which no stage reads but ``concealed``."""
    return f"concealed/{name}.json" if name in CONCEALED else f"truth/{name}.csv"


def simulated(name: str) -> dict[str, set[str]]:
    """Collect the hashes of the files that the simulation of one mooring has on record as its own, by path."""
    wrote: dict[str, set[str]] = {}
    for path in (Path(f"{RESULTS}/{name}/logs/simulate.json"), Path(SIMULATED) / f"{name}.json"):
        with suppress(OSError, ValueError, TypeError, KeyError):
            for file, digest in dict(json.loads(path.read_bytes())["wrote"]).items():
                wrote.setdefault(file, set()).add(digest)
    return wrote


def compare(old: Path, new: Path) -> list[str]:
    """List the settings and raw files in which two folders of results differ, by the records of their jobs."""
    differ: dict[str, None] = {}
    for path in sorted((new / "logs").glob("*.json")):
        before, after = read_any(old / "logs" / path.name), read_any(path)
        role = f"{after['of']['role']}: " if "role" in after.get("of", {}) else ""
        if before and after:
            texts = provenance.changed_settings(before.get("parameters", {}), after.get("parameters", {}))
            differ |= dict.fromkeys(f"{role}{text}" for text in texts)
        was, now = before.get("read", {}), after.get("read", {})
        common = (file for file in sorted(was.keys() & now.keys()) if not file.startswith(f"{RESULTS}/"))
        differ |= dict.fromkeys(f"{role}{file} changed" for file in common if was[file] != now[file])
    return list(differ)


def read_any(path: Path) -> dict[str, Any]:
    """Read all keys of a record, empty where it cannot be read."""
    with suppress(OSError, ValueError, TypeError):
        return dict(json.loads(path.read_bytes()))
    return {}
