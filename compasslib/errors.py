"""Exceptions shown to users: location, expected input, found input, and advice."""

from collections.abc import Mapping
from typing import Any

MAX_PART, MAX_FOUND = 1000, 300  # maximum characters of a part of the message, and of the input found


class InputError(Exception):
    """Input that cannot be used, with a message of one line.

    Args:
        where: file, with key or record, e.g. ``config/moorings/EG4.yaml: latitude``.
    """

    def __init__(self, where: str, expected: str, found: object, advice: str):
        where, expected, advice = (_short(part, MAX_PART) for part in (where, expected, advice))
        line = f"{where}: expected {expected}, found {_short(found, MAX_FOUND)}; {advice}"
        # File names may contain bytes that are not valid UTF-8: they are shown as escapes.
        super().__init__(" ".join(line.split()).encode("utf-8", "backslashreplace").decode())
        self.where, self.advice = where, advice
        self.others: tuple[InputError, ...] = ()  # further errors in the same file


class TransientError(InputError):
    """Failure of the disk, or of a file that the next run rebuilds, which does not imply invalid input."""


class Unusable(InputError):
    """Result that an earlier stage wrote for a file that cannot be used, with the reason in place of data."""

    def __init__(self, reason: Mapping[str, Any]):
        Exception.__init__(self, reason["why"])
        self.where, self.advice, self.others = str(reason["file"]), str(reason["advice"]), ()
        self.reason = dict(reason)


class Stopped(Exception):
    """Moorings or calibrations that were stopped in a run, one line each."""


def _short(part: object, longest: int) -> str:
    text = str(part)
    return text if len(text) <= longest else f"{text[:longest]} ... ({len(text)} characters)"


def applicable(sentences: Mapping[str, Any]) -> list[str]:
    """List the sentences whose condition is true."""
    return [sentence for sentence, holds in sentences.items() if holds]
