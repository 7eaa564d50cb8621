"""What no text file of an instrument holds: strange bytes, endless lines."""

from __future__ import annotations

from pathlib import Path

from compasslib.errors import InputError

LONGEST_LINE = 2**20  # bytes; a table of 10,000 columns has fewer

_TEXT = bytes([*range(9, 14), *range(32, 127)])


def strange(data: bytes) -> int:
    """Return how many bytes are neither printable ASCII nor space between words and lines.

    Args:
        data: a file or a part of it.
    """
    return len(data.translate(None, _TEXT))


def of_lines(path: Path) -> bytes:
    """Return the bytes of a text file, after a look that it has lines.

    Args:
        path: the file.

    Raises:
        InputError: it cannot be read, or a line of it is longer than any instrument's.
    """
    blocks = []
    try:
        with Path(path).open("rb") as stream:
            while block := stream.read(LONGEST_LINE):
                if len(block) == LONGEST_LINE and not (b"\n" in block or b"\r" in block):
                    expected, found = f"lines of less than {LONGEST_LINE} bytes", "a longer one"
                    raise InputError(str(path), expected=expected, found=found, advice="check that it is a text file")
                blocks.append(block)
    except OSError as error:
        found = error.strerror or type(error).__name__
        raise InputError(str(path), expected="a readable file", found=found, advice="check the path") from None
    return b"".join(blocks)
