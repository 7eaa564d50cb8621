"""Draw the moorings of a proof by seed: kind, water, planted effects and their sizes."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.proof.world import compass, export, families, records, seas, waves
from benchmarks.proof.world.export import Export, Mooring
from benchmarks.proof.world.scene import Scene
from benchmarks.proof.world.seas import Weather

# Shares of kinds. The first rows have no planted effect: they differ in water, sphere, log, or reference.
MADE = {
    "null": 0.14, "noisy": 0.05, "turned": 0.05, "veering": 0.05, "reference": 0.05,
    "strange": 0.17, "shifted": 0.04, "undecidable": 0.05, "single": 0.30, "pair": 0.10,
}  # fmt: skip
REAL = {
    "null": 0.14, "rolled": 0.10, "mirrored": 0.10, "strange": 0.18, "shifted": 0.05, "single": 0.34, "pair": 0.09,
}  # fmt: skip
SMALLEST_DEG, LARGEST_DEG, LARGEST_STORM_DEG = 0.8, 4.5, 1.8
STRENGTHS = (0.05, 0.1, 0.2, 0.3, 0.45, 0.6)  # field of the iron relative to the earth's horizontal field
UNDECIDABLE = {"supply_loop": ("compass_drift", "hard_iron_drift"), "magnetic_storms": ()}  # with equivalent effects


@dataclass(frozen=True)
class Drawn:
    """Specification of one mooring."""

    name: str
    kind: str
    water: str = "made"  # made, internal waves, or the name of the record that is used or extended
    real: bool = False  # whether the record is used unchanged
    wanted: tuple[tuple[str, float], ...] = ()  # families and their visible sizes, rms degrees
    rivals: tuple[str, ...] = ()
    weather: Weather = field(default_factory=Weather)
    export: Export = field(default_factory=Export)
    seed: int = 0

    def random(self, purpose: str) -> np.random.Generator:
        """Create the random generator of one purpose on this mooring."""
        return np.random.default_rng([self.seed, int.from_bytes(f"{self.name}/{purpose}".encode(), "big")])


def draw(
    seed: int, counts: tuple[int, int], hours: int, there: dict[str, bool], *, second: bool = False
) -> list[Drawn]:
    """Draw the moorings of one proof, in simulated and in real water, in random order.

    Args:
        counts: numbers of moorings in simulated water, and in unchanged real records.
        hours: length of each record in simulated water.
        there: names of the real records, and whether the reference of each is made of its own samples.
        second: whether simulated water is that of the second world (``waves``).
    """
    rng = np.random.default_rng([seed, 1])
    turns = rng.integers(0, 1000, 2)
    made = []
    for letter, shares, count, turn in zip("PR", (MADE, REAL), counts, turns, strict=True):
        kinds = zip(rng.permutation(count), _kinds(shares, count), strict=True)
        for k, (place, each) in enumerate(kinds):
            name = f"{letter}{place + 1:03d}"
            made.append(_one(seed, name, each, int(turn) + k, (hours, there, letter == "R")))
    if second:
        made = [one if one.real else replace(one, water=waves.WATER) for one in made]
    return sorted(made, key=lambda one: one.name)


def write(one: Drawn, cruise: Path, locked: Path, data: Path) -> None:
    """Simulate one mooring and write its files to a cruise, and its truth to another folder."""
    scene = _scene(one, data)
    record = next((each for each in records.described(data) if each.name == one.water), None)
    meter = compass.build(one.random("compass"), scene, float(one.random("iron").choice(STRENGTHS)))
    known = {each.name: each for each in (*families.NAMED, *families.STRANGE)}
    planted = [compass.plant(scene, meter, known[name], size, one.random(name)) for name, size in one.wanted]
    facts: dict[str, Any] = {
        "kind": one.kind, "water": one.water, "real": one.real, "rivals": list(one.rivals),
        "wide": bool(np.abs(np.exp(1j * np.deg2rad(scene.heading_deg)).mean()) < 0.6),  # resultant length
        "stands_in": bool(record and record.stands_in),
    }  # fmt: skip
    export.write(Mooring(one.name, scene, meter, planted, one.export, one.random), cruise, locked, facts)


def _kinds(shares: dict[str, float], count: int) -> list[str]:
    """List the kinds, each in proportion to its share, by the method of largest remainders."""
    exact = {kind: share * count for kind, share in shares.items()}
    whole = {kind: int(x) for kind, x in exact.items()}
    order = sorted(exact, key=lambda kind: whole[kind] - exact[kind])
    for kind in order[: count - sum(whole.values())]:
        whole[kind] += 1
    return [kind for kind, n in whole.items() for _ in range(n)]


def _one(seed: int, name: str, kind: str, turn: int, how: tuple[int, dict[str, bool], bool]) -> Drawn:
    hours, there, real = how
    one = Drawn(name, kind, seed=seed, real=real)
    rng = one.random("draw")
    size = float(np.exp(rng.uniform(np.log(SMALLEST_DEG), np.log(LARGEST_DEG))))
    # Half of the simulated moorings are extended real records, if there are any with currents of two instruments.
    records_of = [record for record, stands_in in there.items() if real or not stands_in]
    water = records_of[turn % len(records_of)] if records_of and (real or rng.random() < 0.5) else "made"
    wanted, rivals = _wanted(kind, turn, size, real=real, rng=rng)
    names = [family for family, _ in wanted]
    needs = {need for each in families.NAMED if each.name in names for need in each.needs}
    battery = "line" if rivals else "change" if "battery" in needs or rng.random() < 0.15 else "knee"
    weather = Weather(
        hours=hours, wide=bool(rng.random() < 0.4), noise=2.0 if kind == "noisy" else 1.0, battery=battery,
        veer_deg=float(rng.uniform(2.0, 4.0)) if kind == "veering" else 0.8, spinning=kind == "turned",
    )  # fmt: skip
    seen = "observatory" in needs and kind != "undecidable"
    storm = "magnetic_storms" in names
    made = Export(
        table=bool(storm or rng.random() < 0.5), true_north=bool(storm or real), observatory=seen,
        shift=float(rng.uniform(0.2, 0.8)) if kind in ("shifted", "rolled") else 0.0, noise=weather.noise,
        by_ping=bool(rng.random() < 0.6), lost_beam=float(rng.uniform(0.1, 0.6)) if rng.random() < 0.2 else 0.0,
        fouling=float(rng.uniform(0.2, 0.6)) if rng.random() < 0.3 else 0.0,
        reference=1.5 if kind == "reference" else 1.0,
    )  # fmt: skip
    if kind == "reference":
        made = replace(made, table=False)
        water = "made"
    return replace(one, water=water, wanted=wanted, rivals=rivals, weather=weather, export=made)


def _wanted(
    kind: str, turn: int, size: float, *, real: bool, rng: np.random.Generator
) -> tuple[tuple[tuple[str, float], ...], tuple[str, ...]]:
    """Draw families with their sizes, and the effects that cannot be distinguished from them."""
    # A real record lacks an observatory, a change of battery and a discharge curve.
    named = [each for each in families.NAMED if not (real and (each.needs or each.name == "supply_loop"))]
    strange = families.STRANGE
    if kind == "single":
        one = named[turn % len(named)]
        return ((one.name, min(size, LARGEST_STORM_DEG) if one.name == "magnetic_storms" else size),), ()
    if kind == "pair":
        while True:
            first, second = (named[int(k)] for k in rng.choice(len(named), 2, replace=False))
            apart = not set(first.right) & set(second.right) and first.sized and second.sized
            if apart and "observatory" not in (*first.needs, *second.needs):
                return ((first.name, max(size, 1.3)), (second.name, max(size, 1.3))), ()
    if kind == "strange":
        return ((strange[turn % len(strange)].name, size),), ()
    if kind == "shifted":
        return (((("warm_steel", "warm_zero")[turn % 2]), size),), ()
    if kind == "undecidable":
        name = tuple(UNDECIDABLE)[turn % 2]
        return ((name, LARGEST_STORM_DEG if name == "magnetic_storms" else max(size, 1.5)),), UNDECIDABLE[name]
    return (), ()


def _scene(one: Drawn, data: Path) -> Scene:
    rng = one.random("scene")
    if one.water in (worlds := {"made": seas.make, waves.WATER: waves.make}):
        return worlds[one.water](rng, one.weather)
    known = next(each for each in records.described(data) if each.name == one.water)
    scene = records.cut(rng, known, records.whole(one.water, data), mirrored=one.kind == "mirrored")
    if not one.real:
        return records.longer(rng, scene, one.weather)
    count = min(scene.time_s.size, one.weather.hours)
    begin = int(rng.integers(0, scene.time_s.size - count + 1))
    some, n = slice(begin, begin + count), scene.time_s.size
    return replace(scene, **{k: v[some] for k, v in vars(scene).items() if np.shape(v)[:1] == (n,) and k != "range_m"})
