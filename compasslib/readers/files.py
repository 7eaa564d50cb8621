"""Raw files: their bytes and text, how much memory they may take, how much of them may be damaged, a modem's escapes.

Text is packed by gzip or not, in UTF-8, UTF-16 or Latin-1. A controller of inductive modems sends 2B as 18 6B and 18 as
18 58, in frames of a head (SOH, instrument, length, time, block, checksum, STX), as many bytes as it says, and ETX.
Found in genuine files: in four of them every 18 is of a pair, and no 2B is left; in nine others, straight from
instruments, no more than 2 in 100 of these bytes are of pairs.
"""

from __future__ import annotations

import csv
import gzip
import re
import zlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from compasslib.errors import InputError

LONGEST_LINE = 2**20  # bytes; a table of 10,000 columns has fewer
PACKED = b"\x1f\x8b"
QUOTES = " \t=\"'\u201c\u201d\u2018\u2019"  # around a time, where a table was exported twice or for a spreadsheet
SAMPLE = 4096  # bytes that tell UTF-16 without its mark
_TEXT = bytes([*range(9, 14), *range(32, 127)])
_LATIN = bytes([*range(0xA0, 0xFF)])  # no letter of a header is a control character or a filling of FF
_WORD = re.compile(r'=?"[^"\n]*"|\S+')
MEGABYTE = 1 << 20
LARGEST_TEXT = 256 * MEGABYTE  # of one file, unpacked; a table of so much takes some 19 times as much memory
LARGEST_ARRAYS, MOST_TIMES = 1024 * MEGABYTE, 16  # more than both, the second times the file, is no recording's
ESCAPE = b"\x18"
PAIRS = ((b"\x18\x6b", b"\x2b"), (b"\x18\x58", ESCAPE))
SAMPLE_BYTES = 2 << 20  # that tell whether a file is escaped
END = b"\x03"
FRAME = re.compile(rb"\x01([A-Z]{2}\d{7})_([0-9A-Fa-f]{4})[A-Za-z][0-9A-Fa-f]{8}_[0-9A-Fa-f]{2}_[0-9A-Fa-f]{4}\x02")
ESCAPES_UNDONE = "came with the escapes of a modem's controller (18 6B for 2B, 18 58 for 18), which were undone"


@dataclass(frozen=True)
class Text:
    """A file's text, and what was done to read it."""

    text: str
    notes: tuple[str, ...] = ()


def count_unprintable(data: bytes) -> int:
    """Return how many bytes are neither printable ASCII nor space between words and lines."""
    return len(data.translate(None, _TEXT))


def read_text_bytes(path: Path) -> bytes:
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


def read_text(path: Path) -> Text:
    """Return the text of a file and in which encoding it was, where it is not plain UTF-8.

    Raises:
        InputError: it cannot be read, or holds bytes of no text.
    """
    data = read_text_bytes(path)
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


class Payload(NamedTuple):
    """What a frame holds."""

    instrument: str  # two letters and the number of its controller
    data: bytes  # without escapes
    whole: bool  # as long as the head of the frame says


def unescape(data: bytes) -> bytes:
    """Turn the pairs that stand for 2B and 18 back."""
    for pair, octet in PAIRS:
        data = data.replace(pair, octet)
    return data


def looks_escaped(data: bytes) -> bool:
    """Tell bytes in which most of 18 and 2B are escapes; whether records are whole without them decides."""
    sample = data[:SAMPLE_BYTES]
    pairs = sum(sample.count(pair) for pair, _ in PAIRS)
    return pairs > sample.count(ESCAPE) - pairs + sample.count(b"\x2b")


def payloads(data: bytes) -> Iterator[Payload]:
    """Iterate over what the frames of a file hold; of a frame that is damaged all up to the next."""
    undo = looks_escaped(data)
    heads = list(FRAME.finditer(data))
    ends = [*(head.start() for head in heads), len(data)][1:]
    for head, end in zip(heads, ends, strict=True):
        length = int(head[2], 16)
        raw = data[head.end() : end]
        sent = unescape(raw) if undo else raw
        whole = sent[length : length + 1] == END
        yield Payload(head[1].decode(), sent[:length] if whole else sent, whole)
