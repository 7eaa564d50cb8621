"""The one error a user meets: where, what was expected, what came, what to do."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

MAX_PART, MAX_FOUND = 1000, 300  # characters of a part of the line, and of what was found: a cell may hold a book


class InputError(Exception):
    """Input that cannot be used, said in one line.

    Args:
        where: file, with key or record, e.g. ``config/moorings/EG4.yaml: latitude``.
    """

    def __init__(self, where: str, *, expected: str, found: object, advice: str):
        where, expected, advice = (_short(part, MAX_PART) for part in (where, expected, advice))
        line = f"{where}: expected {expected}, found {_short(found, MAX_FOUND)}; {advice}"
        # A file's name may hold bytes that are no UTF-8: they are said as escapes.
        super().__init__(" ".join(line.split()).encode("utf-8", "backslashreplace").decode())
        self.where, self.advice = where, advice
        self.others: tuple[InputError, ...] = ()  # further mistakes of the same file, for who wants to hear of all


class TransientError(InputError):
    """Trouble of the disk, or of a file that the next run makes again: it says nothing about the input."""


class Stopped(Exception):
    """Moorings or calibrations that were stopped in a run, a line each."""


def _short(part: object, longest: int) -> str:
    text = str(part)
    return text if len(text) <= longest else f"{text[:longest]} ... ({len(text)} characters)"


def applicable(sentences: Mapping[str, Any]) -> list[str]:
    """List the sentences of a report that apply: those whose condition holds."""
    return [sentence for sentence, holds in sentences.items() if holds]
