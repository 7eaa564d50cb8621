"""What the controller of a modem makes of an instrument's bytes: frames around them, and escapes among them.

A controller of inductive modems sends 2B as 18 6B and 18 as 18 58, in frames of a head (SOH, instrument, length, time,
block, checksum, STX), as many bytes as it says, and ETX. Found in genuine files: in four of them every 18 is of a pair,
and no 2B is left; in nine others, straight from instruments, no more than 2 in 100 of these bytes are of pairs.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

ESCAPE = b"\x18"
PAIRS = ((b"\x18\x6b", b"\x2b"), (b"\x18\x58", ESCAPE))
SAMPLE_BYTES = 2 << 20  # that tell whether a file is escaped
END = b"\x03"
FRAME = re.compile(rb"\x01([A-Z]{2}\d{7})_([0-9A-Fa-f]{4})[A-Za-z][0-9A-Fa-f]{8}_[0-9A-Fa-f]{2}_[0-9A-Fa-f]{4}\x02")
UNDONE = "came with the escapes of a modem's controller (18 6B for 2B, 18 58 for 18), which were undone"


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


def may_be_escaped(data: bytes) -> bool:
    """Tell bytes in which most of 18 and 2B are escapes; whether records are whole without them decides."""
    sample = data[:SAMPLE_BYTES]
    pairs = sum(sample.count(pair) for pair, _ in PAIRS)
    return pairs > sample.count(ESCAPE) - pairs + sample.count(b"\x2b")


def payloads(data: bytes) -> Iterator[Payload]:
    """Iterate over what the frames of a file hold; of a frame that is damaged all up to the next."""
    undo = may_be_escaped(data)
    heads = list(FRAME.finditer(data))
    ends = [*(head.start() for head in heads), len(data)][1:]
    for head, end in zip(heads, ends, strict=True):
        length = int(head[2], 16)
        raw = data[head.end() : end]
        sent = unescape(raw) if undo else raw
        whole = sent[length : length + 1] == END
        yield Payload(head[1].decode(), sent[:length] if whole else sent, whole)
