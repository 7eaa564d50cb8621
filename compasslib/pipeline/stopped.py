"""Moorings and calibrations whose files cannot be used: each is left out with its reason, and the others go on."""

from __future__ import annotations

import errno
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from compasslib.errors import InputError, TransientError
from compasslib.pipeline import ledger

if TYPE_CHECKING:  # every job imports this room, none the configuration
    from compasslib.config.cruise import Cruise

ENDING = ".stopped"
CHECKS = ("conventions", "verify")  # by their logs: they judge products, which stand whatever they find
CALIBRATIONS, COMPASSES = "calibrations", "compasses"


@dataclass
class Stopped:
    """Reasons by name."""

    moorings: dict[str, str] = field(default_factory=dict)
    calibrations: dict[str, str] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.moorings) + len(self.calibrations)

    def look(self, cruise: Cruise) -> bool:
        """Take up what jobs have left and what depends on it; return whether there is more than before."""
        before = len(self)
        self.moorings |= _left(cruise.moorings, "")
        self.calibrations |= _left(cruise.calibrations, f"{CALIBRATIONS}/")
        # In the order of their number at most: a calibration may be compared with one that is compared with another.
        for _ in cruise.calibrations:
            for name, calibration in cruise.calibrations.items():
                self._follow(self.calibrations, name, calibration.compare_with)
        for name, mooring in cruise.moorings.items():
            self._follow(self.moorings, name, mooring.fit.name)
        return len(self) > before

    def _follow(self, reasons: dict[str, str], name: str, needs: str | None) -> None:
        if needs in self.calibrations and name not in reasons:
            reasons[name] = f"it needs calibration {needs}, which was stopped: {self.calibrations[needs]}"


def named(wildcards: Any) -> str:
    """Return how a job's line of error begins: with the mooring or calibration that it is of."""
    named = dict(wildcards.items())
    return next((f"{kind} {named[kind]}: " for kind in ("mooring", "calibration") if kind in named), "")


def leave(job: Any, error: Exception | SystemExit) -> str:
    """Leave the reason beside the log of a mooring's or calibration's job, where it is not one of disk or memory.

    Args:
        job: the object ``snakemake`` of its script.

    Returns:
        The reason in one line.
    """
    log = Path(job.log[0])
    what = f"an error of this program in {log.stem}, {type(error).__name__}: {error}; report it"
    line = " ".join((str(error) if isinstance(error, InputError) else what).split())
    of_machine = isinstance(error, TransientError) or (isinstance(error, OSError) and error.errno in _MACHINE)
    if not of_machine and log.stem not in CHECKS and named(job.wildcards):
        with suppress(OSError):
            log.with_suffix(ENDING).write_text(f"{line}\n", encoding="utf-8", errors="backslashreplace")
    return line


_MACHINE = (errno.ENOSPC, errno.EDQUOT, errno.ENOMEM, errno.EROFS, errno.EIO, errno.EMFILE, errno.ENFILE, errno.ESTALE)


def forget(cruise: Cruise) -> None:
    """Delete the reasons of an earlier run."""
    for name in folders(cruise):
        for path in Path(ledger.RESULTS, name, "logs").glob(f"*{ENDING}"):
            path.unlink()


def folders(cruise: Cruise) -> list[str]:
    """Return the folders of all moorings', calibrations' and compasses' results."""
    named = [mooring.instruments[mooring.compromised].compass for mooring in cruise.moorings.values()]
    named += [calibration.compass for calibration in cruise.calibrations.values()]
    calibrated = (f"{CALIBRATIONS}/{name}" for name in cruise.calibrations)
    return [*cruise.moorings, *calibrated, *(f"{COMPASSES}/{name}" for name in sorted({*filter(None, named)}))]


def _left(names: Any, folder: str) -> dict[str, str]:
    found = {}
    for name in names:
        for path in sorted(Path(ledger.RESULTS, f"{folder}{name}", "logs").glob(f"*{ENDING}"))[:1]:
            found[name] = path.read_text(encoding="utf-8").strip()
    return found
