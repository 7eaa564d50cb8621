"""What may be planted in the proof: sealed by its hash before the search was frozen, opened after.

Shapes are those of physics where the catalogue has straight lines: iron creeps with the logarithm of time, a zero
follows the warmth through a housing, a clamp settles, a magnet swings on its spring, currents go with one over volts.
``NAMED`` have names that would be right; of ``STRANGE`` nobody has listed the cause.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.signal import lfilter
from scipy.special import expit

from benchmarks.proof.world.scene import DAY_S, HOUR_S, Acts, Family, Floats, Scene, towards, unit, wrap

Maker = Callable[[float], Acts]
RAD = np.pi / 180.0
FIELD_NT = 250.0  # of iron in unit size


def _direction(rng: np.random.Generator, down: float = 0.4) -> Floats:
    angle = rng.uniform(0.0, 2.0 * np.pi)
    return np.array([np.cos(angle), np.sin(angle), down * rng.normal()])


def _iron(series: Floats, along: Floats) -> Maker:
    return lambda size: Acts(body_nt=FIELD_NT * size * series[:, None] * along)


def _shift(series: Floats) -> Maker:
    return lambda size: Acts(reading=lambda gamma: size * series)


def _date(rng: np.random.Generator, scene: Scene, low: float = 0.2, high: float = 0.8) -> float:
    return float(scene.time_s[int(rng.uniform(low, high) * scene.time_s.size)])


def _through(scene: Scene, series: Floats, hours: float) -> Floats:
    """Return a series as it comes through a wall, late and smooth."""
    keep = np.exp(-scene.step_s / (hours * HOUR_S))
    return np.asarray(lfilter([1.0 - keep], [1.0, -keep], series - series[0]) + series[0])


# Iron.


def knock(rng, scene):
    """A knock turns domains over; a part of them creeps back."""
    age = np.maximum(scene.time_s - _date(rng, scene), 0.0)
    back = rng.uniform(0.0, 0.35) * (1.0 - np.exp(-age / (rng.uniform(2.0, 12.0) * DAY_S)))
    return _iron((age > 0.0) * (1.0 - back), _direction(rng))


def viscosity(rng, scene):
    """Magnetic viscosity: remanence grows with the logarithm of the time in a new field (Street and Woolley 1949)."""
    after = rng.uniform(20.0, 90.0) * DAY_S
    return _iron(np.log1p((scene.time_s - scene.time_s[0]) / after), _direction(rng))


def demagnetising(rng, scene):
    """What the deck's crane gave decays for as long as the mooring is out."""
    life = rng.uniform(0.4, 1.0) * np.ptp(scene.time_s)
    return _iron(3.0 * np.exp(-(scene.time_s - scene.time_s[0]) / life), _direction(rng))


def warm_steel(rng, scene):
    """Remanence falls with the warmth of thick steel, faster where it is warm."""
    warm = unit(_through(scene, scene.temperature_c, rng.uniform(4.0, 20.0)))
    return _iron(np.expm1(0.35 * warm) / 0.35, _direction(rng))


def hanging_magnet(rng, scene):
    """A magnet under the compass hangs on a spring: leaning, it comes nearer to one side."""
    below, soft = rng.uniform(0.3, 0.5), rng.uniform(0.0, 0.06)  # m; m per sine of the lean
    lean = np.sin(RAD * np.stack([scene.pitch_deg, -scene.roll_deg, 0.0 * scene.roll_deg], axis=-1))
    rest, moment, iron = np.array([0.0, 0.0, below]), np.array([0.0, 0.0, 0.4]), np.array([0.0, 0.0, 2000.0])
    sway = _dipole(moment, -(rest + soft * lean)) - _dipole(moment, -rest)
    return lambda size: Acts(body_nt=size * (sway + iron))


def _dipole(moment: Floats, away_m: Floats) -> Floats:
    distance = np.linalg.norm(away_m, axis=-1, keepdims=True)
    along = away_m / distance
    return np.asarray(100.0 * (3.0 * along * np.sum(along * moment, axis=-1, keepdims=True) - moment) / distance**3)


def spare_battery(rng, scene):
    """The new battery's case carries another magnetism, which its own current then drains."""
    jump = int(np.argmax(np.diff(scene.supply)))
    age = scene.time_s - scene.time_s[jump + 1]
    return _iron((age >= 0.0) * (1.0 + 0.2 * np.exp(-np.maximum(age, 0.0) / (15.0 * DAY_S))), _direction(rng))


# Electronics and mount.


def supply_loop(rng, scene):
    """A regulator draws the more current, the lower the battery: a loop's field goes with one over volts."""
    current = scene.supply.mean() / scene.supply
    return _iron(unit(current), _direction(rng))


def warm_zero(rng, scene):
    """A zero that an amplifier's leakage moves: it doubles every few kelvin."""
    warm = _through(scene, scene.temperature_c, rng.uniform(0.5, 6.0))
    return _shift(unit(np.exp2((warm - warm.mean()) / rng.uniform(2.5, 6.0))))


def three_nodes(rng, scene):
    """A table of corrections with three nodes, joined by straight lines."""
    return _table(rng, 3)


def four_nodes(rng, scene):
    """A table of corrections with four nodes, joined by straight lines."""
    return _table(rng, 4)


def _table(rng: np.random.Generator, nodes: int) -> Maker:
    begin = rng.uniform(0.0, 360.0)
    saw = lambda gamma: 1.0 - 4.0 * np.abs((nodes * (gamma - begin) / 360.0) % 1.0 - 0.5)  # noqa: E731
    return lambda size: Acts(reading=lambda gamma: size * saw(gamma))


def tired_core(rng, scene):
    """Two cores saturate: what they give falls behind the field with its cube."""
    full = 3.0e4

    def act(size: float) -> Acts:
        share = np.array([0.05 * size, 0.05 * size, 0.0])
        return Acts(warp=lambda raw: raw * (1.0 - share * (raw / full) ** 2))

    return act


def clamp_gives(rng, scene):
    """A clamp slips on one day and settles in the week after."""
    age, settle = scene.time_s - _date(rng, scene), rng.uniform(0.5, 4.0) * DAY_S
    return _shift((age > 0.0) * (1.0 - 0.4 * np.exp(-np.maximum(age, 0.0) / settle)))


def strap_creeps(rng, scene):
    """A strap stretches: fast at first, with the root of time."""
    return _shift(2.0 * scene.share ** rng.uniform(0.55, 1.0))


def damped_card(rng, scene):
    """Damping: the reading is the mean of what was, forgotten exponentially."""
    quantiles = -np.log(1.0 - (np.arange(6) + 0.5) / 6.0)
    return lambda size: Acts(late_s=tuple((900.0 * size * quantiles).tolist()))


def half_levelled(rng, scene):
    """A gain of the inclinometers that was never set: a part of the lean is left out."""
    return lambda size: Acts(unlevelled=min(size, 1.0))


def flooded_tilt(rng, scene):
    """Water in the inclinometer: within a day it holds its last angle."""
    date = _date(rng, scene, 0.25, 0.6)
    row, wet = int(np.searchsorted(scene.time_s, date)), np.clip((scene.time_s - date) / DAY_S, 0.0, 1.0)

    def tilts(pitch: Floats, roll: Floats) -> tuple[Floats, Floats]:
        return pitch + wet * (pitch[row] - pitch), roll + wet * (roll[row] - roll)

    return lambda size: Acts(tilts=tilts)


# Water, clocks, the earth.


def boundary_layer(rng, scene):
    """A boundary layer thins where the water is fast: the veer across it levels off."""
    fast = scene.speed / np.quantile(scene.speed, 0.7)
    veer = np.tanh(fast) if rng.random() < 0.5 else np.sqrt(fast)
    return lambda size: Acts(veer_deg=size * unit(veer))


def steered(rng, scene):
    """A ridge steers the lower water along itself: a veer that goes with twice or once the direction."""
    way, phase = RAD * towards(np.where(np.isfinite(scene.near), scene.near, 1.0)), rng.uniform(0.0, 2.0 * np.pi)
    twice = rng.uniform(0.0, 1.0)
    veer = (1.0 - twice) * np.sin(way + phase) + twice * np.sin(2.0 * way + 2.0 * phase)
    return lambda size: Acts(veer_deg=size * unit(veer))


def wrong_set_clock(rng, scene):
    """A clock that was set by a watch."""
    hours = rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 1.5)
    return lambda size: Acts(ahead_s=hours * HOUR_S + 0.0 * scene.time_s)


def old_quartz(rng, scene):
    """A crystal that ages and runs by its warmth (the parabola of a tuning fork)."""
    cold = (scene.temperature_c - 25.0) ** 2
    rate = 0.6 + 0.4 * cold / cold.mean()
    hours = rng.choice([-1.0, 1.0]) * rng.uniform(0.7, 1.5)
    return lambda size: Acts(ahead_s=hours * HOUR_S * np.cumsum(rate) / np.sum(rate))


def magnetic_storms(rng, scene):
    """Storms: sudden commencement, main phase, a recovery of days, and a daily swing that follows the season."""
    day = 2.0 * np.pi * scene.time_s / DAY_S
    swing = 0.1 * (1.0 + 0.5 * np.cos(2.0 * np.pi * scene.years)) * (np.sin(day) + 0.4 * np.sin(2.0 * day + 0.7))
    for date in rng.uniform(scene.time_s[0], scene.time_s[-1], 25):
        age = np.maximum(scene.time_s - date, 0.0) / DAY_S
        burst = rng.lognormal(0.0, 0.7) * (age > 0.0) * np.exp(-age / rng.uniform(0.4, 1.5))
        swing = swing + burst * np.sin(2.0 * np.pi * age * rng.uniform(1.5, 6.0) + rng.uniform(0.0, 2.0 * np.pi))
    return lambda size: Acts(north_deg=size * swing)


# What nobody listed.


def hysteresis(rng, scene):
    """Soft steel follows the earth's field as the sphere turns, but late: it remembers days."""
    turn = RAD * scene.heading_deg
    days = rng.uniform(1.5, 8.0) * 24.0
    felt = [_through(scene, series, days) for series in (np.cos(turn), -np.sin(turn))]
    return lambda size: Acts(body_nt=FIELD_NT * size * 4.0 * np.stack([*felt, 0.0 * turn], axis=-1))


def rolling_shackle(rng, scene):
    """A shackle rolls to the other side when the lean is large enough, and back only at a much smaller one."""
    lean = unit(scene.roll_deg * rng.uniform(-1.0, 1.0) + scene.pitch_deg * rng.uniform(-1.0, 1.0))
    side, at = np.empty(lean.size), 0.0
    for k, x in enumerate(lean.tolist()):
        at = 1.0 if x > 0.8 else 0.0 if x < -0.6 else at
        side[k] = at
    return _iron(2.0 * side, _direction(rng))


def neighbour(rng, scene):
    """A crawling profiler comes by on the wire every so many hours, for a while each time."""
    every, near = rng.uniform(15.0, 40.0) * HOUR_S, rng.uniform(0.12, 0.3)
    turns = ((scene.time_s - scene.time_s[0]) / every) % 1.0
    return _iron(3.0 * np.exp(-0.5 * (np.minimum(turns, 1.0 - turns) / near) ** 2), _direction(rng))


def chirp(rng, scene):
    """A loose part swings with a period that grows as its spring wears."""
    days, begin = (scene.time_s - scene.time_s[0]) / DAY_S, rng.uniform(3.0, 8.0)
    return _shift(np.sin(2.0 * np.pi * 60.0 * np.log1p(days / 60.0) / begin + rng.uniform(0.0, 2.0 * np.pi)))


def crackle(rng, scene):
    """A contact fails now and then: shots of random size and sign that heal within days."""
    made, heal = np.zeros(scene.time_s.size), rng.uniform(2.0, 8.0) * DAY_S
    for date in rng.uniform(scene.time_s[0], scene.time_s[-1], max(6, int(12 * scene.years[-1]))):
        age = scene.time_s - date
        made += rng.normal(0.0, 2.0) * (age > 0.0) * np.exp(-np.maximum(age, 0.0) / heal)
    return _shift(made)


def strumming(rng, scene):
    """At one speed the wire strums and shakes the card off its point."""
    at = np.quantile(scene.speed, rng.uniform(0.3, 0.7))
    return _shift(3.0 * np.exp(-0.5 * ((scene.speed - at) / (0.3 * scene.speed.std())) ** 2))


def detent(rng, scene):
    """A worn jewel: in one sector the card rests at the sector's edge."""
    half = rng.uniform(12.0, 25.0)
    middle = rng.choice(scene.heading_deg)

    def reading(gamma: Floats) -> Floats:
        off = wrap(gamma - middle)
        return np.where(np.abs(off) < half, np.sign(off) * (half - np.abs(off)), 0.0)

    return lambda size: Acts(reading=lambda gamma: min(size, 4.0) * 0.25 * reading(gamma))


def thermal_shock(rng, scene):
    """A board bends while it warms or cools, and is straight again when it rests."""
    warm = _through(scene, scene.temperature_c, 3.0)
    return _shift(unit(np.gradient(warm, scene.time_s)))


def leak(rng, scene):
    """Water creeps into the housing: lobes of the reading grow exponentially at the end."""
    phase, life = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.08, 0.25) * np.ptp(scene.time_s)
    grown, lobes = 4.0 * np.exp((scene.time_s - scene.time_s[-1]) / life), int(rng.choice([3, 4]))
    return lambda size: Acts(reading=lambda gamma: size * grown * np.sin(lobes * RAD * gamma + phase))


def warm_and_fast(rng, scene):
    """A flexible mount: softer when warm, bent by the flow."""
    return _shift(unit(scene.temperature_c) * unit(scene.speed**2))


def summer_noon(rng, scene):
    """Light or load by the hour, in one season only."""
    hour = 2.0 * np.pi * (scene.time_s / DAY_S - rng.uniform())
    season = expit(3.0 * np.cos(2.0 * np.pi * (scene.time_s / (365.25 * DAY_S) - rng.uniform())))
    return _shift(3.0 * season * np.cos(hour))


def fine_teeth(rng, scene):
    """A coded disc with teeth cut unevenly: five and seven to the turn."""
    phases = rng.uniform(0.0, 2.0 * np.pi, 2)
    teeth = lambda gamma: np.sin(5 * RAD * gamma + phases[0]) + 0.7 * np.sin(7 * RAD * gamma + phases[1])  # noqa: E731
    return lambda size: Acts(reading=lambda gamma: size * teeth(gamma))


def lost_chain(rng, scene):
    """A chain that hangs free comes alongside for some days, a few times."""
    late = np.zeros(scene.time_s.size)
    for date in rng.uniform(scene.time_s[0], scene.time_s[-1], 5):
        late += np.exp(-0.5 * ((scene.time_s - date) / (rng.uniform(2.0, 6.0) * DAY_S)) ** 2)
    return _iron(3.0 * late, _direction(rng))


def _family(make: Callable[..., Maker], *right: str, **more: object) -> Family:
    return Family(make.__name__, make, right, **more)  # type: ignore[arg-type]


NAMED = (
    _family(knock, "hard_iron_step"),
    _family(viscosity, "hard_iron_drift"),
    _family(demagnetising, "hard_iron_drift"),
    _family(warm_steel, "temperature"),
    _family(warm_zero, "temperature"),
    _family(hanging_magnet, "heeling", most=7.0),
    _family(spare_battery, "battery_change", "hard_iron_step", needs=("battery",)),
    _family(supply_loop, "supply_voltage"),
    _family(three_nodes, "sextantal", most=9.0),
    _family(four_nodes, "octantal", most=9.0),
    _family(tired_core, "octantal", "sextantal", most=9.0),
    _family(clamp_gives, "heading_slip"),
    _family(strap_creeps, "compass_drift"),
    _family(damped_card, "compass_lag", most=2.5),
    _family(half_levelled, "tilt_uncompensated", most=1.0),
    _family(flooded_tilt, "stuck_tilt", sized=False),
    _family(boundary_layer, "current_veer", side="water", most=15.0),
    _family(steered, "current_veer", side="water", most=15.0),
    _family(wrong_set_clock, "clock_offset", side="clock", sized=False),
    _family(old_quartz, "clock_drift", side="clock", sized=False),
    _family(magnetic_storms, "field_disturbance", most=8.0, needs=("observatory",)),
)
STRANGE = (
    _family(hysteresis, most=8.0),
    _family(detent, most=4.0),
    *(
        _family(make)
        for make in (
            rolling_shackle, neighbour, chirp, crackle, strumming, thermal_shock, leak, warm_and_fast, summer_noon,
            fine_teeth, lost_chain,
        )
    ),
)  # fmt: skip
