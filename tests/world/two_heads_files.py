"""PD0 files of two heads for tests: from a simulated cast, or from a real recording with changed headings."""

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.world import package
from tests.world.package import Head, Sea

START_S = 1.2e9
SEA, PLAIN = Sea(), Head()
TURNED = Head(
    mount_deg=(47.0, 2.0, -1.5),
    looks_up=True,
    first_s=0.37,
    ping_s=1.3,
    clock_s=7.3,
    deviation_deg=(0.0, 6.0, -3.0, 1.5, -1.0),
)


def cast(folder: Path, *, seed: int = 1, sea: Sea = SEA, a: Head = PLAIN, b: Head = TURNED) -> list[Path]:
    """Write the PD0 files of two heads on one lowered frame."""
    rng = np.random.default_rng(seed)
    motion = package.lower(rng, sea, START_S)
    paths = [folder / "a.000", folder / "b.000"]
    for path, head in zip(paths, (a, b), strict=True):
        path.write_bytes(package.encoded(package.stand(rng, motion, head), looks_up=head.looks_up))
    return paths


def rewritten(raw: bytes, heading: Callable[[np.ndarray], np.ndarray]) -> bytes:
    """Replace the headings of a PD0 file by a function of them (degrees), update checksums, keep damaged ensembles."""
    found = _ensembles(raw)
    places = [at + _variable_leader(raw, at) + 18 for at in found]
    before = np.array([struct.unpack_from("<H", raw, place)[0] for place in places]) / 100.0
    after = np.rint(100.0 * heading(before)).astype(int) % 36000
    file = bytearray(raw)
    for at, place, hundredths in zip(found, places, after, strict=True):
        struct.pack_into("<H", file, place, hundredths)
        length = struct.unpack_from("<H", raw, at + 2)[0]
        struct.pack_into("<H", file, at + length, sum(file[at : at + length]) & 0xFFFF)
    return bytes(file)


def _ensembles(raw: bytes) -> list[int]:
    """Find the byte offsets of the ensembles with valid checksums."""
    found, at = [], raw.find(b"\x7f\x7f")
    while at >= 0:
        length = struct.unpack_from("<H", raw, at + 2)[0] if at + 4 <= len(raw) else 0
        good = at + length + 2 <= len(raw) and length > 0
        good = good and sum(raw[at : at + length]) & 0xFFFF == struct.unpack_from("<H", raw, at + length)[0]
        if good:
            found.append(at)
        at = raw.find(b"\x7f\x7f", at + length + 2 if good else at + 1)
    return found


def _variable_leader(raw: bytes, at: int) -> int:
    blocks = struct.unpack_from(f"<{raw[at + 5]}H", raw, at + 6)
    return next(b for b in blocks if raw[at + b : at + b + 2] == b"\x80\x00")
