"""Files of which more is damaged than whole: what is left of them is no recording."""

from __future__ import annotations

from pathlib import Path

from compasslib.errors import InputError


def refuse_mostly_damaged(path: str | Path, records: str, *, damaged: int, whole: int) -> None:
    """Refuse a file of whose records over half are damaged.

    Args:
        records: what they are, in the plural.
        damaged: records that are recognised and fail; bytes of another kind between records are none.

    Raises:
        InputError: there are more of these than whole ones.
    """
    if damaged > whole > 0:
        raise InputError(
            str(path),
            expected=f"{records} of which most are whole",
            found=f"{damaged} of {damaged + whole} that are damaged",
            advice="copy the file once more from the instrument, byte by byte, or give the parts of it that are whole",
        )
