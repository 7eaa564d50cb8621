"""The Nortek reader: a genuine Aquadopp against an independent reading, what damage costs, and speed beside mhkit's.

    python benchmarks/nortek.py

Looks for ../shared/data/moored/aqd9330.aqd with its .npz. Profiles of an AWAC and of a Signature are written by the
tests' encoder, as no genuine ones are at hand.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

PROJECT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(PROJECT), str(PROJECT / "tests"), str(PROJECT / "benchmarks")]

import nortek_encoder as encoder  # noqa: E402
from pd0_throughput import by_mhkit, speed  # noqa: E402

from compasslib.readers.nortek.packets import packets  # noqa: E402
from compasslib.readers.nortek.reader import read  # noqa: E402

GENUINE = PROJECT / "../shared/data/moored/aqd9330.aqd"
COLUMNS = {
    "time": "time_s", "heading": "heading_deg", "pitch": "pitch_deg", "roll": "roll_deg",
    "pressure": "pressure_dbar", "temperature": "temperature_c", "volts": "supply_voltage",
}  # fmt: skip
SAMPLES, CELLS, REPEATS = 2000, 40, 5


def compare(path: Path) -> None:
    """Print the largest difference of each field, and what the bytes are."""
    record, known, found = read([path]), dict(np.load(path.with_suffix(".npz"))), packets(path)
    known["time"] = known["time"].astype("M8[s]").astype(float)
    fields = {theirs: (getattr(record, ours), known[theirs]) for theirs, ours in COLUMNS.items()}
    fields |= {"east": (record.east[:, 0], known["vel"][:, 0]), "north": (record.north[:, 0], known["vel"][:, 1])}
    print(f"{path.name}: {len(record.time_s)} samples, independent reading {len(known['time'])}; largest differences")
    print("  " + ", ".join(f"{name} {np.abs(ours - theirs).max():g}" for name, (ours, theirs) in fields.items()))
    kinds, times = np.unique(found.kind, return_counts=True)
    listed = ", ".join(f"{n} of {kind:02X}" for kind, n in zip(kinds, times, strict=True))
    print(f"  {found.data.size} bytes: records {listed}; {found.bytes_skipped} bytes in none, {found.damaged} damaged")


def damage(path: Path, folder: Path) -> None:
    """Print what a cut, a flipped bit, a hole, and a lost beginning cost."""
    data, there = path.read_bytes(), folder / "damaged.aqd"
    faults = {
        "cut": data[:2_000_001],
        "one bit flipped": data[:2_000_000] + bytes([data[2_000_000] ^ 16]) + data[2_000_001:],
        "50,003 bytes missing": data[:1_000_000] + data[1_050_003:],
        "without its first 3,000 bytes": data[3000:],
    }
    for name, damaged in faults.items():
        there.write_bytes(damaged)
        try:
            record = read([there])
            print(f"{name}: {len(record.time_s)} samples. {' '.join(record.warnings[:-1])}")
        except Exception as error:
            print(f"{name}: {error}")


def written(folder: Path) -> list[Path]:
    """Write profiles of an AWAC and of a Signature along their beams."""
    rng = np.random.default_rng(1)
    samples = [encoder.Sample(k, rng.integers(-900, 900, (4, CELLS)) / 1000.0) for k in range(SAMPLES)]
    of_three = [encoder.older(replace(sample, velocity=sample.velocity[:3])) for sample in samples]
    files = {
        "awac.wpr": encoder.configuration(encoder.BEAM, CELLS) + b"".join(of_three),
        "signature.ad2cp": encoder.text() + b"".join(map(encoder.signature, samples)),
    }
    for name, data in files.items():
        (folder / name).write_bytes(data)
    return [folder / name for name in files]


def library(path: Path) -> str:
    """Return mhkit's speed, or how it fails."""
    try:
        by_mhkit(path)  # its imports and its index are not its speed
        return f"mhkit {speed(path, by_mhkit, 1):.1f} MB/s"
    except Exception as error:
        return f"mhkit fails: {type(error).__name__}: {error}"


def main() -> None:
    """Print it all."""
    with tempfile.TemporaryDirectory() as name:
        folder, files = Path(name), []
        if GENUINE.exists():
            compare(GENUINE)
            damage(GENUINE, folder)
            (folder / GENUINE.name).write_bytes(GENUINE.read_bytes())  # mhkit writes beside what it reads
            files.append(folder / GENUINE.name)
        for path in (*files, *written(folder)):
            own = speed(path, lambda one: read([one]), REPEATS)
            print(f"{path.name} ({path.stat().st_size / 1e6:.1f} MB): here {own:.0f} MB/s, {library(path)}")


if __name__ == "__main__":
    main()
