"""Bytes that no text file of an instrument holds."""

from __future__ import annotations

_TEXT = bytes([*range(9, 14), *range(32, 127)])


def strange(data: bytes) -> int:
    """Return how many bytes are neither printable ASCII nor space between words and lines.

    Args:
        data: a file or a part of it.
    """
    return len(data.translate(None, _TEXT))
