"""Recorded hashes decide: what each job of a cruise read and wrote, held against the files as they are now.

Snakemake goes by times, which ``cp -p`` and rsync carry along, and does not miss an intermediate file. The records of
the jobs (``provenance.of_job``) tell both. All paths are relative to the cruise folder, which is the working folder.
"""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from compasslib.archive import provenance
from compasslib.errors import InputError, TransientError

RESULTS = "results"
SEEN = ".snakemake/compasslib.hashes"
MANY = 1000
SIMULATED = ".snakemake/compasslib.simulated"  # what a simulation was about to put in place, a file a mooring
Signature = tuple[int, ...]
Record = Mapping[str, dict[str, str]]  # SHA-256 by path, of what was read and of what was written


def signature(path: str | Path) -> Signature:
    """Return what a file's hash is remembered by; the third, the time of change, is the kernel's and nobody else's."""
    found = os.stat(path)
    return (found.st_size, found.st_mtime_ns, found.st_ctime_ns, found.st_ino)


@dataclass(frozen=True)
class KnownHashes:
    """Hashes of files that need no second look: a cruise of some hundred gigabytes is planned in seconds."""

    known: dict[str, tuple[Signature, str]] = field(default_factory=dict)
    fresh: list[str] = field(default_factory=list)  # files hashed since
    digests: dict[str, str] = field(default_factory=dict)  # of files asked for, each looked at once
    lines: int = 0  # that were written down, older ones of the same file included

    def sha256(self, path: str) -> str:
        """Return the SHA-256 of a file, nothing where it cannot be read."""
        if path not in self.digests:
            self.digests[path] = self._looked_up(path)
        return self.digests[path]

    def _looked_up(self, path: str) -> str:
        try:
            now = signature(path)
            if path not in self.known or self.known[path][0] != now:
                self.known[path] = (now, provenance.sha256(path))
                self.fresh.append(path)
        except OSError:
            return ""
        return self.known[path][1]

    def keep(self) -> None:
        """Write down what was hashed; all of it anew where most lines are of times gone by."""
        if self.lines > 2 * len(self.known) + MANY:
            with suppress(OSError):
                os.unlink(SEEN)
            self.fresh[:] = self.known
        remember({path: self.known[path] for path in self.fresh})
        self.fresh.clear()


def seen() -> KnownHashes:
    """Return what earlier runs and jobs have written down; a line that was torn is a file looked at again."""
    known: dict[str, tuple[Signature, str]] = {}
    lines = 0
    with suppress(OSError), open(SEEN, encoding="utf-8", errors="surrogateescape") as stream:
        for line in stream:
            lines += 1
            with suppress(ValueError):
                digest, *numbers, path = line.rstrip("\n").split(" ", 5)
                known[path] = (tuple(int(number) for number in numbers), digest)
    return KnownHashes(known, lines=lines)


def remember(known: Mapping[str, tuple[Signature, str]]) -> None:
    """Write hashes down for the next start; a place that cannot be written to costs that start its time.

    Args:
        known: signature and SHA-256 by path.
    """
    lines = [f"{digest} {' '.join(map(str, known_by))} {path}\n" for path, (known_by, digest) in known.items()]
    with suppress(OSError), open(SEEN, "a", encoding="utf-8", errors="surrogateescape") as stream:
        stream.write("".join(lines))


def records(names: Iterable[str]) -> Iterator[Record]:
    """Give the records of jobs that are whole.

    Args:
        names: folders of results, "" for the cruise's own.
    """
    for name in names:
        for path in _records_in(f"{RESULTS}/{name}"):
            yield _record(path)


def stale(made: Collection[str], names: Iterable[str], known: KnownHashes) -> set[str]:
    """Return files that are to be made again, although their times say that they are new.

    They are not what their job wrote, have no record, or were made from a file that has since become another.

    Args:
        made: all files that the rules make now.
        names: folders of results, see ``records``.
    """
    writers = [record for record in records(names) if not record["wrote"].keys().isdisjoint(made)]
    right = {path for record in writers for path, digest in record["wrote"].items() if known.sha256(path) == digest}
    again, recorded = set[str](), set[str]()
    for record in writers:
        wrong = {path for path, digest in record["wrote"].items() if known.sha256(path) != digest}
        if not wrong.isdisjoint(right):  # a rule of another name has left a record of the same file
            continue
        recorded |= record["wrote"].keys()
        if wrong or any(known.sha256(path) != digest for path, digest in record["read"].items()):
            again |= record["wrote"].keys()
    return (again & set(made)) | {path for path in made if path not in recorded and os.path.lexists(path)}


def restore_times(names: Iterable[str], known: KnownHashes, now: float) -> list[str]:
    """Set results that are as recorded, but dated in the future, to the present; return their paths.

    Snakemake fails each job that reads such a file, and takes no change for newer than it.

    Args:
        names: folders of results, see ``records``.
        now: by the clock that dates the files, seconds since 1970.
    """
    restored = []
    for path, digest in [item for record in records(names) for item in record["wrote"].items()]:
        if is_future(path, now) and not os.path.islink(path) and known.sha256(path) == digest:
            with suppress(OSError):
                os.utime(path, (now, now))
                restored.append(path)
    return restored


def is_future(path: str, now: float) -> bool:
    """Return whether a file is dated after the present.

    Args:
        now: see ``restore_times``.
    """
    with suppress(OSError):
        return os.stat(path).st_mtime > now
    return False


def looked_at(paths: Iterable[str]) -> dict[str, tuple[Signature, str]]:
    """Return signature and SHA-256 of each input of a job.

    Raises:
        InputError: one cannot be read; a ``Passing`` one where another job wrote it.
    """
    found = {}
    for path in paths:
        try:
            found[path] = (signature(path), provenance.sha256(path))
        except OSError as error:
            kind = TransientError if path.startswith(f"{RESULTS}/") else InputError
            advice = "mend its permissions or the disk"
            raise kind(path, expected="a file that can be read", found=error.strerror, advice=advice) from error
    return found


def hold(read: Mapping[str, str]) -> None:
    """Refuse an input that is not what its job wrote.

    Args:
        read: SHA-256 of each input of a job.

    Raises:
        Passing: one is another.
    """
    for folder in sorted({_folder(path) for path in read if path.startswith(f"{RESULTS}/")}):
        wrote = [item for path in _records_in(folder) for item in _record(path)["wrote"].items()]
        paths = {path for path, _ in wrote}
        for path, digest in read.items():
            if path in paths and (path, digest) not in wrote:
                advice = "start the run again, and it is made again"
                raise TransientError(path, expected="the file that its job wrote", found="another", advice=advice)


def unchanged(before: Mapping[str, tuple[Signature, str]]) -> None:
    """Refuse what was replaced while a job read it.

    Args:
        before: signature and SHA-256 of each input as the job began.

    Raises:
        Passing: one is another.
    """
    for path, (then, digest) in before.items():
        if signature(path) != then and provenance.sha256(path) != digest:
            advice = "start the run again when it is whole"
            raise TransientError(path, expected="a file that stays as it is", found="one that changed", advice=advice)


def clear_orphans(name: str) -> list[str]:
    """Delete what was made from results that are no more, and return it; what no job wrote stays.

    Args:
        name: folder of results of a mooring or calibration.
    """
    cleared: list[str] = []
    left = _records_in(f"{RESULTS}/{name}")
    while orphans := [path for path in left if not _has_inputs(_record(path))]:
        for path in orphans:
            cleared += [made for made, digest in _record(path)["wrote"].items() if _removed(made, digest)]
            path.unlink()
            left.remove(path)
    return cleared


def simulated(name: str) -> dict[str, set[str]]:
    """Return the hashes of raw files that the simulation of one mooring provably wrote, by path."""
    wrote: dict[str, set[str]] = {}
    for path in (Path(f"{RESULTS}/{name}/logs/simulate.json"), Path(SIMULATED) / f"{name}.json"):
        for file, digest in _record(path)["wrote"].items():
            wrote.setdefault(file, set()).add(digest)
    return wrote


def _records_in(folder: str) -> list[Path]:
    logs = f"{folder}/logs"
    there = sorted(os.listdir(logs)) if os.path.isdir(logs) else []
    return [Path(logs, name) for name in there if name.endswith(".json")]


def _record(path: Path) -> Record:
    """Return what a job read and wrote; a record that is damaged is none, so that its files are made again."""
    with suppress(OSError, ValueError, TypeError, KeyError):
        record = json.loads(path.read_bytes())
        return {part: dict(record[part]) for part in ("read", "wrote")}
    return {"read": {}, "wrote": {}}


def _folder(path: str) -> str:
    """Return the folder of the mooring, of the calibration or of the cruise that a file of the results belongs to."""
    parts = path.split("/")
    return "/".join(parts[: min(3 if parts[1] in ("calibrations", "compasses") else 2, len(parts) - 1)])


def _has_inputs(record: Record) -> bool:
    return all(os.path.lexists(path) for path in record["read"] if path.startswith(f"{RESULTS}/"))


def _removed(path: str, digest: str) -> bool:
    file = Path(path)
    ours = path.startswith(f"{RESULTS}/") and not file.is_symlink() and file.is_file()
    if not ours or provenance.sha256(file) != digest:
        return False
    file.unlink()
    return True
