"""Demonstration moorings C1 to C4, whose errors are drawn by a seed and recorded in ``concealed/NAME.json`` only.

``python -m compasslib.demo.concealed FOLDER SEED`` writes a cruise of these moorings with another seed.
"""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from compasslib.demo import sealed
from compasslib.demo.sealed import Effect, Ground, Wish
from compasslib.demo.water import HOUR_S, Floats

BEGIN_S = 1406851200.0  # 1 August 2014
IRON_NT, SMALLEST_DEG, LARGEST_DEG = 250.0, 2.5, 4.0
AXES = ("forward", "starboard", "down")
SHEAR = 2.2  # shear of the currents at C4 relative to the other moorings


@dataclass(frozen=True)
class Cause:
    """A cause of heading errors that is planted in a mooring."""

    words: str
    driver: str
    effect: Callable[[float], Effect]  # as a function of its size
    date_s: float | None = None
    along: Floats | None = None  # (n,) driver on which its iron depends linearly; None if it is not iron
    unit: str = "nT"  # of the field of the iron per unit of ``along``

    def field(self, effect: Effect) -> dict[str, int | str] | None:
        """Compute the field of its iron forward, to starboard and down, per unit of ``along``; None without iron."""
        if self.along is None or effect.body_nt is None:
            return None
        first, last = int(np.argmin(self.along)), int(np.argmax(self.along))
        change = effect.body_nt[last] - effect.body_nt[first]
        field = change / np.ptp(self.along) if np.ptp(self.along) else effect.body_nt[0]
        return {name: round(float(x)) for name, x in zip(AXES, field, strict=True)} | {"unit": self.unit}


@dataclass(frozen=True)
class Case:
    """One of the moorings: its properties and the causes that may be planted in it."""

    title: str
    wish: Wish
    causes: Callable[[Ground, np.random.Generator], list[Cause]]
    shear: float = 1.0


def write_mooring(name: str, raw_dir: Path | str, truth_path: Path | str, seed: int) -> None:
    """Write the raw files of one mooring into ``raw_dir/name``, and planted causes and headings to a separate file."""
    case, rng = CASES[name], np.random.default_rng([seed, *name.encode()])
    ground = sealed.make(seed, name, case.wish)
    layers = ground.currents.layers.times(np.full(ground.currents.time_s.size, case.shear))
    ground = replace(ground, currents=replace(ground.currents, layers=layers))
    planted, effects = [], []
    for cause in case.causes(ground, rng):
        effect, size_deg = _sized(ground, cause.effect, float(rng.uniform(SMALLEST_DEG, LARGEST_DEG)))
        effects.append(effect)
        date = None if cause.date_s is None else str(np.datetime64(round(cause.date_s), "s"))
        planted.append(
            {"what": cause.words, "driver": cause.driver, "date": date, "size_deg": round(size_deg, 2)}
            | {"field": cause.field(effect)}
        )
    truth = sealed.write(ground, effects, Path(raw_dir) / name, sealed.Export())
    told = {
        "mooring": name,
        "title": case.title,
        "seed": seed,
        "planted": planted,
        "time_s": truth.time_s.tolist(),
        "heading_deg": [None if np.isnan(x) else round(x, 3) for x in truth.heading_deg.tolist()],
    }
    Path(truth_path).parent.mkdir(parents=True, exist_ok=True)
    Path(truth_path).write_text(json.dumps(told) + "\n", encoding="utf-8")


def signal_to_noise(speed: Floats, heading_deg: Floats, turn: Floats, noise: Floats, *, bands: int = 24) -> float:
    """Compute the signal-to-noise ratio z of a cause, beyond what five coefficients fit, where the noise is known.

    The logarithm of the likelihood ratio of a tool that knows cause and noise is z^2 / 2 on average.

    Args:
        speed: of the current, m/s, (n,).
        turn: of the readings by the cause, radians, (n,).
        noise: difference of the currents at both depths across the flow, m/s, (n,); its spectrum is taken by bands.
    """
    angle = np.deg2rad(heading_deg)
    waves = [wave(k * angle) for k in (1, 2) for wave in (np.cos, np.sin)]
    columns = speed[:, None] * np.stack([turn, np.ones(len(angle)), *waves], axis=1)
    power = np.abs(np.fft.rfft(noise)[1:]) ** 2
    band = np.searchsorted(np.geomspace(4.0, len(power), bands), np.arange(1, len(power) + 1))
    known = (np.bincount(band, power) / np.maximum(np.bincount(band), 1))[band]
    white = np.fft.rfft(columns, axis=0)[1:] / np.sqrt(known)[:, None]
    signal, fitted = np.concatenate([white.real, white.imag])[:, 0], np.concatenate([white.real, white.imag])[:, 1:]
    return float(np.sqrt(2.0) * np.linalg.norm(signal - fitted @ np.linalg.lstsq(fitted, signal, rcond=None)[0]))


def visible_deg(ground: Ground, effects: list[Effect]) -> float:
    """Compute the rms change of the readings by effects that five coefficients of a deviation cannot fit, degrees."""
    time = ground.stamp_s
    plain, changed = sealed.read(ground, [], time), sealed.read(ground, effects, time)
    turn = np.exp(1j * np.deg2rad(changed.recorded_deg - plain.recorded_deg))
    off, angle = np.rad2deg(np.angle(turn)), np.deg2rad(plain.heading_deg)
    waves = [wave(k * angle) for k in (1, 2) for wave in (np.cos, np.sin)]
    columns = np.stack([np.ones(len(angle)), *waves], axis=1)
    return float(np.std(off - columns @ np.linalg.lstsq(columns, off, rcond=None)[0]))


def _sized(ground: Ground, effect: Callable[[float], Effect], wanted_deg: float) -> tuple[Effect, float]:
    """Scale an effect iteratively to a visible size near the wanted one."""
    size, visible = 1.0, 0.0
    for _ in range(4):
        visible = visible_deg(ground, [effect(size)])
        if abs(visible - wanted_deg) < 0.1 * wanted_deg:
            break
        size *= float(np.clip(wanted_deg / max(visible, 1e-3), 0.2, 5.0))
    return effect(size), visible


def _unit(series: Floats) -> Floats:
    return np.asarray((series - series.mean()) / series.std())


def _along(ground: Ground, series: Floats) -> Floats:
    """Interpolate a series on the time axis of the water to the ensembles."""
    return np.interp(ground.stamp_s, ground.currents.time_s, series)


def _iron(series: Floats, direction: Floats) -> Callable[[float], Effect]:
    return lambda size: Effect("iron", body_nt=IRON_NT * size * series[:, None] * direction)


def _shift(series: Floats) -> Callable[[float], Effect]:
    return lambda size: Effect("reading", reading=lambda gamma: size * series[:, None] + 0.0 * gamma)


def _direction(rng: np.random.Generator) -> Floats:
    angle = rng.uniform(0.0, 2.0 * np.pi)
    return np.array([np.cos(angle), np.sin(angle), 0.4 * rng.normal()])


def _knocked(ground: Ground, rng: np.random.Generator) -> list[Cause]:
    date = float(ground.stamp_s[int(rng.uniform(0.3, 0.7) * ground.stamp_s.size)])
    after = (ground.stamp_s > date).astype(float)
    upright = _iron(np.ones(ground.stamp_s.size), np.array([0.0, 0.0, 4.0 * rng.choice([-1.0, 1.0])]))
    heeling = "vertical iron, which reaches the compass as the sphere leans (heeling)"
    return [
        Cause("the sphere's iron changed at once", "time", _iron(after, _direction(rng)), date, after),
        Cause(heeling, "tilt", upright, along=0.0 * after),
    ]


def _unlisted(ground: Ground, rng: np.random.Generator) -> list[Cause]:
    time, speed = ground.stamp_s, _along(ground, np.abs(ground.currents.surface + ground.currents.column))
    every, near = rng.uniform(20.0, 60.0) * HOUR_S, rng.uniform(0.12, 0.3)
    turns = ((time - time[0]) / every) % 1.0
    passing = np.exp(-0.5 * (np.minimum(turns, 1.0 - turns) / near) ** 2)
    strummed = np.exp(-0.5 * ((speed - np.quantile(speed, rng.uniform(0.4, 0.7))) / (0.3 * speed.std())) ** 2)
    warm = _unit(_along(ground, ground.temperature_c))
    bent = _unit(np.gradient(np.convolve(warm, np.ones(12) / 12.0, "same")))
    often = f"a profiler passed on the wire every {every / HOUR_S:.0f} hours"
    causes = [
        Cause(often, "time", _iron(passing, _direction(rng)), along=passing),
        Cause("the wire strummed at one speed and shook the compass", "speed", _shift(strummed)),
        Cause("a circuit board of the compass bent while it warmed or cooled", "temperature", _shift(bent)),
    ]
    return [causes[int(rng.integers(len(causes)))]]


def _warmed(ground: Ground, rng: np.random.Generator) -> list[Cause]:
    warm = _along(ground, ground.temperature_c)
    effect = _iron(_unit(warm), _direction(rng))
    return [Cause("the iron's magnetism changed with temperature", "temperature", effect, along=warm, unit="nT/K")]


def _wish(latitude: float, longitude: float, depth_m: float, *, wide: bool, strength: float) -> Wish:
    return Wish(wide=wide, hours=3000, site=(latitude, longitude, depth_m), begin_s=BEGIN_S, strength=strength)


CASES = {
    "C1": Case("iron that changed, and heeling", _wish(60.5, -41.2, 420.0, wide=True, strength=0.25), _knocked),
    "C2": Case("a cause that nobody listed", _wish(61.0, -40.1, 510.0, wide=True, strength=0.2), _unlisted),
    "C3": Case(
        "a two-valued compass, and iron that depends on temperature",
        _wish(62.1, -38.6, 380.0, wide=True, strength=1.3),
        _warmed,
    ),
    "C4": Case(
        "nothing, though it looks so", _wish(63.4, -36.0, 600.0, wide=False, strength=0.3), lambda *_: [], SHEAR
    ),
}


def main(folder: str, seed: str) -> None:
    """Write the configuration of a cruise of these moorings with a given seed."""
    to = Path(folder) / "config/moorings"
    to.mkdir(parents=True, exist_ok=True)
    for name in CASES:
        shutil.copy(Path(__file__).parents[2] / f"config/moorings/{name}.yaml", to)
    (to.parent / "config.yaml").write_text(f"moorings: config/moorings\ndemonstration: true\nseed: {int(seed)}\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
