"""Records of the jobs: what each read and wrote, by hash, and why a mooring or calibration was stopped.

Snakemake goes by times, which ``cp -p`` and rsync carry along, and knows a job by its record alone. Held against the
files as they are, the records tell which jobs are to run again. All paths are relative to the cruise folder, which is
the working folder.
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
CONCEALED = tuple(f"C{k}" for k in range(1, 5))  # moorings of the demonstration whose truth one page alone reads
HASHES = ".snakemake/compasslib.hashes"
SIMULATED = ".snakemake/compasslib.simulated"  # what a simulation was about to put in place, a file a mooring
MANY = 1000
FOLLOWS = "it needs calibration"
FOLDERS = {"mooring": RESULTS, "calibration": f"{RESULTS}/calibrations", "compass": f"{RESULTS}/compasses"}
_MACHINE = (errno.ENOSPC, errno.EDQUOT, errno.ENOMEM, errno.EROFS, errno.EIO, errno.EMFILE, errno.ENFILE, errno.ESTALE)

Signature = tuple[int, ...]  # size, time of modification, time of change (which nobody can set), inode
Signatures = dict[str, tuple[Signature, str]]  # with the SHA-256, by path
Record = dict[str, Any]


@dataclass(frozen=True)
class KnownHashes:
    """Hashes of files that need no second look: a cruise of some hundred gigabytes is planned in seconds."""

    known: Signatures = field(default_factory=dict)
    fresh: list[str] = field(default_factory=list)  # files hashed since
    digests: dict[str, str] = field(default_factory=dict)  # of files asked for, each looked at once
    lines: int = 0  # that were written down, older ones of the same file included

    def sha256(self, path: str) -> str:
        """Hash a file (SHA-256), nothing where it cannot be read."""
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
        """Write down what was hashed; all of it anew where most lines are of times gone by."""
        if self.lines > 2 * len(self.known) + MANY:
            with suppress(OSError):
                os.unlink(HASHES)
            self.fresh[:] = self.known
        write_hashes({path: self.known[path] for path in self.fresh})
        self.fresh.clear()


def read_hashes() -> KnownHashes:
    """Read the hashes that earlier runs and jobs wrote down; a line that was torn is a file looked at again."""
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
    """Write hashes down for the next start; a place that cannot be written to costs that start its time."""
    lines = [f"{digest} {' '.join(map(str, signature))} {path}\n" for path, (signature, digest) in known.items()]
    with suppress(OSError), open(HASHES, "a", encoding="utf-8", errors="surrogateescape") as stream:
        stream.write("".join(lines))


def sign_file(path: str | Path) -> Signature:
    """Read the signature that a file's hash is remembered by."""
    status = os.stat(path)
    return (status.st_size, status.st_mtime_ns, status.st_ctime_ns, status.st_ino)


def sign(paths: Iterable[str]) -> Signatures:
    """Read signature and SHA-256 of each input of a job.

    Raises:
        InputError: one cannot be read; a ``TransientError`` one where another job wrote it.
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
    """Refuse an input that is not what its job wrote.

    Args:
        read: SHA-256 of each input of a job.
        known: SHA-256 by path of what the jobs before it wrote.

    Raises:
        TransientError: one is another.
    """
    for path, digest in read.items():
        if path.startswith(f"{RESULTS}/") and digest != known.get(path):
            advice = "start the run again, and it is made again"
            raise TransientError(path, expected="the file that its job wrote", found="another", advice=advice)


def check_unchanged(before: Mapping[str, tuple[Signature, str]]) -> None:
    """Refuse what was replaced while a job read it.

    Args:
        before: as the job began.

    Raises:
        TransientError: one is another.
    """
    for path, (signature, digest) in before.items():
        if sign_file(path) != signature and provenance.sha256(path) != digest:
            advice = "start the run again when it is whole"
            raise TransientError(path, expected="a file that stays as it is", found="one that changed", advice=advice)


def of_job(snakemake: Any, settings: Mapping[str, Any]) -> Record:
    """Begin the record of a job: its rule, what it is of, by what code and with which settings."""
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
        earlier: the record of the job, empty where there is none.
        now: the record that the job begins with, its inputs hashed.
        writes: files of the job.
    """
    if earlier.get("stopped", now) is not None or not isinstance(earlier.get("said"), list):
        return False
    as_written = json.loads(json.dumps(now, default=str))
    if any(earlier.get(part) != as_written[part] for part in ("rule", "of", "code", "parameters", "read")):
        return False
    hashes = KnownHashes()
    return earlier.get("wrote") == {path: hashes.sha256(path) for path in writes}


def load(path: str | Path) -> Record:
    """Read a record; one that is damaged, or of an earlier version, is empty and its job is to run again."""
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
    """List the files that a job has by name, each once."""
    paths = [[given] if isinstance(given, str) else given for given in files.values()]
    return list(dict.fromkeys(str(path) for group in paths for path in group))


def made(files: Mapping[str, str | Sequence[str]], known: Mapping[str, str]) -> dict[str, Any]:
    """Leave out the results that are not there, as something before them was stopped."""

    def there(path: str) -> bool:
        return path in known or not path.startswith(f"{RESULTS}/")

    return {
        name: given if isinstance(given, str) else [path for path in given if there(path)]
        for name, given in files.items()
    }


def is_transient(error: BaseException) -> bool:
    """Return whether an error is one of disk or memory, or of a file that the next run makes again."""
    return isinstance(error, (TransientError, MemoryError)) or (isinstance(error, OSError) and error.errno in _MACHINE)


def reason(stage: str, error: BaseException) -> dict[str, Any]:
    """Describe why a mooring or calibration is stopped, as ``stopped.json`` has it."""
    if isinstance(error, InputError):
        return {"stage": stage, "why": str(error), "file": error.where.split(": ")[0], "advice": error.advice}
    what = f"an error of this program in {stage}, {type(error).__name__}: {error}; report it"
    return {"stage": stage, "why": " ".join(what.split()), "file": None, "advice": "report it"}


def inherited(before: Sequence[Record], kind: str, name: str) -> dict[str, Any] | None:
    """Find the reason that stops a job as well: that of a job before it, for a compass where all were stopped.

    Args:
        kind: ``mooring``, ``calibration`` or ``compass``; nothing else inherits.
        name: of that which the job is of.
    """
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
    """Return whether a job joins the parts of a mooring, NAME/ROLE: it does without those that are stopped."""
    return any(_owner(record).startswith(f"{name}/") for record in before)


def _owner(record: Record) -> str:
    return str(next(iter(record["of"].values()), ""))


def stopped(record: Record, why: Mapping[str, Any]) -> Record:
    """Leave ``stopped.json`` in place of results, and return the record that says so."""
    kind, name = next(iter(record["of"].items()))
    path = f"{FOLDERS[kind]}/{name}/stopped.json"
    if kind != "compass":
        write_json(path, why)
    return record | {"wrote": provenance.hashes([path] if kind != "compass" else []), "stopped": dict(why)}


def reasons(before: Iterable[Record]) -> dict[str, dict[str, str]]:
    """Gather why moorings, calibrations and compasses were stopped, by name."""
    by_kind: dict[str, dict[str, str]] = {f"{kind}s" if kind != "compass" else "compasses": {} for kind in FOLDERS}
    for record in before:
        if record["stopped"]:
            kind, name = next(iter(record["of"].items()))
            by_kind["compasses" if kind == "compass" else f"{kind}s"].setdefault(name, record["stopped"]["why"])
    return by_kind


def stale(paths: Iterable[str], known: KnownHashes) -> dict[str, str]:
    """Explain for each job that is to run again, although the times of its files say that nothing changed, why.

    Something that it wrote is not as it wrote it, or was made from a file that has since become another.

    Args:
        paths: records of all jobs of the cruise.
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
    """Set results that are as recorded, but dated in the future, to the present; return their paths.

    Snakemake fails each job that reads such a file, and takes no change for newer than it.

    Args:
        paths: records of all jobs of the cruise.
        now: by the clock that dates the files, seconds since 1970.
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
    """Name the file in which the simulation of a mooring tells the truth; no stage but one page reads it."""
    return f"concealed/{name}.json" if name in CONCEALED else f"truth/{name}.csv"


def simulated(name: str) -> dict[str, set[str]]:
    """Collect the hashes of raw files that the simulation of one mooring provably wrote, by path."""
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
    """Read a record whole, empty where it cannot be read."""
    with suppress(OSError, ValueError, TypeError):
        return dict(json.loads(path.read_bytes()))
    return {}
