"""Encode PD12 independently of the reader, and the frames that a modem controller adds around ensembles."""

import struct
from collections.abc import Sequence
from datetime import datetime


def ensemble(
    number: int,
    when: datetime,
    heading: float,
    bins: Sequence[Sequence[int]],
    *,
    components: int = 0x2F,
    first: int = 1,
) -> bytes:
    """Encode one ensemble from bins of (east, north, up, error) in mm/s, with its checksum."""
    size = 34 + 2 * 4 * len(bins)
    head = struct.pack("<2sHIBBB", b"\x6e\x7f", size, number, 0, 50, 40)
    head += struct.pack("<HBBBBBB", when.year, when.month, when.day, when.hour, when.minute, when.second, 0)
    head += struct.pack("<HhhhiBBB", round(100 * heading) % 36000, -157, 13, 365, 490_332, components, first, len(bins))
    body = head + b"".join(struct.pack(f"<{len(bins)}h", *component) for component in zip(*bins, strict=True))
    return body + struct.pack("<H", sum(body) & 0xFFFF)


def escaped(data: bytes) -> bytes:
    """Escape bytes as a controller of inductive modems does."""
    return data.replace(b"\x18", b"\x18\x58").replace(b"\x2b", b"\x18\x6b")


def framed(ensembles: Sequence[bytes], escape: bool = True) -> bytes:
    """Frame ensembles as a controller of inductive modems does: a log, and a block around each ensemble."""
    blocks = [b"\nBuffer size: 200000\n2013/07/23 22:29:30> Error opening WFP0_PN\n"]
    for data in ensembles:
        wrapped = b"<Executing/>\r\n<SampleData ID='0x1ba' LEN='%d' CRC='0x0'>%s</SampleData>\r\n" % (len(data), data)
        sent = escaped(wrapped) if escape else wrapped
        blocks.append(b"\x01AD1237111_%04Xu51EF39DB_26_C346\x02%s\x03" % (len(wrapped), sent))
    return b"".join(blocks)
