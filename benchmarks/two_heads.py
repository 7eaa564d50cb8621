"""Coverage of the 95 % intervals of a two-heads calibration.

    PYTHONPATH=. python benchmarks/two_heads.py [CASTS] [--first SEED]

Each cast is simulated by code independent of the analysis and written as PD0: turns, wander, swell, mounting, clock
offset and drift, noise, sampling and the deviation between the compasses are random. Between 93 and 97 % of the truths
should be inside 95 % intervals.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import defaultdict
from pathlib import Path

import numpy as np
import targets

from compasslib.calibrations import two_heads as heads
from tests.world import package
from tests.world.package import Head, Sea

WITHIN = 1.959964
FALSE_ALARM = "called a slipped mount"


def drawn(rng: np.random.Generator) -> tuple[Sea, Head, Head]:
    """Draw a sea and two heads at random."""
    sea = Sea(
        turns=rng.choice([0.0, rng.uniform(-8.0, 8.0)], p=[0.3, 0.7]),
        wander_deg=rng.uniform(20.0, 90.0),
        wander_s=rng.uniform(60.0, 300.0),
        swell_deg=rng.uniform(0.5, 2.5),
        swell_s=rng.uniform(6.0, 14.0),
        lean_deg=rng.uniform(0.0, 4.0),
        deepest_m=rng.uniform(500.0, 2500.0),
    )
    noise = rng.uniform(0.2, 1.0)
    slow = {"slow_deg": rng.uniform(0.0, 1.5), "slow_s": rng.uniform(5.0, 100.0)}
    # Ping intervals are whole hundredths of a second, to give all pings the same rounding of the clock.
    a = Head(ping_s=round(rng.uniform(0.8, 1.6), 2), noise_deg=noise, **slow)
    b = Head(
        mount_deg=(rng.uniform(-180.0, 180.0), *rng.normal(0.0, 2.0, 2)),
        looks_up=bool(rng.integers(2)),
        ping_s=round(rng.uniform(0.8, 1.6), 2),
        first_s=rng.uniform(0.0, 1.0),
        clock_s=rng.uniform(-60.0, 60.0),
        drift_s=rng.choice([0.0, rng.normal(0.0, 0.3)]),
        deviation_deg=(0.0, *rng.normal(0.0, 5.0, 2), *rng.normal(0.0, 2.0, 2)),
        noise_deg=noise,
        **slow,
    )
    return sea, a, b


def scores(seed: int, folder: Path) -> dict[str, float]:
    """Simulate and calibrate one cast, and compute the error of each quantity over its stated standard deviation."""
    rng = np.random.default_rng(seed)
    sea, a, b = drawn(rng)
    motion = package.lower(rng, sea, 1.2e9)
    paths = [folder / "a.000", folder / "b.000"]
    for path, head in zip(paths, (a, b), strict=True):
        path.write_bytes(package.encoded(package.stand(rng, motion, head), looks_up=head.looks_up))
    found = heads.calibrate(paths, {})
    said = found.details
    clock = said["clock"]
    drift_a_day = b.drift_s * 86400.0 / np.ptp(motion.time_s)
    slipped = any("the offset changes by" in warning for warning in found.warnings)
    errors = {
        "clock offset": (clock["offset_s"] - b.clock_s, clock["sigma_s"]),
        "clock drift": (clock["drift_s_per_day"] - drift_a_day, clock["drift_sigma_s_per_day"]),
    }
    if said["offset_from_tilts_deg"] is not None:
        off = heads.angles.difference(said["offset_from_tilts_deg"], b.mount_deg[0])
        errors["offset by tilts"] = (float(off), said["offset_from_tilts_sigma_deg"])
    off = heads.angles.difference(said["offset_deg"], b.mount_deg[0])
    errors[f"offset by headings, {said['terms']} terms"] = (float(off), said["offset_sigma_deg"])
    for k in range(1, said["terms"]):
        wrong = found.coefficients[k] - b.deviation_deg[k]
        errors[f"{'ABCDE'[k]} of {said['terms']} terms"] = (wrong, float(np.sqrt(found.covariance[k, k])))
    return {name: error / sigma for name, (error, sigma) in errors.items()} | {FALSE_ALARM: float(slipped)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("casts", nargs="?", type=int, default=400)
    parser.add_argument("--first", type=int, default=1, help="seed of the first cast")
    asked = parser.parse_args()
    collected: dict[str, list[float]] = defaultdict(list)
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(asked.first, asked.first + asked.casts):
            for name, score in scores(seed, Path(folder)).items():
                collected[name].append(score)
    alarms = collected.pop(FALSE_ALARM)
    targets.head("quantity", "rms of error over stated 1σ", "mean")
    for name, z in sorted(collected.items()):
        targets.line(name, f"{np.sqrt(np.mean(np.square(z))):.2f}", f"{np.mean(z):+.2f}")
    lines = [targets.share(name, np.abs(z) <= WITHIN, least=0.93, most=0.97) for name, z in sorted(collected.items())]
    sys.exit(targets.report([*lines, targets.share(f"{FALSE_ALARM}, where none was", alarms)]))


if __name__ == "__main__":
    main()
