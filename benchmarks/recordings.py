"""Detection and false alarms of the diagnosis of calibration recordings.

    PYTHONPATH=. python benchmarks/recordings.py [RECORDINGS] [--kind magnetometer|two_heads|swing]
    PYTHONPATH=. python benchmarks/recordings.py --storm     write the stored result of a magnetic storm

Nulls and recordings with one known effect are simulated (tests.world.recordings). A null that is attributed to an
effect or called unexplained is a false alarm; the target is at most 1 %. A set is right if it contains the truth;
parameters are right if the rms of their errors over their standard errors is 0.9 to 1.1. Real recordings with a
concealed effect are part of the demonstration.
"""

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import runs
import targets

from benchmarks.proof import seal
from compasslib import angles
from compasslib.calibrations import observatory
from compasslib.calibrations import two_heads as heads_of
from compasslib.calibrations.magnetometer.log import Log
from compasslib.calibrations.two_heads import motion as motions
from compasslib.inference import kinds as diagnoses
from compasslib.inference.comparison import Options
from compasslib.inference.diagnosis import Diagnosis
from compasslib.inference.kinds import declination, magnetometer, two_heads
from compasslib.readers import iaga2002
from compasslib.stages import demonstration
from tests.world import package, swing
from tests.world import recordings as drawn
from tests.world.package import Head, Sea
from tests.world.recordings import Truth

OPTIONS = Options()
Made = tuple[Diagnosis, Truth]


def log(rng: np.random.Generator, effect: str) -> Made:
    """Simulate and diagnose the log of a magnetometer."""
    made = drawn.log(rng, effect)
    tilts, rest = (made.pitch_deg, made.roll_deg), (made.time_s, 0, (), made.temperature_c)
    axes = Log(made.field_nt, True, *tilts, made.heading_deg, *rest)
    field = {"horizontal_nT": drawn.H_NT, "vertical_nT": drawn.Z_NT}
    return magnetometer.diagnose_log(axes, field=field, options=OPTIONS), made.truth


def swung(rng: np.random.Generator, effect: str) -> Made:
    """Simulate the log of a swing, write it as a table, and diagnose it."""
    sailed, truth = drawn.boat(rng, effect)
    declination = float(rng.uniform(-10.0, 10.0))
    with tempfile.TemporaryDirectory() as folder:
        path = drawn.written(swing.sail(rng, sailed, declination), Path(folder) / "swing.csv")
        return diagnoses.diagnose("swing", [path], {"declination": declination}, OPTIONS), truth


def heads(rng: np.random.Generator, effect: str) -> Made:
    """Simulate two heads on a lowered frame, write their PD0 files, and diagnose them."""
    noise, slow = rng.uniform(0.2, 0.8), {"slow_deg": rng.uniform(0.0, 0.8), "slow_s": rng.uniform(5.0, 60.0)}
    sea = Sea(turns=rng.uniform(-8.0, 8.0), wander_deg=rng.uniform(40.0, 90.0), swell_s=rng.uniform(6.0, 14.0))
    a = Head(noise_deg=noise, **slow)
    b = Head(mount_deg=(rng.uniform(-180.0, 180.0), 1.0, -1.0), noise_deg=noise, **slow)
    b = replace(b, clock_s=rng.uniform(2.0, 60.0)) if effect == "clock_offset" else b
    truth = {"offset_s": b.clock_s} if effect == "clock_offset" else Truth()
    motion = package.lower(rng, sea, 1.2e9)
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / "a.000", Path(folder) / "b.000"]
        for path, head in zip(paths, (a, b), strict=True):
            path.write_bytes(package.encoded(package.stand(rng, motion, head), looks_up=head.looks_up))
        first, second = heads_of.read_heads(paths, {})
    moved = [motions.extract_motion(one) for one in (first, second)]
    if effect == "heading_slip":
        late = np.arange(len(moved[1].time_s)) >= rng.uniform(0.3, 0.7) * len(moved[1].time_s)
        truth = {"offset_deg": rng.uniform(2.0, 6.0)}
        moved[1] = replace(moved[1], heading_deg=moved[1].heading_deg + truth["offset_deg"] * late)
    if effect == "compass_lag":
        time_s, truth = moved[1].time_s, {"lag_s": rng.uniform(1.0, 4.0)}
        moved[1] = replace(moved[1], heading_deg=np.interp(time_s - truth["lag_s"], time_s, moved[1].heading_deg))
    if effect == "sextantal":
        truth = {"sine_deg": rng.uniform(1.5, 3.0), "cosine_deg": 0.0}
        curve = truth["sine_deg"] * angles.sin_cos(3.0 * moved[1].heading_deg)[0]
        moved[1] = replace(moved[1], heading_deg=moved[1].heading_deg + curve)
    return two_heads.diagnose_motion(*moved, farthest_s=600.0, field=None, options=OPTIONS), truth


STORM = demonstration.Recording(
    name="storm",
    title="Declination at Eskdalemuir (BGS) on 29 October 2003, a magnetic storm",
    concealed="the storm: the simulation is IGRF and a constant",
    truth="the declination by the observatory's definitive minute values; by the planetary index Kp, 9 from 06:00 to "
    "09:00 UTC after 4 and less, the storm began in these hours",
    effects=["field_disturbance"],
    kind="declination",
    path=str(runs.DATA / "observatory/esk20031029dmin.min"),
)
QUIET, TURNED_DEG = runs.DATA / "observatory/esk20030610dmin.min", 2.0


def store_storm() -> None:
    """Write the diagnosis of a storm beside those of a day without one, as observed and with a simulated turn."""
    quiet = iaga2002.read([QUIET])
    field, _ = observatory.station_field(quiet, {}, str(QUIET))
    late = quiet.time_s >= np.mean(quiet.time_s)
    turned = replace(quiet, declination_deg=quiet.declination_deg + TURNED_DEG * late)
    made = demonstration.describe(STORM, STORM.diagnose() | {
        "10 June 2003, without a storm": declination.diagnose_series(quiet, field, OPTIONS),
        "the same, its sensor turned by 2° at noon (simulated)": declination.diagnose_series(turned, field, OPTIONS),
    })  # fmt: skip
    stored = seal.source("benchmarks/recordings.py --storm", [STORM.file, QUIET])
    (demonstration.FOLDER / "storm.json").write_text(json.dumps(made | {"stored": stored}, ensure_ascii=False) + "\n")


NULLS_EACH = 10  # number of nulls per recording with an effect
KINDS: dict[str, tuple[Callable[[np.random.Generator, str], Made], tuple[str, ...]]] = {
    "magnetometer": (
        log, ("hard_iron", "soft_iron", "hard_iron_step", "temperature", "tilt_uncompensated", "compass_lag"),
    ),
    "two_heads": (heads, ("heading_slip", "compass_lag", "clock_offset", "sextantal")),
    "swing": (swung, (
        "water_drift", "water_drift, one speed, ship's log", "water_drift, one speed, one circle", "course_lag",
        "compass_lag", "clock_offset", "sextantal", "octantal", "heading_slip", "(a card that hangs)",
        "(a while astray)",
    )),
}  # fmt: skip
HEAD = (
    *("kind", "effect", "in the set", "named alone and right", "other names", "unexplained", "insufficient"),
    *("z rms (numbers)", "CPU s"),
)


def row(kind: str, case: str, count: int, first: int) -> list[bool]:
    """Print the rates of recordings with one effect; return whether each has a wrong name or is unexplained."""
    make, effect = KINDS[kind][0], case.split(",")[0]
    held, false, off, begin = list[tuple[bool, ...]](), list[bool](), list[float](), time.process_time()
    for seed in range(first, first + count):
        found, truth = make(np.random.default_rng(seed), case)
        own = [one.parameters for one in found.findings if one.effect == effect]
        off += [(numbers[k].value - truth[k]) / numbers[k].sigma for numbers in own for k in truth]
        sets = [(one.effect, *one.alternatives) for one in found.findings]
        wrong = sorted(names[0] for names in sets if effect not in names)
        alone = {names[0] for names in sets} == {effect} and len(sets[0]) == 1
        of = (found.verdict == verdict for verdict in ("unexplained", "insufficient"))
        held.append((any(effect in names for names in sets), alone, bool(wrong), *of))
        false.append(bool(wrong) or found.unexplained is not None)
        if false[-1]:
            left = found.unexplained.covariates if found.unexplained else ()
            print(f"<!-- {kind} {case or 'null'} seed {seed}: {', '.join((*wrong, *left))} -->", file=sys.stderr)
    spent = (time.process_time() - begin) / count
    z = f"{np.sqrt(np.mean(np.square(off))):.2f} ({len(off)})" if off else "-"
    shares = map(targets.share_of, zip(*held, strict=True))
    targets.line(kind, case or "none", *shares, z, f"{spent:.1f}")
    return false


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recordings", nargs="?", type=int, default=300)
    parser.add_argument("--kind", choices=KINDS)
    parser.add_argument("--first", type=int, default=1, help="seed of the first recording")
    parser.add_argument("--storm", action="store_true", help="write the stored result of a magnetic storm")
    asked = parser.parse_args()
    if asked.storm:
        store_storm()
        return
    lines: list[targets.Measured] = []
    targets.head(*HEAD)
    for kind in [asked.kind] if asked.kind else KINDS:
        for case in ("", *KINDS[kind][1]):
            few = max(asked.recordings // NULLS_EACH, 1)
            said = row(kind, case, few if case else asked.recordings, asked.first)
            if not case:
                lines.append(targets.share(f"{kind}, nothing planted: named or unexplained", said, most=0.01))
    sys.exit(targets.report(lines))


if __name__ == "__main__":
    main()
