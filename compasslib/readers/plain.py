"""The text of a file: packed by gzip or not, in UTF-8, UTF-16 or Latin-1, in lines as long as instruments write."""

from __future__ import annotations

import csv
import gzip
import re
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from compasslib.errors import InputError
from compasslib.readers.bounds import refuse_large_text

LONGEST_LINE = 2**20  # bytes; a table of 10,000 columns has fewer
PACKED = b"\x1f\x8b"
QUOTES = " \t=\"'\u201c\u201d\u2018\u2019"  # around a time, where a table was exported twice or for a spreadsheet
SAMPLE = 4096  # bytes that tell UTF-16 without its mark
_TEXT = bytes([*range(9, 14), *range(32, 127)])
_LATIN = bytes([*range(0xA0, 0xFF)])  # no letter of a header is a control character or a filling of FF
_WORD = re.compile(r'=?"[^"\n]*"|\S+')


@dataclass(frozen=True)
class Text:
    """A file's text, and what was done to read it."""

    text: str
    notes: tuple[str, ...] = ()


def strange(data: bytes) -> int:
    """Return how many bytes are neither printable ASCII nor space between words and lines."""
    return len(data.translate(None, _TEXT))


def of_lines(path: Path) -> bytes:
    """Return the bytes of a text file, unpacked, after a look that it has lines.

    Raises:
        InputError: it cannot be read, is too large, or a line of it is longer than any instrument's.
    """
    blocks, size = [], 0
    try:
        with Path(path).open("rb") as raw:
            packed = raw.read(len(PACKED)) == PACKED
            raw.seek(0)
            stream = gzip.GzipFile(fileobj=raw) if packed else raw
            while block := stream.read(LONGEST_LINE):
                if len(block) == LONGEST_LINE and not (b"\n" in block or b"\r" in block):
                    expected, found = f"lines of less than {LONGEST_LINE} bytes", "a longer one"
                    raise InputError(str(path), expected=expected, found=found, advice="check that it is a text file")
                size += len(block)
                refuse_large_text(Path(path), size)
                blocks.append(block)
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        advice = "copy it again, or unpack it as far as it goes"
        raise InputError(str(path), expected="a whole gzip file", found=error, advice=advice) from None
    except OSError as error:
        found = error.strerror or type(error).__name__
        raise InputError(str(path), expected="a readable file", found=found, advice="check the path") from None
    return b"".join(blocks)


def text_of(path: Path) -> Text:
    """Return the text of a file and in which encoding it was, where it is not plain UTF-8.

    Raises:
        InputError: it cannot be read, or holds bytes of no text.
    """
    data = of_lines(path)
    with Path(path).open("rb") as raw:
        said = ("packed by gzip",) * (raw.read(len(PACKED)) == PACKED)
    wide = utf16(data)
    try:
        if wide:
            return Text(data[: len(data) // 2 * 2].decode(wide), (*said, "in UTF-16"))
        return Text(data.decode("utf-8-sig"), said)
    except UnicodeDecodeError as error:
        if wide or data.translate(None, _TEXT + _LATIN):
            raise InputError(
                str(path),
                expected="a readable CSV file in UTF-8, UTF-16 or Latin-1",
                found=error,
                advice="check path and format",
            ) from None
    return Text(data.decode("latin-1"), (*said, "in Latin-1"))


def utf16(data: bytes) -> str | None:
    """Identify which UTF-16 a text is in, None where it is in none."""
    if data[:2] in (b"\xff\xfe", b"\xfe\xff") and (b"\n\0" in data or b"\0\n" in data):
        return "utf-16"
    low, high = data[:SAMPLE:2], data[1:SAMPLE:2]
    if min(len(low), len(high)) < 8:
        return None
    by = {"utf-16-le": high.count(0) / len(high) - low.count(0), "utf-16-be": low.count(0) / len(low) - high.count(0)}
    return next((name for name, share in by.items() if share > 0.9), None)


def split_rows(lines: Iterable[str], delimiter: str) -> Any:
    """Split lines into cells by a delimiter; a quotation mark may stand behind blanks."""
    return csv.reader(lines, delimiter=delimiter, skipinitialspace=True)


def split_words(line: str) -> list[str]:
    """Split a line at blanks that are not between quotation marks."""
    return line.split() if '"' not in line else [cell.strip('="') for cell in _WORD.findall(line)]


def without_quotes(row: Sequence[str]) -> list[str]:
    """Strip blanks and quotation marks from the cells of a row."""
    return [cell.strip(QUOTES) for cell in row]
