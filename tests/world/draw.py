"""Simulated moorings with planted effects of requested visible size, written as a cruise folder beside their truth."""

from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks.proof.world.compass import left_deg
from compasslib.demo import adcp, sealed
from compasslib.demo import water as sea
from compasslib.demo.sealed import DEEP_SAMPLE_S, Effect, Ground, Wish
from compasslib.demo.water import Floats, clockwise

ROUNDS = 3
EVERY = 3  # hours, sufficient for the size of an effect


def write_alone(folder: Path, name: str, wish: Wish, seed: int, wanted: dict[str, float]) -> tuple[Path, Path]:
    """Write a cruise of one mooring, and its times, correct and recorded headings; return the folders of both.

    Args:
        wanted: visible size of each effect, rms degrees.
    """
    cruise, locked = folder / "cruise", folder / "locked"
    (cruise / "config/moorings").mkdir(parents=True)
    locked.mkdir()
    ground = sealed.make(seed, name, wish)
    effects = [plant(ground, effect, wanted_deg)[0] for effect, wanted_deg in wanted.items()]
    raw = sealed.write(ground, effects, cruise / "raw" / name)
    (cruise / "config/config.yaml").write_text("diagnose: {surrogates: 39}\n")
    (cruise / f"config/moorings/{name}.yaml").write_text(yaml.safe_dump(described(ground), sort_keys=False))
    np.save(locked / f"{name}.npy", np.stack([raw.time_s, raw.heading_deg, raw.recorded_deg]))
    return cruise, locked


def described(ground: Ground) -> dict[str, Any]:
    """Compose the mooring's YAML file."""
    ends = (float(ground.stamp_s[0]), float(ground.stamp_s[-1]) + 2 * DEEP_SAMPLE_S)
    first, last = (datetime.fromtimestamp(x, UTC).strftime("%Y-%m-%dT%H:%M:%SZ") for x in ends)
    top, deep = (
        {"format": "pd0", "files": f"raw/{ground.name}/{role}.000", "depth": depth, "orientation": orientation}
        for role, depth, orientation in (("top", 100, "up"), ("deep", 104, "down"))
    )
    return {
        "name": ground.name, "latitude": ground.latitude_deg, "longitude": ground.longitude_deg,
        "water_depth": ground.water_depth_m, "start": first, "end": last, "declination": "auto",
        "compromised": "top", "reference": "deep", "instruments": {"top": top, "deep": deep},
    }  # fmt: skip


EFFECTS = ("heading_slip", "reference_deviation", "reference_slip", "reference_beams", "reference_bias")


def effect_of(ground: Ground, name: str) -> Callable[[float], Effect]:
    """Draw an effect, as a function of its size: a slip of the affected instrument, or a fault of the reference."""
    rng = ground.random(f"effect {name}")
    if name in ("heading_slip", "reference_slip"):
        date = float(ground.stamp_s[int(rng.uniform(0.2, 0.8) * ground.stamp_s.size)])
        shift = (ground.stamp_s >= date).astype(float)
        if name == "reference_slip":
            return lambda size: Effect(trusted=lambda heading: size * shift)
        return lambda size: Effect(reading=lambda gamma: size * shift[:, None] * np.ones(gamma.shape))
    if name == "reference_beams":  # an excess gain of its forward beam pair
        return lambda size: Effect(gain=0.035 * size)
    phase = rng.uniform(0.0, 2.0 * np.pi)
    if name == "reference_bias":  # of its velocities in the body frame, as by ringing
        return lambda size: Effect(bias_m_s=complex(0.003 * size * np.exp(1j * phase)))
    return lambda size: Effect(trusted=lambda heading: size * np.sin(np.deg2rad(heading) + phase))


def plant(ground: Ground, name: str, wanted_deg: float) -> tuple[Effect, float]:
    """Draw an effect of a requested visible size, rms degrees; return it with the size that it has."""
    make, size = effect_of(ground, name), 1.0
    seen = visible_rms_deg(ground, make(size))
    for _ in range(ROUNDS):
        size *= float(np.clip(wanted_deg / max(seen, 1e-3), 0.05, 20.0))
        seen = visible_rms_deg(ground, make(size))
    return make(size), seen


def visible_rms_deg(ground: Ground, effect: Effect) -> float:
    """Compute the visible size of an effect: its residual after a fit of five coefficients, rms degrees."""
    bare, with_it = (residual_deg(ground, planted) for planted in ((), (effect,)))
    if effect.bias_m_s:  # robust, as slow flow may have any direction
        return float(1.4826 * np.median(np.abs(with_it - bare)))
    return float(np.std(with_it - bare))


def residual_deg(ground: Ground, effects: Sequence[Effect]) -> Floats:
    """Compute the heading error left by five coefficients fitted to the truth, every few hours, degrees."""
    made = sealed.read(ground, effects, ground.stamp_s)
    heading = sealed.trusted_heading(ground)
    turned = sum((one.trusted(heading) for one in effects if one.trusted is not None), np.zeros(heading.size))
    depth = np.interp(ground.stamp_s, ground.motion.time_s, ground.motion.sphere_depth_m)
    flow = sea.velocity(ground.currents, ground.stamp_s, depth)
    body = clockwise(flow, -(heading + ground.field.at(ground.stamp_s)[0]))
    flawed = adcp.by_beams(body, sum(one.gain for one in effects), sum(one.bias_m_s for one in effects))
    turned = turned + np.rad2deg(np.angle(body * np.conj(flawed)))  # clockwise, of the reference's directions
    return left_deg((made.recorded_deg - turned)[::EVERY], made.heading_deg[::EVERY])
