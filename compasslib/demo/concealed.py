"""Demonstration moorings C1 to C4, whose causes are drawn by a seed and recorded in ``concealed/NAME.json`` only.

C1 has two causes, C2 one that the catalogue does not list, C3 one whose effect its record cannot decide, C4 none.
``python -m compasslib.demo.concealed FOLDER SEED`` writes a cruise of these moorings with another seed.
"""

import json
import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from compasslib import angles
from compasslib.demo import adcp, sealed
from compasslib.demo.sealed import Effect, Ground, Wish
from compasslib.demo.water import STEP_S, red_noise
from compasslib.types import HOUR_S, Floats


@dataclass(frozen=True)
class Cause:
    """A cause of heading errors that is planted in a mooring."""

    words: str
    driver: str
    effect: Callable[[float], Effect]  # as a function of its size
    name: str = ""  # in the catalogue; empty if it does not list the cause
    date_s: float | None = None


@dataclass(frozen=True)
class Case:
    """One of the moorings: its properties and the causes that may be planted in it."""

    title: str
    wish: Wish
    causes: Callable[[Ground, np.random.Generator], list[Cause]]
    shear: float = 1.0  # of the currents, relative to the other moorings
    lean_deg: float = 0.0  # rms of each tilt that the current does not drive
    undecidable: str = ""  # why the record shows the driver only


def write_mooring(name: str, raw_dir: Path | str, truth_path: Path | str, seed: int) -> None:
    """Write raw files into ``raw_dir/name``, and planted causes and headings to a separate file."""
    # The signal-to-noise ratio of a cause is drawn evenly from 4, the limit of a tool that knows the noise, to 15.
    case, rng = CASES[name], np.random.default_rng([seed, *name.encode()])
    ground = sealed.make(seed, name, case.wish)
    water, motion, count = ground.currents, ground.motion, ground.currents.time_s.size
    layers = water.layers.times(np.full(count, case.shear))
    tilts = [red_noise(rng, count, memory=30.0 * HOUR_S / STEP_S, deviation=case.lean_deg) for _ in range(2)]
    motion = replace(motion, pitch_deg=motion.pitch_deg + tilts[0], roll_deg=motion.roll_deg + tilts[1])
    ground = replace(ground, currents=replace(water, layers=layers), motion=motion)
    planted, effects = [], []
    for cause in case.causes(ground, rng):
        effect, z, size_deg = _sized(ground, cause.effect, float(rng.uniform(4.0, 15.0)))
        effects.append(effect)
        date = None if cause.date_s is None else str(np.datetime64(round(cause.date_s), "s"))
        field = None
        if effect.body_nt is not None:  # of iron, which is either constant or came in a step
            at = map(round, effect.body_nt[-1].tolist())
            field = dict(zip(("forward", "starboard", "down"), at, strict=True)) | {"unit": "nT"}
        sizes = {"z": round(z, 1), "size_deg": round(size_deg, 2), "field": field}
        planted.append({"what": cause.words, "driver": cause.driver, "effect": cause.name, "date": date, **sizes})
    truth = sealed.write(ground, effects, Path(raw_dir) / name)
    told = {
        "mooring": name, "title": case.title, "seed": seed, "undecidable": case.undecidable, "planted": planted,
        "time_s": truth.time_s.tolist(),
        "heading_deg": [None if np.isnan(x) else round(x, 3) for x in truth.heading_deg.tolist()],
    }  # fmt: skip
    Path(truth_path).parent.mkdir(parents=True, exist_ok=True)
    Path(truth_path).write_text(json.dumps(told) + "\n", encoding="utf-8")


def signal_to_noise(speed: Floats, heading_deg: Floats, turn: Floats, noise: Floats) -> float:
    """Compute the signal-to-noise ratio z of a cause, beyond what five coefficients fit, where the noise is known.

    The logarithm of the likelihood ratio of a tool that knows cause and noise is z^2 / 2 on average.

    Args:
        turn: of the readings by the cause, radians, (n,).
        noise: difference of the currents at both depths across the flow, m/s, (n,). Its spectrum is taken by bands;
            that of the slowest is not known from one series, so that z of a slow cause is an upper limit.
    """
    columns = speed[:, None] * np.column_stack([turn, waves(heading_deg)])
    power = np.abs(np.fft.rfft(noise)[1:]) ** 2
    band = np.searchsorted(np.geomspace(4.0, len(power), 24), np.arange(1, len(power) + 1))
    known = (np.bincount(band, power) / np.maximum(np.bincount(band), 1))[band]
    white = np.fft.rfft(columns, axis=0)[1:] / np.sqrt(known)[:, None]
    return float(np.sqrt(2.0) * np.linalg.norm(beyond(np.concatenate([white.real, white.imag]))))


def waves(heading_deg: Floats) -> Floats:
    """Compute what five coefficients of a deviation can fit, (n, 5)."""
    columns = [column for k in (1.0, 2.0) for column in angles.sin_cos(k * heading_deg)]
    return np.column_stack([np.ones(len(heading_deg)), *columns])


def beyond(columns: Floats) -> Floats:
    """Subtract from the first column, (n, k), what the others fit."""
    first, others = columns[:, 0], columns[:, 1:]
    return np.asarray(first - others @ np.linalg.lstsq(others, first, rcond=None)[0])


def _sized(ground: Ground, effect: Callable[[float], Effect], wanted: float) -> tuple[Effect, float, float]:
    """Scale an effect to a signal-to-noise ratio; return it with the ratio and its visible size, degrees rms."""
    plain = sealed.read(ground, [], ground.stamp_s)
    upper = adcp.near_bins(sealed.TOP, plain, ground.currents)
    lower = adcp.near_bins(sealed.DEEP, sealed.deep_stance(ground, []), ground.currents)
    noise = np.imag((lower - upper) * np.conj(upper) / np.abs(upper))
    noise += ground.random("z").normal(0.0, 0.017, len(upper))
    size, z = 1.0, 1.0
    for _ in range(4):  # iron is not quite proportional to its size
        size *= wanted / z
        read = sealed.read(ground, [effect(size)], ground.stamp_s).recorded_deg
        turn = np.deg2rad(angles.difference(read, plain.recorded_deg))
        z = signal_to_noise(np.abs(upper), plain.heading_deg, turn, noise)
    left = beyond(np.column_stack([turn, waves(plain.heading_deg)]))
    return effect(size), z, float(np.rad2deg(np.std(left)))


def _iron(series: Floats, direction: Floats) -> Callable[[float], Effect]:
    return lambda size: Effect(body_nt=250.0 * size * series[:, None] * direction)


def _knocked(ground: Ground, rng: np.random.Generator) -> list[Cause]:
    date = float(ground.stamp_s[int(rng.uniform(0.3, 0.7) * ground.stamp_s.size)])
    after = (ground.stamp_s > date).astype(float)
    angle = rng.uniform(0.0, 2.0 * np.pi)
    effect = _iron(after, np.array([np.cos(angle), np.sin(angle), 0.4 * rng.normal()]))
    return [Cause("the sphere's iron changed at once", "time", effect, "hard_iron_step", date)]


def _knocked_and_leaning(ground: Ground, rng: np.random.Generator) -> list[Cause]:
    always = np.ones(ground.stamp_s.size)
    upright = _iron(always, np.array([0.0, 0.0, rng.choice([-1.0, 1.0])]))
    heeling = "vertical iron, which reaches the compass as the sphere tilts (heeling)"
    return [*_knocked(ground, rng), Cause(heeling, "tilt", upright, "heeling")]


def _unlisted(ground: Ground, rng: np.random.Generator) -> list[Cause]:
    warm = np.interp(ground.stamp_s, ground.currents.time_s, ground.temperature_c)
    core, share = warm.copy(), 1.0 - np.exp(-1.0 / rng.uniform(6.0, 18.0))  # that it loses of the difference in an hour
    for k in range(1, warm.size):
        core[k] = core[k - 1] + share * (warm[k] - core[k - 1])
    bent = "the compass's board bent while its core was still colder or warmer than the water"
    turn = ((warm - core) / np.std(warm - core))[:, None]
    return [Cause(bent, "temperature", lambda size: Effect(reading=lambda gamma: size * turn + 0.0 * gamma))]


HOURS, BEGIN_S = 3000, 1406851200.0  # from 1 August 2014 on
CASES = {
    "C1": Case(
        "iron that changed, and heeling", Wish(True, HOURS, (60.5, -41.2, 420.0), BEGIN_S, 0.25),
        _knocked_and_leaning, lean_deg=2.0,
    ),
    "C2": Case("a cause that nobody listed", Wish(True, HOURS, (61.0, -40.1, 510.0), BEGIN_S, 0.2), _unlisted),
    "C3": Case(
        "changed iron or a slipped compass", Wish(False, HOURS, (62.1, -38.6, 380.0), BEGIN_S, 0.3), _knocked,
        undecidable="where the headings vary little, changed iron and a slip turn them alike",
    ),
    "C4": Case(
        "nothing, though it looks so", Wish(False, HOURS, (63.4, -36.0, 600.0), BEGIN_S, 0.3), lambda *_: [], shear=2.2
    ),
}  # fmt: skip


def main(folder: str, seed: str) -> None:
    """Write the configuration of a cruise of these moorings with a given seed."""
    to = Path(folder) / "config/moorings"
    to.mkdir(parents=True, exist_ok=True)
    for name in CASES:
        shutil.copy(Path(__file__).parents[2] / f"config/moorings/{name}.yaml", to)
    (to.parent / "config.yaml").write_text(f"moorings: config/moorings\ndemonstration: true\nseed: {int(seed)}\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
