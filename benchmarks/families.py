"""Effects outside the catalogue, with the correct descriptions of each (acts_on, driver, form).

They were written after the grammar by the same author: they test its function, not its response to unforeseen effects.
Functional forms are smoother than in the grammar where physics is: soft thresholds, exponentials, backlash.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tests.world.pairs import RAD, Effect, World, towards, wrap

Right = frozenset[tuple[str, str, str]]
Family = Callable[[World], tuple[Effect, Right]]


def _right(acts: str, drivers: str, forms: str) -> Right:
    return frozenset((a, d, f) for a in acts.split() for d in drivers.split() for f in forms.split())


def _unit(x):
    return (x - np.mean(x)) / np.std(x)


def _flat(world: World, series) -> Effect:
    angle = world.rng.uniform(0, 2 * np.pi)
    return Effect({}, 800.0 * np.array([np.cos(angle) * series, np.sin(angle) * series, 0.0 * series]))


def _reading(series) -> Effect:
    return Effect({}, offset=lambda gamma: series)


def sector(world):
    middle = np.quantile(world.heading, world.rng.uniform(0.3, 0.7))
    made = Effect({}, offset=lambda gamma: 3 * np.exp(-0.5 * (wrap(gamma - middle) / 14.0) ** 2))
    return made, _right("reading", "heading", "bump")


def warm_lobes(world):
    phase, warm = world.rng.uniform(0, 2 * np.pi), _unit(world.temperature)
    k = int(world.rng.choice([3, 4]))
    made = Effect({}, offset=lambda gamma: warm * np.sin(k * gamma * RAD + phase))
    return made, _right(f"lobe{k}", "temperature", "linear")


def hour(world):
    phase = world.rng.uniform(0, 2 * np.pi)
    return _reading(np.cos(2 * np.pi * world.time_s / 86400 + phase)), _right("reading", "hour", "periodic")


def tide(world):
    return _reading(np.cos(2 * np.pi * world.hours / 12.4206)), _right("reading flow_direction", "tide", "periodic")


def deep(world):
    edge = np.quantile(world.depth, world.rng.uniform(0.75, 0.93))
    made = 1.0 / (1.0 + np.exp(-(world.depth - edge) / 2.0))
    return _reading(made), _right("reading flow_direction", "depth", "threshold saturating")


def pitch_squared(world):
    return _reading(_unit(world.tilt[0]) ** 2), _right("reading", "pitch tilt", "quadratic")


def fading(world):
    life = world.rng.uniform(0.05, 0.2) * world.hours[-1]
    return _flat(world, np.exp(-world.hours / life)), _right("field_forward field_starboard", "time", "decay quadratic")


def growing(world):
    begin, end = np.sort(world.rng.uniform(0.1, 0.9, 2)) * world.hours[-1]
    series = np.clip((world.hours - begin) / max(end - begin, 200.0), 0, 1)
    return _flat(world, series), _right("field_forward field_starboard", "time", "ramp step linear quadratic growth")


def month(world):
    begin = world.rng.uniform(0.15, 0.6) * world.hours[-1]
    inside = (world.hours >= begin) & (world.hours < begin + world.rng.uniform(0.1, 0.3) * world.hours[-1])
    return _flat(world, inside.astype(float)), _right("field_forward field_starboard", "time", "box")


def late_warmth(world):
    from scipy.signal import lfilter

    share = 1.0 / world.rng.uniform(60.0, 250.0)
    late = lfilter([share], [1.0, share - 1.0], world.temperature - world.temperature[0])
    return _flat(world, _unit(late)), _right("field_forward field_starboard", "temperature", "lagged memory linear")


def warm_limit(world):
    made = np.tanh(2.0 * _unit(world.temperature))
    return _flat(world, made), _right("field_forward field_starboard", "temperature", "saturating threshold")


def backlash(world):
    width, x = 2.0 * np.std(world.tilt[1]), world.tilt[1]
    made, at = np.empty(len(x)), x[0]
    for i, now in enumerate(x):
        at = min(max(at, now - width / 2), now + width / 2)
        made[i] = at
    return _reading(_unit(made)), _right("reading", "roll", "memory linear lagged")


def deep_once(world):
    first = int(np.argmax(world.depth > np.quantile(world.depth, 0.99)))
    made = (np.arange(len(world.hours)) >= first).astype(float)
    return _flat(world, made), _right("field_forward field_starboard", "depth speed time tilt", "latch step ramp")


def volt_squared(world):
    return _flat(world, _unit(world.voltage) ** 2), _right("field_forward field_starboard", "voltage time", "quadratic")


def warm_down(world):
    series = _unit(world.temperature)
    made = Effect({}, np.array([0.0 * series, 0.0 * series, 3000.0 * series]))
    return made, _right("field_down", "temperature", "linear")


def warm_drift(world):
    made = _unit(world.temperature) * _unit(world.hours)
    return _reading(made), _right("reading", "temperature*time", "linear")


def beams_by_depth(world):
    angle = (towards(world.between) - world.heading) * RAD
    made = -_unit(world.depth) * np.sin(2 * angle)
    return Effect({}, veer=made), _right("flow_gain", "depth", "linear")


def veer_limit(world):
    made = np.tanh(1.5 * _unit(np.abs(world.between)))
    return Effect({}, veer=made), _right("flow_direction reading", "speed", "saturating threshold quadratic")


FAMILIES: dict[str, Family] = {
    made.__name__: made
    for made in (
        sector, warm_lobes, hour, tide, deep, pitch_squared, fading, growing, month, late_warmth, warm_limit, backlash,
        deep_once, volt_squared, warm_down, warm_drift, beams_by_depth, veer_limit,
    )
}  # fmt: skip
