"""Effects that are in nobody's catalogue: what a search must find, and must not give a name."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from compasslib.simulation.effects import Circumstances, Effect
from compasslib.simulation.series import DAY_S, Floats


def sticky_sector(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return a card that hangs in one sector: readings are pulled towards its middle."""
    middle = float(np.quantile(here.heading_deg, rng.uniform(0.3, 0.7)))

    def pulled(gamma: Floats) -> Floats:
        away = np.rad2deg(np.angle(np.exp(1j * np.deg2rad(gamma - middle))))
        return np.asarray(3.0 * np.exp(-0.5 * ((away - 6.0) / 9.0) ** 2))

    return Effect("sticky_sector", reading=pulled)


def hung_sector(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return a card that hangs fast in one sector: readings from all of it are its middle."""
    middle, half = float(np.quantile(here.heading_deg, rng.uniform(0.3, 0.7))), float(rng.uniform(6.0, 13.0))

    def hung(gamma: Floats) -> Floats:
        away = np.rad2deg(np.angle(np.exp(1j * np.deg2rad(gamma - middle))))
        return np.where(np.abs(away) < half, -away, 0.0)

    return Effect("hung_sector", reading=hung, hung=True)


def teeth(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return an encoder with teeth: eight to eighteen waves round the circle."""
    count, phase = int(rng.integers(8, 19)), rng.uniform(0.0, 2.0 * np.pi)
    return Effect("teeth", {"teeth": count}, reading=lambda gamma: np.sin(np.deg2rad(count * gamma) + phase))


def hour_of_day(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return a reading that another instrument's programme disturbs at the same hours every day."""
    phase = rng.uniform(0.0, 2.0 * np.pi)
    return _series("hour_of_day", np.cos(2.0 * np.pi * here.time_s / DAY_S + phase))


def episode(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return some weeks in which the reading was off, and then was not."""
    span = here.time_s[-1] - here.time_s[0]
    begin = here.time_s[0] + rng.uniform(0.15, 0.7) * span
    inside = (here.time_s >= begin) & (here.time_s < begin + rng.uniform(20.0, 60.0) * DAY_S)
    return _series("episode", 2.0 * inside)


def wander(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return a reading that swings to and fro with a period of weeks."""
    period, phase = rng.uniform(40.0, 90.0) * DAY_S, rng.uniform(0.0, 2.0 * np.pi)
    return _series("wander", np.cos(2.0 * np.pi * here.time_s / period + phase))


def tilt_squared(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return a reading that follows the square of the pitch: a bent inclinometer."""
    middle = float(np.quantile(here.pitch_deg, rng.uniform(0.3, 0.7)))
    bent = (here.pitch_deg - middle) ** 2
    return _series("tilt_squared", bent / float(bent.std()))


def depth_threshold(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return a reading that is off below a certain depth: a housing that touches the compass's board."""
    return _series("depth_threshold", 3.0 * (here.depth_m > np.quantile(here.depth_m, rng.uniform(0.8, 0.93))))


def warm_lobes(rng: np.random.Generator, here: Circumstances) -> Effect:
    """Return three lobes that grow with the temperature and turn over."""
    warm, phase = here.temperature_c - here.temperature_c.mean(), rng.uniform(0.0, 2.0 * np.pi)
    grown = (warm / warm.std())[:, None]
    return Effect("warm_lobes", reading=lambda gamma: grown * np.sin(np.deg2rad(3.0 * gamma) + phase))


def _series(name: str, series: ArrayLike) -> Effect:
    return Effect(name, reading=lambda gamma: np.asarray(series, dtype=float)[:, None] * np.ones(gamma.shape))


Maker = Callable[[np.random.Generator, Circumstances], Effect]
STRANGE: dict[str, Maker] = {
    made.__name__: made
    for made in (
        sticky_sector,
        teeth,
        hour_of_day,
        episode,
        wander,
        tilt_squared,
        depth_threshold,
        warm_lobes,
        hung_sector,
    )
}
