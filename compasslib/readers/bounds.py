"""How much memory a file may ask for: held against bounds before it is taken."""

from __future__ import annotations

from pathlib import Path

from compasslib.errors import InputError

MEGABYTE = 1 << 20
LARGEST_TEXT = 256 * MEGABYTE  # of one file, unpacked; a table of so much takes some 19 times as much memory
LARGEST_ARRAYS, MOST_TIMES = 1024 * MEGABYTE, 16  # more than both, the second times the file, is no recording's


class TooLarge(InputError):
    """A file of whatever kind that would take more memory than is allowed."""


def refuse_large_text(path: Path, size: int) -> None:
    """Refuse a text of more than 256 MB.

    Args:
        size: bytes of the text that are there so far.

    Raises:
        TooLarge: it is larger.
    """
    if size > LARGEST_TEXT:
        stored = path.stat().st_size
        unpacked = f" that unpack to over {LARGEST_TEXT // MEGABYTE} MB" if stored < size else ""
        raise TooLarge(
            str(path),
            expected=f"a text of up to {LARGEST_TEXT // MEGABYTE} MB",
            found=f"{stored / MEGABYTE:.1f} MB{unpacked}",
            advice="export means over some minutes instead of every sample, or fewer columns",
        )


def refuse_large_arrays(where: str, needed: int, size: int, cells: int) -> None:
    """Refuse profiles that would fill far more memory than their files hold.

    Args:
        needed: bytes of the arrays.
        size: bytes of the files.
        cells: of the longest profile, to which the others are padded.

    Raises:
        TooLarge: they are larger than 1 GB and than 16 times the files.
    """
    if needed > max(LARGEST_ARRAYS, MOST_TIMES * size):
        raise TooLarge(
            where,
            expected=f"profiles that take up to {max(LARGEST_ARRAYS, MOST_TIMES * size) // MEGABYTE} MB of memory",
            found=f"{needed // MEGABYTE} MB, as one declares {cells} cells, in {size / MEGABYTE:.1f} MB of files",
            advice="give each configuration of the instrument as files of its own",
        )
