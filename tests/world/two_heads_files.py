"""PD0 files of two heads for tests: from a simulated cast, or from a real recording with changed headings."""

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np

from compasslib.readers.pd0 import frames
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
    file, (runs, _) = bytearray(raw), frames.scan(raw)
    found = [(run.offset + run.rows.shape[1] * k, run.layout) for run in runs for k in range(len(run.rows))]
    places = [at + layout.blocks[0x80][0] + 18 for at, layout in found]  # in the variable leader
    before = np.array([struct.unpack_from("<H", raw, place)[0] for place in places]) / 100.0
    after = np.rint(100.0 * heading(before)).astype(int) % 36000
    for (at, layout), place, hundredths in zip(found, places, after, strict=True):
        struct.pack_into("<H", file, place, hundredths)
        struct.pack_into("<H", file, at + layout.length, sum(file[at : at + layout.length]) & 0xFFFF)
    return bytes(file)
