"""The files of a Falmouth 3D-ACM on a McLane profiler: unpacked ASCII or binary, told apart by their content.

ASCII rows are a stamp, HDNG TX TY HX HY HZ VPAB VPCD VPEF VPGH, between spaces or commas, with or without header lines;
scans of early instruments carry no clock and no heading: nine numbers from TX on. Binary records hold the same ten.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from compasslib.errors import InputError
from compasslib.readers import mmp_binary, mmp_blocks, mmp_rows, octets
from compasslib.readers.mmp_blocks import UNKNOWN, Block
from compasslib.readers.mmp_clock import Bools, Ints, misplaced
from compasslib.records import Floats

COLUMNS = ("HDNG", "TX", "TY", "HX", "HY", "HZ", "VPAB", "VPCD", "VPEF", "VPGH")
STAMPED, BARE = (True, 10), (False, 9)
STEEPEST_DEG, FASTEST_CM_S = 180.0, 2000.0  # beyond these a number is no reading but a damaged one
EXPECTED = "unpacked ASCII or binary scans of a Falmouth 3D-ACM"
TEXT_SHARE = 0.95  # of the characters of a text are printable


@dataclass(frozen=True, eq=False)
class Scans:
    """What the meter logged: r scans in p profiles."""

    clock_s: Floats  # (r,) whole UTC seconds since 1970, NaN where scans carry no clock
    values: Floats  # (r, 10) in the order of COLUMNS, degrees and cm/s; HDNG is NaN where it is not recorded
    place: Ints  # (r,) in its profile, damaged scans counted
    profile: Ints  # (r,) index of its profile
    blocks: tuple[Block, ...]  # (p,) number, rate and times of each profile
    damaged: int  # rows or records left out
    damaged_files: tuple[str, ...]
    empty_files: tuple[str, ...]
    strange: int = 0  # bytes of text files that are no text, and were passed over


def load(paths: Sequence[Path]) -> Scans:
    """Return the scans of several files, in the order given.

    Args:
        paths: unpacked ASCII or binary files.

    Raises:
        InputError: a file that cannot be read or is neither, or no scan in any of them.
    """
    if not paths:
        raise InputError("files", expected=EXPECTED, found="no file", advice="name the instrument's files")
    parts = [_one(path) for path in paths]
    scans = _joined(parts)
    if not len(scans.profile):
        where = f"{paths[0]}" + (f" and {len(paths) - 1} more" if len(paths) > 1 else "")
        found = f"none ({scans.damaged} damaged rows)" if scans.damaged else "none"
        raise InputError(where, expected=EXPECTED, found=found, advice="check files and format of the instrument")
    return scans


def contents(path: Path) -> bytes:
    """Return a file's bytes.

    Args:
        path: the file.

    Raises:
        InputError: it cannot be read.
    """
    try:
        return Path(path).read_bytes()
    except OSError as error:
        found = error.strerror or type(error).__name__
        raise InputError(str(path), expected="a readable file", found=found, advice="check the path") from None


def is_text(data: bytes) -> bool:
    """Return whether a file is mostly made of printable characters, the filling of an erased store at its end apart.

    Args:
        data: the file.
    """
    sample = data[:65536].rstrip(b"\x00\xff")
    return not data or octets.strange(sample) < (1.0 - TEXT_SHARE) * len(sample)


def _one(path: Path) -> Scans:
    data = contents(path)
    if mmp_binary.is_binary(data):
        binary = mmp_binary.parse(data)
        number = mmp_blocks.number_in_name(path) if len(binary.blocks) == 1 else UNKNOWN
        blocks = [Block(**(vars(block) | {"number": number})) for block in binary.blocks]
        return _scans(path, blocks, binary.place, binary.time_s, binary.values, binary.damaged)
    text = mmp_rows.parse(data if is_text(data) else b"", lambda form: form in (STAMPED, BARE))
    if data.strip() and text.form is None and not mmp_blocks.says_something(text):
        found = f"a file that begins with {data[:24]!r}"
        raise InputError(str(path), expected=EXPECTED, found=found, advice="check that format and file belong together")
    found_blocks, place, damaged = mmp_blocks.blocks(text, path)
    values = text.values if text.form == STAMPED else np.full((len(text.offset), len(COLUMNS)), np.nan)
    if text.form == BARE:
        values[:, 1:] = text.values
    return replace(_scans(path, found_blocks, place, text.time_s, values, damaged), strange=octets.strange(data))


def _scans(path: Path, blocks: Sequence[Block], place: Ints, clock_s: Floats, values: Floats, damaged: int) -> Scans:
    """Leave out what no meter can log."""
    profile = np.repeat(np.arange(len(blocks)), [block.end - block.begin for block in blocks])
    good = _possible(values) & ~misplaced(clock_s, profile)
    damaged += int(np.sum(~good))
    return Scans(
        clock_s=clock_s[good],
        values=values[good],
        place=place[good],
        profile=profile[good],
        blocks=tuple(blocks),
        damaged=damaged,
        damaged_files=(str(path),) if damaged else (),
        empty_files=() if good.any() else (str(path),),
    )


def _possible(values: Floats) -> Bools:
    heading, tilts, field, paths = values[:, 0], values[:, 1:3], values[:, 3:6], values[:, 6:]
    good = np.isnan(heading) | ((heading >= -180.0) & (heading <= 360.0))
    good &= np.isfinite(field).all(axis=1) & (np.abs(tilts) <= STEEPEST_DEG).all(axis=1)
    return np.asarray(good & (np.abs(paths) <= FASTEST_CM_S).all(axis=1))


def _joined(parts: Sequence[Scans]) -> Scans:
    """Put files together; profiles without a scan are dropped from the list of profiles."""
    sizes = [len(part.blocks) for part in parts]
    shift = np.cumsum([0, *sizes])
    profile = np.concatenate([part.profile + first for part, first in zip(parts, shift[:-1], strict=True)])
    blocks = [block for part in parts for block in part.blocks]
    held, profile = np.unique(profile, return_inverse=True)
    return Scans(
        clock_s=np.concatenate([part.clock_s for part in parts]),
        values=np.concatenate([part.values for part in parts]),
        place=np.concatenate([part.place for part in parts]),
        profile=profile,
        blocks=tuple(blocks[k] for k in held),
        damaged=sum(part.damaged for part in parts),
        damaged_files=tuple(file for part in parts for file in part.damaged_files),
        empty_files=tuple(file for part in parts for file in part.empty_files),
        strange=sum(part.strange for part in parts),
    )
