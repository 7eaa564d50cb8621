"""What a compass records in an ensemble: pings, tilt sensors that lag and count in steps, levelling, an average."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from compasslib.demo import magnetometer
from compasslib.demo.compass import tilting
from compasslib.demo.effects import Effect, total
from compasslib.demo.sealed import Ground
from compasslib.demo.series import Floats, circle

PINGS, PING_S = 4, 90.0
TILT_STEP_DEG = 180.0 / 4096.0  # twelve bits over half a circle
TILT_LAG_S, TILT_PASSES = 20.0, 0.75  # of a fast wobble only this share reaches the sensor
WOBBLE_DEG = 0.35
NOISE_DEG = 0.4  # of an ensemble's heading


@dataclass(frozen=True, eq=False)
class Reading:
    """How an instrument stood in its ensembles and what it gave, (n,) each."""

    heading_deg: Floats  # correct, magnetic
    recorded_deg: Floats
    tilt_deg: tuple[Floats, Floats]  # true pitch, roll
    sensed_deg: tuple[Floats, Floats]


def read(ground: Ground, effects: Sequence[Effect], time_s: Floats, rng: np.random.Generator | None = None) -> Reading:
    """Return the readings of the affected compass.

    Args:
        effects: what is planted in it, at the same ensembles.
        time_s: true times of the ensembles, (n,).
        rng: source of randomness; without it one ping without noise and steps.
    """
    pings = 1 if rng is None else PINGS
    times = time_s[:, None] + PING_S * (np.arange(pings) - 0.5 * (pings - 1))
    wobble = np.zeros((2, *times.shape)) if rng is None else rng.normal(0.0, WOBBLE_DEG, (2, *times.shape))
    heading, *steady = _attitude(ground, times)
    true = (steady[0] + wobble[0], steady[1] + wobble[1])
    sensed = _sensed(ground, times, wobble, stepped=rng is not None)
    gamma = _compass(ground, effects, times, tilts=(wobble, sensed), stepped=rng is not None)
    noise = 0.0 if rng is None else rng.normal(0.0, NOISE_DEG, time_s.size)
    return Reading(
        _middle(heading),
        circle(_middle(gamma) + noise),
        (true[0].mean(axis=1), true[1].mean(axis=1)),
        (sensed[0].mean(axis=1), sensed[1].mean(axis=1)),
    )


def _attitude(ground: Ground, times: Floats) -> tuple[Floats, Floats, Floats]:
    motion = ground.motion
    heading, pitch, roll = (
        np.interp(times, motion.time_s, x) for x in (motion.heading_deg, motion.pitch_deg, motion.roll_deg)
    )
    return heading, pitch, roll


def _sensed(ground: Ground, times: Floats, wobble: Floats, *, stepped: bool) -> tuple[Floats, Floats]:
    _, *late = _attitude(ground, times - TILT_LAG_S * stepped)
    sensed = [slow + TILT_PASSES * fast for slow, fast in zip(late, wobble, strict=True)]
    if stepped:
        sensed = [TILT_STEP_DEG * np.rint(x / TILT_STEP_DEG) for x in sensed]
    return sensed[0], sensed[1]


def _compass(
    ground: Ground,
    effects: Sequence[Effect],
    times: Floats,
    *,
    tilts: tuple[Floats, tuple[Floats, Floats]],
    stepped: bool,
) -> Floats:
    """Return the reading at every ping, (n, k), not wrapped."""
    wobble, sensed = tilts
    heading, pitch, roll = _attitude(ground, times)
    _, horizontal, vertical = ground.field.at(times)
    turn = np.deg2rad(heading)
    level = np.stack([horizontal * np.cos(turn), -horizontal * np.sin(turn), vertical], axis=-1)
    body = np.einsum("nkji,nkj->nki", tilting(pitch + wobble[0], roll + wobble[1]), level)
    beside = total(effects, "body_nt", np.zeros((len(times), 3)))[:, None, :]
    given = magnetometer.felt(ground.meter, body, beside, stepped=stepped)
    levelled = np.einsum("nkij,nkj->nki", tilting(*sensed), given)
    gamma = np.rad2deg(np.arctan2(-levelled[..., 1], levelled[..., 0]))
    added = [one.reading(gamma) for one in effects if one.reading is not None]
    return np.asarray(gamma + sum(added, np.zeros(gamma.shape)))


def _middle(angle_deg: Floats) -> Floats:
    return circle(np.rad2deg(np.angle(np.exp(1j * np.deg2rad(angle_deg)).mean(axis=1))))
