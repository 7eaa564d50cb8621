"""Does the diagnosis of recordings name what is there, and nothing where nothing is?

    PYTHONPATH=. python benchmarks/recordings.py [RECORDINGS] [--kind platform|magnetometer|two_heads] [--first SEED]

Nulls and recordings with one known effect are drawn anew: headings, noise, iron, place in the record. A null that gets
a name or is called unexplained is a false alarm; at most 1 % is the target. A set is right where it holds the truth.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from compasslib import angles, compass
from compasslib.calibration.magnetometer_log import Log
from compasslib.discrepancy.diagnosis import Options
from compasslib.discrepancy.recordings import magnetometer, platform, two_heads
from compasslib.discrepancy.verdict import Diagnosis
from compasslib.nature import package
from compasslib.nature.package import Head, Sea

OPTIONS = Options()
H_NT, Z_NT = 20000.0, 42000.0
MOST_FALSE = 0.01
Truth = str


def bench(rng: np.random.Generator, effect: Truth) -> Diagnosis:
    """Return the diagnosis of a bench of 16 to 36 headings."""
    count = int(rng.integers(16, 37))
    rounds = 3 if effect in ("heading_slip", "hard_iron_step") else int(rng.integers(1, 4))
    correct = np.tile(360.0 / count * np.arange(count) + rng.uniform(0.0, 10.0), rounds)
    iron = np.append(rng.normal(0.0, 0.02), rng.normal(0.0, 0.12, 2))
    iron = np.append(iron, rng.normal(0.0, 0.02, 2))
    if effect == "large_deviation":
        iron[1:3] = rng.uniform(0.6, 1.4) * np.array(angles.sin_cos(rng.uniform(0.0, 360.0)))
    recorded = compass.recorded_heading(iron, correct)
    if effect in ("sextantal", "octantal"):
        cycles = 3 if effect == "sextantal" else 4
        recorded = recorded + rng.uniform(1.2, 3.0) * angles.sin_cos(cycles * recorded + rng.uniform(0.0, 360.0))[0]
    if effect == "heading_slip":
        recorded = recorded + rng.uniform(1.5, 4.0) * (np.arange(len(correct)) >= rng.uniform(0.3, 0.7) * len(correct))
    noise = rng.normal(0.0, rng.uniform(0.1, 0.6), len(correct))
    return platform.judge(correct, angles.wrap360(recorded + noise), field=None, options=OPTIONS)


def log(rng: np.random.Generator, effect: Truth) -> Diagnosis:
    """Return the diagnosis of a magnetometer's log: some turns with tilts, its heading logged or not."""
    n, turns = 1500, rng.uniform(3.0, 8.0)
    time_s = 1.6e9 + np.arange(n) * 1.0
    heading = 360.0 * turns * np.arange(n) / n + 20.0 * np.sin(np.arange(n) / rng.uniform(20.0, 60.0))
    pitch, roll = (rng.uniform(-1.0, 1.0) + 2.0 * np.sin(np.arange(n) / rng.uniform(5.0, 40.0)) for _ in range(2))
    level = np.column_stack([H_NT * angles.sin_cos(heading)[1], -H_NT * angles.sin_cos(heading)[0], np.full(n, Z_NT)])
    tilting = compass.levelling(pitch, roll)
    if effect != "tilt_uncompensated":
        pitch, roll, tilting = np.zeros(n), np.zeros(n), np.broadcast_to(np.eye(3), (n, 3, 3))
    field = np.einsum("nji,nj->ni", tilting, level)
    temperature = 10.0 + 5.0 * np.sin(np.arange(n) / rng.uniform(150.0, 300.0))
    hard = rng.uniform(1000.0, 6000.0) * np.append(angles.sin_cos(rng.uniform(0.0, 360.0)), 0.0)
    if effect == "hard_iron":
        field = field + hard
    if effect == "soft_iron":
        field = field * np.array([1.0 + rng.uniform(0.04, 0.12), 1.0, 1.0])
    if effect == "hard_iron_step":
        field = field + hard / 2.0 * (np.arange(n) >= rng.uniform(0.3, 0.7) * n)[:, None]
    if effect == "temperature":
        field = field + hard / 12.0 * (temperature - 10.0)[:, None]
    noise = rng.normal(0.0, rng.uniform(20.0, 150.0), (n, 3))
    shown = np.einsum("nij,nj->ni", tilting, field + noise)
    logged = angles.argument(shown[:, 0] - 1j * shown[:, 1])
    if effect == "compass_lag":
        logged = angles.wrap360(np.interp(np.arange(n) - rng.uniform(2.0, 6.0), np.arange(n), heading))
    tilts = (None, None) if not pitch.any() else (pitch, roll)
    made = Log(field + noise, True, tilts[0], tilts[1], logged, time_s, 0, (), temperature)
    return magnetometer.judge(made, field={"horizontal_nT": H_NT, "vertical_nT": Z_NT}, options=OPTIONS)


def heads(rng: np.random.Generator, effect: Truth) -> Diagnosis:
    """Return the diagnosis of two heads in the simulated sea, through PD0 bytes."""
    noise, slow = rng.uniform(0.2, 0.8), {"slow_deg": rng.uniform(0.0, 0.8), "slow_s": rng.uniform(5.0, 60.0)}
    sea = Sea(turns=rng.uniform(-8.0, 8.0), wander_deg=rng.uniform(40.0, 90.0), swell_s=rng.uniform(6.0, 14.0))
    a = Head(noise_deg=noise, **slow)
    b = Head(mount_deg=(rng.uniform(-180.0, 180.0), 1.0, -1.0), noise_deg=noise, **slow)
    b = replace(b, clock_s=rng.uniform(2.0, 60.0)) if effect == "clock_offset" else b
    motion = package.lower(rng, sea, 1.2e9)
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / "a.000", Path(folder) / "b.000"]
        for path, head in zip(paths, (a, b), strict=True):
            path.write_bytes(package.encoded(package.stand(rng, motion, head), looks_up=head.looks_up))
        first, second = (two_heads.two_heads.record(path, {}, k) for k, path in enumerate(paths))
    moved = [two_heads.heads_motion.motion(one) for one in (first, second)]
    if effect == "heading_slip":
        late = np.arange(len(moved[1].time_s)) >= rng.uniform(0.3, 0.7) * len(moved[1].time_s)
        moved[1] = replace(moved[1], heading_deg=moved[1].heading_deg + rng.uniform(2.0, 6.0) * late)
    if effect == "compass_lag":
        time_s = moved[1].time_s
        moved[1] = replace(
            moved[1], heading_deg=np.interp(time_s - rng.uniform(1.0, 4.0), time_s, moved[1].heading_deg)
        )
    if effect == "sextantal":
        curve = rng.uniform(1.5, 3.0) * angles.sin_cos(3.0 * moved[1].heading_deg)[0]
        moved[1] = replace(moved[1], heading_deg=moved[1].heading_deg + curve)
    return two_heads.judge(*moved, farthest_s=600.0, field=None, options=OPTIONS)


KINDS: dict[str, tuple[Callable[[np.random.Generator, Truth], Diagnosis], tuple[Truth, ...]]] = {
    "platform": (bench, ("sextantal", "octantal", "heading_slip", "large_deviation")),
    "magnetometer": (
        log,
        ("hard_iron", "soft_iron", "hard_iron_step", "temperature", "tilt_uncompensated", "compass_lag"),
    ),
    "two_heads": (heads, ("heading_slip", "compass_lag", "clock_offset", "sextantal")),
}


def said(found: Diagnosis) -> set[str]:
    """Return all effects that a diagnosis holds for possible."""
    return {name for one in found.findings for name in (one.effect, *one.alternatives)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recordings", nargs="?", type=int, default=300)
    parser.add_argument("--kind", choices=tuple(KINDS))
    parser.add_argument("--first", type=int, default=1, help="seed of the first recording")
    asked = parser.parse_args()
    print("| kind | effect | recordings | in the set | named alone and right | other names | unexplained |")
    print("|---|---|---|---|---|---|---|")
    for kind in [asked.kind] if asked.kind else KINDS:
        make, effects = KINDS[kind]
        for effect in ("", *effects):
            count = asked.recordings if not effect else max(asked.recordings // 10, 1)
            tally: Counter[str] = Counter()
            for seed in range(asked.first, asked.first + count):
                found = make(np.random.default_rng(seed), effect)
                names = {one.effect for one in found.findings}
                tally["set"] += effect in said(found)
                tally["alone"] += names == {effect} and not found.findings[0].alternatives
                wrong = sorted(names - {effect})
                tally["other"] += bool(wrong)
                tally["unexplained"] += found.verdict == "unexplained"
                if wrong or found.unexplained:
                    left = found.unexplained.covariates if found.unexplained else ()
                    tally[f"  {kind} {effect or 'null'} seed {seed}: {', '.join((*wrong, *left))}"] += 1
            shares = [f"{tally[key] / count:.1%}" for key in ("set", "alone", "other", "unexplained")]
            print(f"| {kind} | {effect or 'none'} | {count} | {' | '.join(shares)} |", flush=True)
            for key in tally:
                if key.startswith(" "):
                    print(f"<!-- {key.strip()} -->")


if __name__ == "__main__":
    main()
