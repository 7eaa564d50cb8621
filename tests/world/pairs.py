"""Simulation of hourly pairs of two instruments with a deviating compass and known effects, without raw files.

A year takes a tenth of a second, which allows hundreds of moorings in benchmarks and tests of the search. Compass,
tilt, water and effects are implemented independently of the analysis.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter

from compasslib.demo.water import Complexes, Floats
from compasslib.records import Pairs, ReferenceCompass

HOUR_S, YEAR_H = 3600.0, 8766.0
BEGIN_S = 1188864000.0  # 4 September 2007
RAD = np.pi / 180.0
# Largest plausible multiples of the unit sizes: of 1000 nT along the vertical, of 1° of a harmonic, of a veer.
STRONGEST = {"heeling": 15.0, "sextantal": 9.0, "octantal": 9.0, "current_veer": 30.0}
FAMILIES = {
    "heeling": "tilt", "hard_iron_drift": "time", "compass_drift": "time", "hard_iron_step": "time",
    "heading_slip": "time", "supply_voltage": "time", "temperature": "temperature", "sextantal": "heading",
    "octantal": "heading", "compass_lag": "turning", "current_veer": "water", "clock_offset": "clock",
    "clock_drift": "clock",
}  # fmt: skip
SINGLES = tuple(FAMILIES)
TWO = tuple(x for x in SINGLES if FAMILIES[x] not in ("clock", "turning"))
UNKNOWN = ("sector", "teeth", "hour", "episode", "wander", "depth_threshold", "warm_sextantal", "tilt_squared")


@dataclass(frozen=True)
class SlowWater:
    """Slow differences between the currents at the two depths, over days to seasons."""

    veer_deg: float  # rms
    veer_days: float  # memory
    shear_m_s: float  # rms of each component
    shear_days: float

    def beside(self, rng: np.random.Generator, flow: Complexes) -> Complexes:
        """Simulate the difference that is added to the lower current, hourly, east + i north, (n,) m/s."""
        n = len(flow)
        veer = red(rng, n, 24.0 * self.veer_days, self.veer_deg)
        east, north = (red(rng, n, 24.0 * self.shear_days, self.shear_m_s) for _ in range(2))
        return np.asarray(turned(flow, veer) - flow + east + 1j * north)


@dataclass(frozen=True)
class World:
    """One mooring before its compass is simulated; n hourly samples."""

    rng: np.random.Generator
    time_s: Floats
    heading: Floats  # correct magnetic heading
    flow: Complexes  # true current at the upper instrument, east + i north
    difference: Complexes  # lower minus upper, without veer
    tilt: Floats  # (2, n) pitch, roll
    sensed: Floats  # (2, n) as measured by the compass's tilt sensor
    depth: Floats
    separation: Floats
    temperature: Floats
    voltage: Floats
    earth: tuple[float, float]  # horizontal, vertical nT
    soft: Floats
    hard: Floats
    water: Complexes | None = None  # current without instrument noise, if known
    noise: tuple[float, float, float] = (np.nan,) * 3  # per component: red m/s, its memory in hours, white m/s
    slow_water: SlowWater | None = None

    @property
    def hours(self) -> Floats:
        """Hours since the first sample, (n,)."""
        return (self.time_s - self.time_s[0]) / HOUR_S

    def later(self, z: Complexes, hours: Floats) -> Complexes:
        """Interpolate a series to some hours after each sample, (n,); samples may be missing."""
        when = self.hours + hours
        return np.interp(when, self.hours, z.real) + 1j * np.interp(when, self.hours, z.imag)

    @property
    def between(self) -> Complexes:
        """Current midway between the instruments, on which the veer depends; without their noise if that is known."""
        return self.flow + self.difference / 2 if self.water is None else self.water


@dataclass(frozen=True)
class Drawn:
    """Input of the diagnosis, and the truth."""

    pairs: Pairs
    covariates: dict[str, Floats]
    heading: Floats
    horizontal: float
    vertical: float
    truth: dict[str, dict[str, float]] = field(default_factory=dict)  # effect -> parameters
    visible_deg: dict[str, float] = field(default_factory=dict)
    world: World | None = None
    parts: list[tuple[Effect, float]] = field(default_factory=list)  # planted effects and their sizes
    reference_deg: Floats | float = 0.0  # error of the reference's directions in the pairs, (n,)


def red(rng: np.random.Generator, n: int, memory: float, deviation: float) -> Floats:
    """Draw stationary first-order autoregressive noise, (n,), given its memory in samples and standard deviation."""
    keep = np.exp(-1.0 / memory)
    kicks = rng.normal(0.0, deviation * np.sqrt(1 - keep**2), n)
    kicks[0] = rng.normal(0.0, deviation)
    return np.asarray(lfilter([1.0], [1.0, -keep], kicks))


def red_from_rest(rng: np.random.Generator, n: int, memory: float, deviation: float) -> Floats:
    """Draw first-order autoregressive noise like ``red``, but with the state 0 before the first sample."""
    keep = np.exp(-1.0 / memory)
    noise = rng.normal(size=n) * deviation * np.sqrt(1.0 - keep**2)
    return np.asarray(lfilter([1.0], [1.0, -keep], noise))


def towards(z: Complexes) -> Floats:
    """Compute the direction of east + i north, degrees clockwise from north."""
    return np.asarray(90.0 - np.angle(z) / RAD)


def turned(z: Complexes, by_deg: Floats | float) -> Complexes:
    """Rotate east + i north clockwise."""
    return np.asarray(z * np.exp(-1j * RAD * by_deg))


def wrap(x: Floats) -> Floats:
    """Wrap angles to [-180, 180), degrees."""
    return (np.asarray(x) + 180.0) % 360.0 - 180.0


def some_slow_water(rng: np.random.Generator) -> SlowWater:
    """Draw size and memory of slow water at random."""

    def between(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    return SlowWater(between(0.3, 8.0), between(4.0, 150.0), between(0.001, 0.03), between(2.0, 150.0))


def make(
    seed: int, *, wide: bool, noise_deg: float = 12.0, n: int = 8000, slow_water: SlowWater | None = None
) -> World:
    """Simulate currents, attitude and covariates of one mooring."""
    rng = np.random.default_rng(seed)
    hours = np.arange(n)
    time_s = 1.1889e9 + HOUR_S * hours + HOUR_S * 24 * rng.integers(300)
    axis = np.exp(1j * rng.uniform(0, 2 * np.pi))
    mean, tide, slow = (0.10, 0.12, 0.10) if wide else (0.30, 0.06, 0.06)
    flow: Complexes = (mean * (1 + 0.2 * np.cos(2 * np.pi * (hours / YEAR_H + rng.uniform())))).astype(complex)
    flow += red(rng, n, 50, 1.3 * slow) + 1j * red(rng, n, 50, 0.7 * slow)
    for period, share in ((12.4206, 0.7), (12.0, 0.25), (23.9345, 0.3)):
        phase = 2 * np.pi * hours / period + rng.uniform(0, 2 * np.pi)
        flow += tide * share * (np.cos(phase) + 1j * rng.uniform(-0.7, 0.7) * np.sin(phase))
    for hour in np.cumsum(rng.exponential(150, 80) + 48):  # passing cyclones
        phase = (hours - hour) / rng.uniform(9, 16)
        flow += rng.lognormal(-1.3, 0.4) * np.exp(-(phase**2) / 2) * (1 + 1j * rng.normal(0.2, 0.2) * phase)
    flow *= axis
    speed = np.abs(flow)

    # The instrument aligns with the flow, with a memory of three hours at 25 cm/s.
    rest, heading = np.unwrap(np.angle(flow)) / -RAD + rng.uniform(0, 360), np.empty(n)
    push = rng.normal(0, rng.uniform(24, 34) * np.sqrt(2 / 3.0), n)
    state = rest[0]
    for i in range(n):
        pull = min(speed[i] / 0.25, 1.8) / 3.0
        state += push[i] - pull * np.sin((state - rest[i]) * RAD) / RAD
        heading[i] = state

    kick = np.median(speed) * noise_deg * RAD
    share = rng.uniform(0.15, 0.5)
    memory = np.exp(rng.uniform(np.log(6), np.log(24)))
    reds = red(rng, n, memory, kick * np.sqrt(share)) + 1j * red(rng, n, memory, kick * np.sqrt(share))
    lower_share = rng.uniform(0.3, 0.7)  # share of the white noise in the reference
    white = kick * np.sqrt((1 - share) / 2) * (rng.standard_t(6, (2, 2, n)) / np.sqrt(1.5)) * np.sqrt(2)
    up = np.sqrt(1 - lower_share) * (white[0, 0] + 1j * white[0, 1])
    down = np.sqrt(lower_share) * (white[1, 0] + 1j * white[1, 1])
    upper = flow - 0.5 * reds - up
    between = reds + up + down
    if slow_water is not None:
        between = between + slow_water.beside(np.random.default_rng(seed + 1_000_000_007), flow)

    lean = 7.0 * (speed / 0.4) ** 2 / (1 + (speed / 0.8) ** 2)
    relative = towards(flow) - heading
    tilt = np.array([
        rng.uniform(-4, 4) - lean * np.cos(relative * RAD) + red(rng, n, 2, 1.0),
        rng.uniform(-4, 4) + lean * np.sin(relative * RAD) + red(rng, n, 2, 1.0),
    ])  # fmt: skip
    blow = lfilter([0.3], [1, -0.7], speed**2)
    depth = 100 + 300 * blow / 0.5 + 0.7 * np.cos(2 * np.pi * hours / 12.42) + rng.normal(0, 0.5, n)
    season = np.cos(2 * np.pi * (hours / YEAR_H + rng.uniform()))
    temperature = 4 + 1.5 * season + red(rng, n, 240, 0.6) - 0.4 * (depth - 100) / 100 + rng.normal(0, 0.02, n)
    drain = rng.uniform(4, 8) * hours / YEAR_H
    voltage = 43 - drain - 2.5 / (1 + np.exp((n * 1.02 - hours) / 250)) + 0.1 * (temperature - 4)
    earth = float(rng.uniform(11500, 22000)), float(rng.uniform(40000, 52500))
    return World(
        rng=rng, time_s=time_s, heading=heading, flow=upper, difference=between, tilt=tilt,
        sensed=tilt + rng.normal(0, rng.choice([0.02, 0.05, 0.1]), (2, n)), depth=depth,
        separation=18 + 0.008 * (depth - 100) + red(rng, n, 30, 1.0), temperature=temperature,
        voltage=np.round(voltage + rng.normal(0, 0.05, n), 1), earth=earth,
        water=flow, noise=(kick * np.sqrt(share), memory, kick * np.sqrt(1 - share)),
        slow_water=slow_water, **iron(rng),
    )  # fmt: skip


def iron(rng: np.random.Generator) -> dict[str, Floats]:
    """Draw soft iron, and hard iron relative to the earth's horizontal field, with random size and direction."""
    soft = np.eye(3)
    soft[:2, :2] += rng.normal(0, [[0.02, 0.008], [0.008, 0.02]])
    strength = rng.choice([0.0, 0.1, 0.2, 0.35, 0.6])
    angle = rng.uniform(0, 2 * np.pi)
    return {"soft": soft, "hard": strength * np.array([np.cos(angle), np.sin(angle), 0.0])}


def in_body(world: World, extra: Floats | None = None) -> Floats:
    """Compute the field at the compass, forward, starboard and down in the tilted body, and an extra one, (3, n) nT."""
    h, z = world.earth
    cb, sb = np.cos(world.heading * RAD), np.sin(world.heading * RAD)
    x, y, d = h * cb, -h * sb, np.full(len(cb), z)  # level: forward, starboard, down
    (pc, ps), (rc, rs) = (((np.cos(a * RAD)), np.sin(a * RAD)) for a in world.tilt)
    # into the tilted body: pitch first, then roll
    x, d = pc * x - ps * d, ps * x + pc * d
    y, d = rc * y + rs * d, -rs * y + rc * d
    return np.asarray(world.soft @ np.array([x, y, d]) + h * world.hard[:, None] + (0 if extra is None else extra))


def compass(
    world: World,
    *,
    extra: Floats | None = None,
    offset: Callable[[Floats], Floats] | None = None,
    uncompensated: bool = False,
) -> Floats:
    """Compute the recorded heading from iron, tilt, levelling and readout, degrees, not wrapped, (n,).

    Args:
        extra: added field in the body frame, (3, n) nT.
        offset: function of the reading that is added to it, degrees.
    """
    m = in_body(world, extra)
    (pc, ps), (rc, rs) = ((np.cos(a * RAD), np.sin(a * RAD)) for a in world.sensed)
    y, d = rc * m[1] - rs * m[2], rs * m[1] + rc * m[2]
    x = pc * m[0] + ps * d
    if uncompensated:
        x, y = m[0], m[1]
    gamma = np.arctan2(-y, x) / RAD
    return gamma + (0 if offset is None else offset(gamma))


def exact_compass(coefficients: Floats, heading: Floats) -> Floats:
    """Compute the recorded heading of a level compass with coefficients A..E, degrees (physics page, section 1)."""
    a, b, c, d, e = coefficients
    w = np.exp(1j * RAD * heading)
    return np.asarray(np.angle((1 - 1j * a) * w + b - 1j * c + (d - 1j * e) / w) / RAD)


def under_a_compass(
    coefficients: tuple[float, ...], *, n: int = 3000, seed: int = 1, spread: float | None = None
) -> tuple[Pairs, Floats]:
    """Simulate hourly pairs recorded with a level compass, and the correct headings, degrees.

    Args:
        spread: standard deviation of the headings about one direction, degrees; None: headings follow the flow.
    """
    rng = np.random.default_rng(seed)
    flow = 0.15 + red_from_rest(rng, n, 40, 0.12) + 1j * (-0.05 + red_from_rest(rng, n, 40, 0.12))
    heading = 210.0 + red_from_rest(rng, n, 20, spread) if spread else towards(flow) + red_from_rest(rng, n, 6, 20.0)
    recorded: Floats = exact_compass(np.array(coefficients), heading) + rng.normal(0.0, 0.7, n)
    upper = turned(flow + rng.normal(0, 0.02, n) + 1j * rng.normal(0, 0.02, n), recorded - heading)
    east, north = (x + red_from_rest(rng, n, 10, 0.03) + rng.normal(0.0, 0.02, n) for x in (flow.real, flow.imag))
    time, zero = BEGIN_S + HOUR_S * np.arange(n, dtype=float), np.zeros(n)
    depths = (zero + 90.0, zero + 105.0)
    pairs = Pairs(time, recorded % 360.0, zero, zero, upper.real, upper.imag, east, north, *depths, zero, zero)
    return pairs, heading % 360.0


def five_term_residual(gamma: Floats, heading: Floats) -> tuple[Floats, Floats]:
    """Compute the heading error left by five coefficients fitted to the truth, degrees, (n,), and the coefficients."""

    def miss(c: Floats) -> Floats:
        return wrap(gamma - exact_compass(c, heading))

    found = least_squares(miss, np.zeros(5), x_scale=0.1, max_nfev=40)
    a, b, cc, d, e = found.x
    w = np.exp(1j * RAD * heading)
    q = (1 - 1j * a) * w + b - 1j * cc + (d - 1j * e) / w
    slope = np.real(((1 - 1j * a) * w - (d - 1j * e) / w) / q)
    return found.fun / np.maximum(slope, 0.2), found.x


@dataclass(frozen=True)
class Effect:
    """Change by an effect of unit size: a body field, a function of the reading, a veer, or a clock error."""

    parameters: dict[str, float]  # at unit size
    extra: Floats | None = None  # (3, n) nT
    offset: Callable[[Floats], Floats] | None = None  # function of the reading, degrees
    veer: Floats | None = None  # (n,) degrees, lower minus upper
    clock: Floats | None = None  # (n,) hours by which the affected clock is ahead


def effect(world: World, name: str) -> Effect:
    """Draw an effect with random direction and date; its unit size is roughly one degree."""
    rng, n, years = world.rng, len(world.hours), world.hours / YEAR_H
    angle, zero = rng.uniform(0, 2 * np.pi), np.zeros(len(world.hours))
    east, north = 200 * np.cos(angle), 200 * np.sin(angle)

    def flat(series: Floats, unit: str) -> Effect:
        names = (f"b_x_nT{unit}", f"b_y_nT{unit}")
        return Effect(dict(zip(names, (east, north), strict=True)), np.array([east * series, north * series, zero]))

    def shift(series: Floats, key: str) -> Effect:
        return Effect({key: 1.0}, offset=lambda gamma: series)

    step = (np.arange(n) >= n * rng.uniform(0.2, 0.8)).astype(float)
    date = {"date_s": float(world.time_s[int(np.argmax(step))])}
    warm, volt = world.temperature - world.temperature.mean(), world.voltage - world.voltage.mean()
    coin = rng.uniform() < 0.5
    if name == "heeling":
        return Effect({"b_z_nT": 1000.0}, np.array([zero, zero, zero + 1000.0]))
    if name == "hard_iron_drift":
        return flat(years, "_year")
    if name == "hard_iron_step":
        made = flat(step, "")
        return Effect(made.parameters | date, made.extra)
    if name == "creep":  # magnetic viscosity
        return flat(np.log1p(world.hours / 480.0), "")
    if name == "moving_iron":
        lean, unit = ((world.tilt[0], "pitch"), (world.tilt[1], "roll"))[int(coin)]
        return flat((lean - lean.mean()) / 5.0, f"_{unit}")
    if name == "temperature":
        return flat(warm, "_K") if coin else shift(warm, "deg_K")
    if name == "supply_voltage":
        return flat(volt, "_V") if coin else shift(volt, "deg_V")
    if name in ("sextantal", "octantal"):
        k, phase = (3 if name == "sextantal" else 4), rng.uniform(0, 2 * np.pi)
        names = {"sine_deg": np.cos(phase), "cosine_deg": np.sin(phase)}
        return Effect(names, offset=lambda gamma: np.sin(k * gamma * RAD + phase))
    if name == "heading_slip":
        return Effect({"offset_deg": 1.0} | date, offset=lambda gamma: step)
    if name == "compass_drift":
        return shift(years, "deg_year")
    if name == "compass_lag":
        late = lambda gamma: -300.0 * np.gradient(np.unwrap(gamma * RAD) / RAD, 3600.0)  # noqa: E731
        return Effect({"lag_s": 300.0}, offset=late)
    if name == "current_veer":
        speed, direction = np.abs(world.flow), towards(world.between)
        kind = rng.integers(3)
        if kind == 0:
            return Effect({"deg_s_m": 5.0}, veer=5.0 * (speed - speed.mean()))
        if kind == 1:
            return Effect({"deg_m": 1.0}, veer=world.separation - world.separation.mean())
        return Effect({"sine_deg": np.cos(angle), "cosine_deg": np.sin(angle)}, veer=np.sin(direction * RAD + angle))
    if name == "clock_offset":
        hours = rng.choice([-1, 1]) * rng.uniform(0.45, 1.5)  # smaller offsets are not to be identified
        return Effect({"hours": hours}, clock=zero + hours)
    if name == "clock_drift":
        rate = rng.choice([-1, 1]) * rng.uniform(0.6, 1.5)
        return Effect({"hours_year": rate}, clock=rate * years)
    return Effect({}, **_unknown(world, name, angle))


def _unknown(world: World, name: str, angle: float) -> dict[str, Any]:
    rng, hours = world.rng, world.hours
    if name == "sector":
        middle = np.quantile(world.heading, rng.uniform(0.3, 0.7))
        return {"offset": lambda gamma: 3 * np.exp(-0.5 * (wrap(gamma - middle) / 9.0) ** 2)}
    if name == "teeth":
        teeth = rng.integers(8, 19)
        return {"offset": lambda gamma: np.sin(teeth * gamma * RAD + angle)}
    if name == "hour":
        return {"offset": lambda gamma: np.cos(2 * np.pi * (world.time_s / 86400) + angle)}
    if name == "episode":
        begin = rng.uniform(0.1, 0.7) * hours[-1]
        inside = (hours >= begin) & (hours < begin + 24 * rng.uniform(20, 60))
        return {"offset": lambda gamma: 2.0 * inside}
    if name == "wander":
        period = 24 * rng.uniform(40, 90)
        return {"offset": lambda gamma: np.cos(2 * np.pi * hours / period + angle)}
    if name == "depth_threshold":
        deep = world.depth > np.quantile(world.depth, rng.uniform(0.8, 0.93))
        return {"offset": lambda gamma: 3.0 * deep}
    if name == "warm_sextantal":
        warm = (world.temperature - world.temperature.mean()) / world.temperature.std()
        return {"offset": lambda gamma: warm * np.sin(3 * gamma * RAD + angle)}
    pitch = world.tilt[0] - np.quantile(world.tilt[0], rng.uniform(0.3, 0.7))
    return {"offset": lambda gamma: pitch**2 / np.std(pitch**2)}


def combined(world: World, parts: list[tuple[Effect, float]]) -> tuple[Floats, Floats | float, Floats]:
    """Compute recorded heading and veer, degrees, and clock error, hours, of effects times their sizes."""
    extra: Floats | None = None
    veer: Floats | float = 0.0
    clock, offsets = np.zeros(len(world.hours)), []
    for part, size in parts:
        extra = extra if part.extra is None else size * part.extra + (0 if extra is None else extra)
        veer = veer if part.veer is None else veer + size * part.veer
        clock = clock if part.clock is None else clock + size * part.clock
        offsets += [] if part.offset is None else [(part.offset, size)]
    gamma = compass(world, extra=extra, offset=lambda g: sum((size * f(g) for f, size in offsets), np.zeros(len(g))))
    return gamma, veer, clock


def visible(world: World, part: Effect, size: float) -> float:
    """Compute the rms of an effect after refitting five coefficients, degrees; for a clock robust, without refit."""
    bare, _ = five_term_residual(compass(world), world.heading)
    if part.veer is not None:
        gamma = compass(world)
        left, _ = five_term_residual(gamma - size * part.veer, world.heading)
        return float(np.std(left - bare))
    if part.clock is not None:
        lower = world.flow + world.difference
        late = world.later(lower, -size * part.clock)
        move = wrap(towards(late) - towards(lower))
        return 1.4826 * float(np.median(np.abs(move)))
    gamma, *_ = combined(world, [(part, size)])
    left, _ = five_term_residual(gamma, world.heading)
    return float(np.std(left - bare))


def planted(world: World, wanted: dict[str, float], made: Mapping[str, Effect] | None = None) -> Drawn:
    """Simulate the recording with effects of requested visible size, rms degrees.

    Args:
        made: effects to use instead of those drawn by ``effect``, by their names in ``wanted``.
    """
    parts = {}
    for name, target in wanted.items():
        part = made[name] if made and name in made else effect(world, name)
        size = 1.0 if part.clock is not None else target / max(visible(world, part, 1.0), 0.02)
        for _ in range(2 * (part.clock is None)):
            size *= np.clip(target / max(visible(world, part, size), 1e-3), 0.3, 3.0)
        size = np.clip(size, -STRONGEST.get(name, np.inf), STRONGEST.get(name, np.inf))
        parts[name] = part, size
    return recorded(world, parts)


def recorded(world: World, named: Mapping[str, tuple[Effect, float]]) -> Drawn:
    """Simulate the recording with effects by their names, times their sizes."""
    parts, truth, seen = list(named.values()), {}, {}
    for name, (part, size) in named.items():
        truth[name] = {k: v * size if k != "date_s" else v for k, v in part.parameters.items()}
        seen[name] = visible(world, part, size)
    gamma, veer, clock = combined(world, parts)
    gamma = gamma + world.rng.normal(0, 0.5, gamma.size)
    lower = turned(world.flow + world.difference, veer)
    # The affected clock is ahead: a sample stamped t was taken at t - ahead, but is paired with the reference at t. The
    # lower value of a pair is therefore later than the upper one by ``clock`` hours.
    lower = world.later(lower, clock)
    upper = turned(world.flow, wrap(gamma - world.heading))
    zero = np.zeros(gamma.size)
    pitch, roll = world.sensed
    pairs = Pairs(
        world.time_s, gamma % 360.0, pitch, roll, upper.real, upper.imag, lower.real, lower.imag, world.depth,
        world.depth + world.separation, zero, zero,
    )  # fmt: skip
    covariates = {"temperature": world.temperature, "supply_voltage": world.voltage}
    return Drawn(pairs, covariates, world.heading % 360.0, *world.earth, truth, seen, world, parts)


# A compass that was not calibrated in place: its constant, iron along either axis, and offset of its tilt sensor.
CONSTANT_DEG, IRON_NT, LEVEL_DEG = 2.0, 525.0, 0.4
ALIGNED_S = 13 * 3600.0
WAKE_DEG, VANE_DEG = 40.0, 10.0  # spread of the reference's heading about the flow, of an instrument and of a vane


def averaged(time_s: Floats, flow: Complexes, span_s: float) -> Complexes:
    """Compute the running mean of a flow over a span of time, (n,)."""
    ends = np.searchsorted(time_s, [time_s - span_s / 2.0, time_s + span_s / 2.0], side="right")
    sums = np.append(0.0, np.cumsum(flow))
    return (sums[ends[1]] - sums[ends[0]]) / (ends[1] - ends[0])


def reference_sizes(earth: tuple[float, float]) -> Floats:
    """Compute sigma of constant, sine and cosine of an ordinary compass, degrees; earth: horizontal and vertical nT."""
    iron_deg = float(np.hypot(IRON_NT / earth[0] / RAD, LEVEL_DEG * earth[1] / earth[0]))
    return np.array([CONSTANT_DEG, iron_deg, iron_deg])


def refer(drawn: Drawn, errors: Floats, rng: np.random.Generator, *, vane: bool, logged: bool) -> Drawn:
    """Turn the reference's directions by the errors of its compass, and state their ordinary sizes.

    Args:
        errors: constant, sine and cosine by its heading, degrees, (3,).
        vane: whether it is a vane along the flow, or an instrument that turns more freely.
        logged: whether it logs its heading.
    """
    pairs, water = drawn.pairs, None if drawn.world is None else drawn.world.water
    flow = pairs.lower_east + 1j * pairs.lower_north
    spread, offset = (VANE_DEG, 0.0) if vane else (WAKE_DEG, rng.uniform(0.0, 360.0))
    # An instrument aligns with the water, not with the noise of its own measurement of it; of real water only the
    # measurement is known, and its mean over ALIGNED_S shares little of that noise. A vane turns within seconds.
    real = flow if vane else averaged(pairs.time_s, flow, ALIGNED_S)
    aligned = real if water is None else water
    heading = towards(aligned) + offset + red(rng, len(flow), 12, spread)
    wrong = errors @ np.array([np.ones(len(flow)), np.sin(heading * RAD), np.cos(heading * RAD)])
    flow, recorded = turned(flow, wrong), (heading + wrong) % 360.0 if logged else None
    constant_deg, iron_deg, _ = reference_sizes((drawn.horizontal, drawn.vertical))
    usual = ReferenceCompass("reference", constant_deg, iron_deg)
    pairs = replace(pairs, lower_east=flow.real, lower_north=flow.imag, lower_heading_deg=recorded, compass=usual)
    return replace(drawn, pairs=pairs, reference_deg=wrong)
