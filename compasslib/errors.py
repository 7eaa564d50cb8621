"""The one error a user meets: where, what was expected, what came, what to do."""

from __future__ import annotations


class InputError(Exception):
    """Input that cannot be used, said in one line.

    Args:
        where: file, with key or record, e.g. ``config/moorings/EG4.yaml: latitude``.
        expected: what would have been right.
        found: what stands there.
        advice: what to write or do instead.
    """

    def __init__(self, where: str, *, expected: str, found: object, advice: str):
        line = f"{where}: expected {expected}, found {found}; {advice}"
        super().__init__(" ".join(line.split()))


class Passing(InputError):
    """Trouble of the disk, or of a file that the next run makes again: it says nothing about the input."""
