"""Read bytes and text of raw files, limit their memory use and share of damage, and undo a modem's frames.

Text may be compressed by gzip, and encoded in UTF-8, UTF-16 or Windows-1252. A controller of inductive modems escapes
2B as 18 6B and 18 as 18 58, in frames of a header (SOH, instrument, length, time, block, checksum, STX), data and ETX.
This was inferred from genuine files: in four of them every 18 belongs to an escape, and no 2B remains; in nine others,
directly from instruments, at most 2 in 100 of these bytes look like escapes.
"""

from __future__ import annotations

import gzip
import re
import zlib
from collections.abc import Iterator, Sequence
from glob import escape
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compasslib.errors import InputError

MEGABYTE = 1 << 20
LARGEST_TEXT = 256 * MEGABYTE  # of one file, decompressed; parsing takes some 19 times as much memory
LARGEST_ARRAYS = 1024 * MEGABYTE  # of one file
GROWTH = 16  # allowed size of arrays, by that of their files; recordings need less
CHUNK_BYTES = 2 * MEGABYTE  # read at a time, and searched for escapes
# What libraries raise on the content of a damaged or foreign file; UnicodeDecodeError is a ValueError.
DAMAGE_ERRORS = (
    *(OSError, RuntimeError, LookupError, TypeError, AttributeError, ValueError, ArithmeticError, EOFError),
    zlib.error,
)
GZIP_MAGIC = b"\x1f\x8b"
_TEXT = bytes([*range(9, 14), *range(32, 127)])
# Windows-1252, which holds Latin-1, without control characters and FF, a fill byte.
LATIN_TEXT = _TEXT + bytes(sorted({*range(0x80, 0xFF)} - {0x81, 0x8D, 0x8F, 0x90, 0x9D}))

MISSING_COUNT = np.iinfo(np.int16).min  # missing value of RDI and Nortek
NORTEK_START = 0xB58C  # initial value of Nortek's checksum, to which 16-bit words are added

CONVERTED = (".hdr", ".dat", ".sen", ".v1", ".v2", ".v3")  # files of Nortek's conversion that are read
ESCAPE = b"\x18"
ESCAPE_PAIRS = ((b"\x18\x6b", b"\x2b"), (b"\x18\x58", ESCAPE))
ESCAPES_UNDONE = "came with the escapes of a modem's controller (18 6B for 2B, 18 58 for 18), which were undone"
FRAME = re.compile(rb"\x01([A-Z]{2}\d{7})_([0-9A-Fa-f]{4})[A-Za-z][0-9A-Fa-f]{8}_[0-9A-Fa-f]{2}_[0-9A-Fa-f]{4}\x02")
FRAME_END = b"\x03"


class TooLarge(InputError):
    """A file that would take more memory than is allowed."""


def unreadable(path: str | Path, error: OSError) -> InputError:
    """Create the error for a file that cannot be opened or read."""
    shown = error.strerror or type(error).__name__
    return InputError(str(path), expected="a readable file", found=shown, advice="check the path")


def foreign(path: str | Path, expected: str, form: str, found: str = "") -> InputError:
    """Create the error for a file without any record of its format, whose first bytes it shows unless told more."""
    beginning = read_bytes(path)[:16]
    found = found or (f"a file that begins with {beginning!r}" if beginning else "an empty file")
    return InputError(str(path), expected, found, f"check that format: {form} and the file belong together")


def read_bytes(path: str | Path) -> bytes:
    """Read a whole file; InputError if it cannot be read."""
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise unreadable(path, error) from None


def read_text_bytes(path: Path) -> bytes:
    """Read and decompress a text file; InputError if it cannot be read, is too large, or has no lines."""
    blocks, size = list[bytes](), 0
    try:
        with Path(path).open("rb") as raw:
            packed = raw.read(len(GZIP_MAGIC)) == GZIP_MAGIC
            raw.seek(0)
            stream = gzip.GzipFile(fileobj=raw) if packed else raw
            while block := stream.read(MEGABYTE):
                if len(block) == MEGABYTE and not (b"\n" in block or b"\r" in block):
                    expected, shown = "lines of less than 1 MB", "a longer one"
                    raise InputError(str(path), expected=expected, found=shown, advice="check that it is a text file")
                size += len(block)
                if size > LARGEST_TEXT:
                    stored = Path(path).stat().st_size
                    unpacked = f" that unpack to over {LARGEST_TEXT // MEGABYTE} MB" if packed else ""
                    raise TooLarge(
                        str(path),
                        expected=f"a text of up to {LARGEST_TEXT // MEGABYTE} MB",
                        found=f"{stored / MEGABYTE:.1f} MB{unpacked}",
                        advice="export means over some minutes instead of every sample, or fewer columns",
                    )
                blocks.append(block)
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        advice = "copy it again, or unpack it as far as it goes"
        raise InputError(str(path), expected="a whole gzip file", found=error, advice=advice) from None
    except OSError as error:
        raise unreadable(path, error) from None
    return b"".join(blocks)


def read_text(path: Path) -> tuple[bytes, list[str], bool]:
    """Read a text as UTF-8 whose lines end with line feeds, name another encoding, and whether the last line was ended.

    Raises:
        InputError: the file cannot be read, or contains bytes that are not text.
    """
    data, notes = read_text_bytes(path), list[str]()
    wide = is_utf16(data)
    try:
        if wide:
            data, notes = data[: len(data) // 2 * 2].decode("utf-16").encode(), ["in UTF-16"]
        elif not data.isascii():
            data = data.decode("utf-8-sig").encode()
    except UnicodeError as error:
        if wide or data.translate(None, LATIN_TEXT):
            expected, advice = "a text in UTF-8, UTF-16 or Windows-1252", "save it as UTF-8, or check path and format"
            raise InputError(str(path), expected=expected, found=error, advice=advice) from None
        data, notes = data.decode("cp1252").encode(), ["in Windows-1252"]
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    ended = data.endswith(b"\n")
    return data if ended or not data else data + b"\n", notes, ended


def list_converted(file: str, root: Path) -> list[str]:
    """List the other files of the text conversion of a Nortek recording to which a file in a folder belongs, if any."""
    path = Path(file)
    siblings = sorted((root / path).parent.glob(f"{escape(path.stem)}.*")) if path.suffix.lower() in CONVERTED else ()
    return [str(path.with_name(x.name)) for x in siblings if x.suffix.lower() in CONVERTED and x.name != path.name]


def is_utf16(data: bytes) -> bool:
    """Return whether a text is in UTF-16, by its byte order mark."""
    return data[:2] in (b"\xff\xfe", b"\xfe\xff") and (b"\n\0" in data or b"\0\n" in data)


def count_unprintable(data: bytes) -> int:
    """Count the bytes that are neither printable ASCII characters nor white space."""
    return len(data.translate(None, _TEXT))


def refuse_large_arrays(where: str, needed: int, size: int, cells: int | None = None) -> None:
    """Raise TooLarge for arrays that need over 1 GB and over 16 times the bytes of their files."""
    if needed > (allowed := max(LARGEST_ARRAYS, GROWTH * size)):
        what, declared, advice = "arrays", "", "check that these are the files you mean"
        if cells is not None:
            what, declared = "profiles", f", as one declares {cells} cells,"
            advice = "give each configuration of the instrument as files of its own"
        expected = f"{what} that take up to {allowed // MEGABYTE} MB of memory"
        actual = f"{needed // MEGABYTE} MB{declared} in {size / MEGABYTE:.1f} MB of files"
        raise TooLarge(where, expected=expected, found=actual, advice=advice)


def refuse_mostly_damaged(path: str | Path, records: str, *, damaged: int, whole: int) -> None:
    """Raise InputError for more damaged records than intact ones, unless none is intact; other bytes do not count."""
    if damaged > whole > 0:
        raise InputError(
            str(path),
            expected=f"{records} of which most are whole",
            found=f"{damaged} of {damaged + whole} that are damaged",
            advice="copy the file once more from the instrument, byte by byte, or give the parts of it that are whole",
        )


def block_type(**fields: tuple[int, str]) -> np.dtype[np.void]:
    """Create the data type of a block of bytes from the offset and format of its fields."""
    offsets, formats = zip(*fields.values(), strict=True)
    return np.dtype({"names": [*fields], "formats": [*formats], "offsets": [*offsets]})


def read_words(data: NDArray[np.uint8], at: NDArray[np.int64]) -> NDArray[np.uint16]:
    """Read the little-endian 16-bit words at byte offsets."""
    return data[at] + data[at + 1].astype(np.uint16) * np.uint16(256)


def list_some(texts: Sequence[str], most: int = 20) -> str:
    """List ranges of skipped bytes, at most ``most``, and the number of the others."""
    return ", ".join(texts[:most]) + (f" and {len(texts) - most} more ranges" if len(texts) > most else "")


def unescape(data: bytes) -> bytes:
    """Replace the escape pairs by the bytes 2B and 18."""
    for pair, octet in ESCAPE_PAIRS:
        data = data.replace(pair, octet)
    return data


def looks_escaped(data: bytes) -> bool:
    """Return whether most bytes 18 and 2B belong to escapes; intact records after ``unescape`` must confirm this."""
    sample = data[:CHUNK_BYTES]
    pairs = sum(sample.count(pair) for pair, _ in ESCAPE_PAIRS)
    return pairs > sample.count(ESCAPE) - pairs + sample.count(b"\x2b")


def payloads(data: bytes) -> Iterator[tuple[str, bytes]]:
    """Iterate over a file's frames as (instrument: two letters and the number of its controller; unescaped content).

    A damaged frame yields all bytes up to the next one.
    """
    heads = list(FRAME.finditer(data))
    undo = bool(heads) and looks_escaped(data)
    ends = [*(head.start() for head in heads), len(data)][1:]
    for head, end in zip(heads, ends, strict=True):
        length = int(head[2], 16)
        raw = data[head.end() : end]
        sent = unescape(raw) if undo else raw
        yield head[1].decode(), sent[:length] if sent[length : length + 1] == FRAME_END else sent
