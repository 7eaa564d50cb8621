"""Does the diagnosis of recordings name what is there, and nothing where nothing is?

    PYTHONPATH=. python benchmarks/recordings.py [RECORDINGS] [--kind platform|magnetometer|two_heads|swing|real]

Nulls and recordings with one known effect are drawn anew (recordings_world.py). A null that gets a name or is called
unexplained is a false alarm; at most 1 % is the target. A set is right where it holds the truth; parameters are right
where their errors over their own standard errors have an rms of 0.9 to 1.1. Then the real recordings, each with an
effect concealed from the simulation or a column withheld. Declinations are drawn in observatory.py.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Callable

import numpy as np
from recordings_real import real
from recordings_world import Made, bench, heads, log, swung

from compasslib.search.verdict import Diagnosis

NULLS_EACH = 10  # nulls for each recording with an effect
KINDS: dict[str, tuple[Callable[[np.random.Generator, str], Made], tuple[str, ...]]] = {
    "platform": (bench, ("sextantal", "octantal", "heading_slip", "large_deviation")),
    "magnetometer": (
        log,
        ("hard_iron", "soft_iron", "hard_iron_step", "temperature", "tilt_uncompensated", "compass_lag"),
    ),
    "two_heads": (heads, ("heading_slip", "compass_lag", "clock_offset", "sextantal")),
    "swing": (
        swung,
        (
            "water_drift",
            "water_drift, one speed, ship's log",
            "water_drift, one speed, one circle",
            "course_lag",
            "compass_lag",
            "clock_offset",
            "sextantal",
            "octantal",
            "heading_slip",
            "(a card that hangs)",
            "(a while astray)",
        ),
    ),
}
HEAD = (
    "| kind | effect | recordings | in the set | named alone and right | other names | unexplained | insufficient | "
    "z rms (numbers) | CPU s |"
)


def said(found: Diagnosis) -> set[str]:
    """Return all effects that a diagnosis holds for possible."""
    return {name for one in found.findings for name in (one.effect, *one.alternatives)}


def errors(found: Diagnosis, effect: str, truth: dict[str, float]) -> list[float]:
    """Return the errors of an effect's parameters in their own standard errors."""
    own = [one for one in found.findings if one.effect == effect]
    return [(one.parameters[k].value - truth[k]) / one.parameters[k].sigma for one in own for k in truth]


def row(kind: str, case: str, count: int, first: int) -> None:
    """Print what is said of recordings with one effect."""
    make, effect = KINDS[kind][0], case.split(",")[0]
    tally, off, begin = Counter[str](), list[float](), time.process_time()
    for seed in range(first, first + count):
        found, truth = make(np.random.default_rng(seed), case)
        names = {one.effect for one in found.findings}
        off += errors(found, effect, truth)
        tally["set"] += effect in said(found)
        tally["alone"] += names == {effect} and not found.findings[0].alternatives
        wrong = sorted(one.effect for one in found.findings if effect not in (one.effect, *one.alternatives))
        tally["other"] += bool(wrong)
        tally["unexplained"] += found.verdict == "unexplained"
        tally["insufficient"] += found.verdict == "insufficient"
        if wrong or found.unexplained:
            left = found.unexplained.covariates if found.unexplained else ()
            tally[f"  {kind} {case or 'null'} seed {seed}: {', '.join((*wrong, *left))}"] += 1
    spent = (time.process_time() - begin) / count
    shares = [f"{tally[key] / count:.1%}" for key in ("set", "alone", "other", "unexplained", "insufficient")]
    z = f"{np.sqrt(np.mean(np.square(off))):.2f} ({len(off)})" if off else "-"
    print(f"| {kind} | {case or 'none'} | {count} | {' | '.join(shares)} | {z} | {spent:.1f} |", flush=True)
    for key in (key for key in tally if key.startswith(" ")):
        print(f"<!-- {key.strip()} -->")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recordings", nargs="?", type=int, default=300)
    parser.add_argument("--kind", choices=(*KINDS, "real"))
    parser.add_argument("--first", type=int, default=1, help="seed of the first recording")
    asked = parser.parse_args()
    kinds = [asked.kind] if asked.kind else [*KINDS, "real"]
    if kinds != ["real"]:
        print(HEAD + "\n|" + "---|" * (HEAD.count("|") - 1))
    for kind in (kind for kind in kinds if kind != "real"):
        for case in ("", *KINDS[kind][1]):
            few = max(asked.recordings // NULLS_EACH, 1)
            row(kind, case, few if case else asked.recordings, asked.first)
    if "real" in kinds:
        print(real())


if __name__ == "__main__":
    main()
