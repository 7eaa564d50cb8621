"""Effects beyond the catalogue, composed of three words: a target, a driver and a form.

A composed effect is used like any other. The target defines its parameters and side; driver and form define one or two
time series by which the parameters are multiplied. Places (a threshold, a date, a time constant) are searched for and
not fitted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, make_dataclass
from functools import cache
from typing import Any, ClassVar

import numpy as np

from compasslib import angles
from compasslib.effects.effect import HOUR_S, Effect, Scene, Side, Stage, parameter
from compasslib.statistics.whitening import autoregress
from compasslib.types import Floats

COMPOSED = "composed:"
TIDE_S = 12.4206 * HOUR_S
MIN_SLOPE = 0.2  # slope of a reading below which it is not inverted

# Drivers: covariate departure required in the scene, unit. Drivers without a departure are functions of time.
DRIVERS: Mapping[str, tuple[str, str]] = {
    "time": ("", "year"),
    "hour": ("", "1"),
    "tide": ("", "1"),
    "heading": ("", "1"),
    "temperature": ("temperature", "K"),
    "depth": ("depth", "m"),
    "speed": ("speed", "m/s"),
    "pitch": ("pitch", "degree"),
    "roll": ("roll", "degree"),
    "tilt": ("tilt", "degree"),
    "voltage": ("supply_voltage", "V"),
    "turn_rate": ("turn_rate", "degree/s"),
}


@dataclass(frozen=True)
class EffectTarget:
    """Target of composed effects: parameters as (name, unit, step), and where, on what and how the effect acts."""

    parameters: tuple[tuple[str, str, float], ...]
    acts_on: str
    #: amplitudes (n, p), quantity acted on, and scene -> what is added to the quantity
    add: Callable[[Floats, Floats, Scene], Floats]
    side: Side = "compass"
    stage: Stage = "surroundings"
    needs: tuple[str, ...] = ()


def _lobe(order: float) -> EffectTarget:
    return EffectTarget(
        (("sine", "degrees", 1.0), ("cosine", "degrees", 1.0)), "reading",
        lambda size, x, _: np.sum(size.T * angles.sin_cos(order * x), axis=0), stage="readout",
    )  # fmt: skip


FIELD_STEP, BIAS_STEP = 200.0, 0.003
LOBES = {"lobe3": 3.0, "lobe4": 4.0}
TARGETS: Mapping[str, EffectTarget] = {
    "field_horizontal": EffectTarget(
        (("forward", "nT", FIELD_STEP), ("starboard", "nT", FIELD_STEP)), "field",
        lambda size, *_: np.column_stack([size, np.zeros(len(size))]),
    ),
    "field_down": EffectTarget((("down", "nT", 1000.0),), "field", lambda size, *_: size * np.array([0.0, 0.0, 1.0])),
    "reading": EffectTarget((("reading", "degrees", 1.0),), "reading", lambda size, *_: size[:, 0], stage="readout"),
    **{name: _lobe(order) for name, order in LOBES.items()},
    "flow_gain": EffectTarget(
        (("gain", "1", 0.035),), "water",
        lambda size, _, scene: size[:, 0] / 2.0 / angles.DEGREE * scene.departures["body_flow_sine2"],
        "water", needs=("body_flow_sine2",),
    ),
    "flow_offset": EffectTarget(
        (("forward", "m/s", BIAS_STEP), ("starboard", "m/s", BIAS_STEP)), "water",
        lambda size, _, scene: (
            size[:, 0] * scene.departures["body_flow_sine"] - size[:, 1] * scene.departures["body_flow_cosine"]
        ) / angles.DEGREE,
        "water", needs=("body_flow_sine", "body_flow_cosine"),
    ),
    "flow_direction": EffectTarget((("veer", "degrees", 1.0),), "water", lambda size, *_: size[:, 0], "water"),
}  # fmt: skip


@dataclass(frozen=True)
class Form:
    """Functional form of the dependence on a driver: its time series and its places."""

    series: Callable[[Any, Floats, Floats], Floats]  # (term, driver, times) -> (n, c)
    suffixes: tuple[str, ...] = ("",)  # of the parameter names, one per series
    per_driver: bool = False  # whether the parameter's unit is divided by the driver's
    places: tuple[tuple[str, str], ...] = ()  # name and unit; "of the driver" means the driver's unit
    words: str = ""
    formula: str = ""  # p: each parameter, x: driver minus its mean, {}: name of the driver


def _lagged(x: Floats, time_s: Floats, constant_s: float) -> Floats:
    """Apply a first-order low-pass filter to a driver, (n,)."""
    step = max(float(np.median(np.diff(time_s))), 1.0)
    grid = np.arange(time_s[0], time_s[-1] + step, step)
    share = -np.expm1(-step / max(constant_s, step / 10.0))
    even = np.interp(grid, time_s, x)
    driver = np.concatenate([even[:1], share * even[1:]])
    return np.interp(time_s, grid, autoregress(driver, [1.0, share - 1.0]))


def play(x: Floats, width: float) -> Floats:
    """Apply a play operator (backlash) to a driver: the output stays until the driver moves it, (n,).

    Each sample clips the output to an interval about the driver. Clipping to two intervals in turn equals clipping to a
    third one, so that the intervals of ever longer spans are combined, all samples at once (a parallel prefix sum).
    """
    low, high, span = x - width / 2.0, x + width / 2.0, 1
    while span < len(x):
        low[span:], high[span:] = (np.clip(end[:-span], low[span:], high[span:]) for end in (low, high))
        span *= 2
    return np.clip(x[:1], low, high)


SMOOTH, WIDE = 6, 4.0  # functions of a smooth curve, and standard deviations from its middle that it reaches
SMOOTHNESS = 1.2  # length scale of a smooth curve, standard deviations
BANDS_H = (2.0, 6.0, 18.0, 54.0, 168.0)  # time constants between the bands of a driver's history
SLOW_WAVES, FREE_WAVES, FREE_FROM = 8, 24, 8.0  # cosines of time, and number from which those of a free curve decrease
LOBES_TRIED, TEETH_TRIED = range(3, 11), range(3, 20)  # cycles per turn
DAILY_H, TIDAL_H = (24.0, 12.0, 8.0), (12.4206, 25.8193, 12.6583)  # periods


def _smooth(term: Any, x: Floats, t: Floats) -> Floats:
    """Evaluate the basis of a Gaussian process along a driver, 0 in its middle (Solin and Sarkka 2020)."""
    reach = WIDE + 1.0
    frequency = np.pi * np.arange(1, SMOOTH + 1) / (2.0 * reach)
    standard = np.clip((x - term.middle) / max(abs(term.range), 1e-12), -WIDE, WIDE)
    waves = np.sin((standard[:, None] + reach) * frequency) - np.sin(reach * frequency)
    return np.asarray(waves * np.exp(-((SMOOTHNESS * frequency) ** 2) / 4.0))


def _bands(term: Any, x: Floats, t: Floats) -> Floats:
    """Divide a driver into causal bands of its history, from its fastest changes to its slowest, (n, 6)."""
    passed = np.stack([x, *(_lagged(x, t, HOUR_S * hours) for hours in BANDS_H), np.zeros_like(x)], axis=1)
    return passed[:, :-1] - passed[:, 1:]


def _cosines(term: Any, t: Floats, count: int) -> Floats:
    share = (t - term.begin_s) / max(term.end_s - term.begin_s, 1.0)
    return np.asarray(np.cos(np.pi * share[:, None] * np.arange(1, count + 1)))


def _waves(angle_deg: Floats, weights: Floats) -> Floats:
    """Compute sine and cosine columns of several angles, (n, k) degrees, times a weight of each angle, (n, 2 k)."""
    return np.concatenate([wave * weights for wave in angles.sin_cos(angle_deg)], axis=1)


def _periods(t: Floats, periods_h: tuple[float, ...]) -> Floats:
    return _waves(360.0 * t[:, None] / HOUR_S / np.array(periods_h), np.ones(len(periods_h)))


def _numbered(count: int) -> tuple[str, ...]:
    return tuple(f"_{k}" for k in range(1, count + 1))


SPAN = (("begin_s", "s"), ("end_s", "s"))
FORMS: Mapping[str, Form] = {
    "always": Form(lambda term, x, t: np.ones((len(t), 1)), words="by a constant", formula="p"),
    "linear": Form(lambda term, x, t: x[:, None], per_driver=True, words="in proportion to {}", formula="p·x"),
    "smooth": Form(
        _smooth, _numbered(SMOOTH), places=(("middle", "of the driver"), ("range", "of the driver")),
        words="along a smooth curve of {}",
        formula=f"Σ p_k·exp(−({SMOOTHNESS}·ω)²/4)·(sin(ω·(z + {WIDE + 1:g})) − sin({WIDE + 1:g}·ω)), "
        f"ω = kπ/{2 * WIDE + 2:g}, z = (x − middle)/range within ±{WIDE:g}",
    ),
    "bands": Form(
        _bands, _numbered(len(BANDS_H) + 1), per_driver=True, words="with {} and its history",
        formula="Σ p_k·(difference of x between low-pass filters of " + ", ".join(f"{h:g}" for h in BANDS_H) + " h)",
    ),
    "memory": Form(
        lambda term, x, t: play(x, term.width)[:, None], per_driver=True, places=(("width", "of the driver"),),
        words="with {} and the side that it comes from (hysteresis)",
        formula="p·x, x followed with a play of the width",
    ),
    "sign": Form(lambda term, x, t: np.sign(x)[:, None], words="with the sign of {}", formula="p·sign(x)"),
    "periodic": Form(
        lambda term, x, t: np.column_stack(angles.sin_cos(360.0 * t / term.period_s)), ("_sine", "_cosine"),
        places=(("period_s", "s"),), words="once every period of {}",
        formula="p_sine·sin(2πt / period) + p_cosine·cos(2πt / period)",
    ),
    "daily": Form(
        lambda term, x, t: _periods(t, DAILY_H), _numbered(2 * len(DAILY_H)), words="with the time of day",
        formula="Σ sines, then cosines, of periods of 24, 12 and 8 h",
    ),
    "tidal": Form(
        lambda term, x, t: _periods(t, TIDAL_H), _numbered(2 * len(TIDAL_H)), words="with the tide",
        formula="Σ sines, then cosines, of the periods of M2, O1 and N2",
    ),
    "harmonics": Form(
        lambda term, x, t: _waves(x[:, None] * np.array(LOBES_TRIED), 1.0 / (np.array(LOBES_TRIED) - 2.0)),
        _numbered(2 * len(LOBES_TRIED)), words="with higher harmonics of {}",
        formula="Σ sines, then cosines, of 3 to 10 times the reading, over the number of times less 2",
    ),
    "teeth": Form(
        lambda term, x, t: _waves(x[:, None] * np.array(TEETH_TRIED), np.ones(len(TEETH_TRIED))),
        _numbered(2 * len(TEETH_TRIED)), words="in many lobes of {}",
        formula="Σ sines, then cosines, of 3 to 19 times the reading",
    ),
    "bump": Form(
        lambda term, x, t: bump(x, term.centre_deg, term.reach_deg)[:, None],
        places=(("centre_deg", "degrees"), ("reach_deg", "degrees")), words="around one {} only",
        formula="p·(1 + cos(π·(reading − centre) / reach)) / 2 within reach of centre, else 0",
    ),
    "slow": Form(
        lambda term, x, t: _cosines(term, t, SLOW_WAVES) / np.arange(1, SLOW_WAVES + 1) ** 2.0,
        _numbered(SLOW_WAVES), places=SPAN, words="slowly with {}",
        formula="Σ p_k·cos(kπ·(t − begin) / (end − begin)) / k²",
    ),
    "free": Form(
        lambda term, x, t: _cosines(term, t, FREE_WAVES) / np.hypot(1.0, np.arange(1, FREE_WAVES + 1) / FREE_FROM),
        _numbered(FREE_WAVES), places=SPAN, words="as a free function of {}",
        formula=f"Σ p_k·cos(kπ·(t − begin) / (end − begin)) / √(1 + (k/{FREE_FROM:g})²)",
    ),
    "creep": Form(
        lambda term, x, t: np.log1p(np.maximum((t - term.from_s) / term.constant_s, 0.0))[:, None],
        places=(("from_s", "s"), ("constant_s", "s")), words="with the logarithm of {}",
        formula="p·ln(1 + (t − from) / constant), from the beginning, or of negative constant from the end",
    ),
    "box": Form(
        lambda term, x, t: ((t >= term.begin_s) & (t < term.end_s)).astype(float)[:, None],
        places=SPAN, words="for a while", formula="p from begin to end, else 0",
    ),
}  # fmt: skip


def effect_formula(acts_on: str, driver: str, form: str) -> str:
    """Compose the formula of a composed effect: p its parameters, x its driver's departure from the mean."""
    drives, text = driver.replace("_", " ").replace("*", " · "), FORMS[form].formula
    order = LOBES.get(acts_on.replace("_", ""), 0.0)
    lobe = f", times sine and cosine of {order:.0f} × reading" if order else ""
    return text.format(drives) + lobe + (f" (x: {drives} minus its mean)" if "·x" in text or "(x)" in text else "")


def bump(heading_deg: Floats, centre_deg: float, reach_deg: float) -> Floats:
    """Evaluate a raised-cosine bump of given half-width around a heading, (n,), 0 to 1."""
    away = np.abs(angles.difference(heading_deg, centre_deg)) / max(reach_deg, 1e-9)
    return np.where(away < 1.0, (1.0 + np.cos(np.pi * away)) / 2.0, 0.0)


@dataclass(frozen=True)
class ComposedEffect(Effect):
    """An effect composed of a target, a driver and a form."""

    literature: ClassVar[str] = "none: composed by the search"
    composition: ClassVar[tuple[str, str, str]]  # target, driver, form

    def series(self, scene: Scene, reading_deg: Floats | None = None) -> Floats:
        """Compute the time series that multiply the parameters, (n, c); readings are needed only if they drive."""
        _, driver, form = self.composition
        if driver == "heading":
            return self.evaluate(scene, reading_deg)
        stored: dict[Any, Floats] = scene.__dict__.setdefault("composed", {})  # cache for derivatives at one place
        key = (driver, form, *(getattr(self, name) for name, _ in FORMS[form].places))
        if key not in stored:
            stored[key] = self.evaluate(scene)
        return stored[key]

    def evaluate(self, scene: Scene, reading_deg: Floats | None = None) -> Floats:
        _, driver, form = self.composition
        x = reading_deg if driver == "heading" else driver_series(scene, driver)
        assert x is not None
        return FORMS[form].series(self, x, scene.time_s)

    def reported_composition(self) -> tuple[str, str, str]:
        """Return target, driver and form as reported by a diagnosis; for a horizontal field its larger component."""
        acted, driver, form = self.composition
        if acted == "field_horizontal":
            forward, starboard = np.abs(self.values).reshape(2, -1).max(axis=1)
            acted = "field_forward" if forward >= starboard else "field_starboard"
        return acted, driver, form

    def span(self, first_s: float, last_s: float) -> tuple[float, float]:
        """Compute the period in which the effect acts within a recording, UTC seconds."""
        begin = float(getattr(self, "begin_s", first_s))
        return begin, float(getattr(self, "end_s", last_s)) if self.composition[2] == "box" else last_s

    def amplitudes(self, scene: Scene, reading_deg: Floats | None = None) -> Floats:
        """Compute the amplitude along each of the target's parameters, (n, p)."""
        series = self.series(scene, reading_deg)
        return np.einsum("nc,pc->np", series, self.values.reshape(-1, series.shape[1]))

    def apply(self, x: Floats, scene: Scene) -> Floats:
        """Apply the effect to its target."""
        size = self.amplitudes(scene, x if self.acts_on == "reading" else None)
        return np.asarray(x + TARGETS[self.composition[0]].add(size, x, scene))

    def invert(self, reading_deg: Floats, scene: Scene) -> Floats:
        """Remove the effect from a reading by Newton's method, NaN where the inverse is not unique."""
        acted, driver, _ = self.composition
        if acted not in LOBES and driver != "heading":
            return super().invert(reading_deg, scene)
        if not self.single(scene):
            return np.full_like(reading_deg, np.nan)
        x = np.array(reading_deg, dtype=float)
        for _ in range(NEWTON):
            slope = (self.apply(x + PROBE_DEG, scene) - self.apply(x - PROBE_DEG, scene)) / (2.0 * PROBE_DEG)
            x = x - (self.apply(x, scene) - reading_deg) / np.maximum(slope, MIN_SLOPE / 2.0)
        return x

    def single(self, scene: Scene) -> bool:
        """Check whether every reading has a unique inverse, i.e. increases with the angle of the field."""
        acted, driver, form = self.composition
        if acted in LOBES:
            size = np.hypot(*self.amplitudes(scene).T)
            return bool(1.0 - LOBES[acted] * angles.DEGREE * size.max(initial=0.0) > 0.0)
        if driver != "heading":
            return True
        turn = np.arange(0.0, 361.0)
        return bool(np.diff(turn + FORMS[form].series(self, turn, turn) @ self.values).min() > MIN_SLOPE)

    @property
    def possible(self) -> bool:
        """Whether readings increase with the angle of the field, where the effect depends on the heading alone."""
        acted, driver, _ = self.composition
        return acted in LOBES or driver != "heading" or self.single(NOWHERE)


NEWTON, PROBE_DEG = 8, 1e-3
NOWHERE = Scene(*(np.zeros(0),) * 5, 0.0)


def driver_series(scene: Scene, driver: str) -> Floats:
    """Compute a driver's departure from its reference, (n,); for two joined by * their product.

    Raises:
        KeyError: the scene does not have it.
    """
    if "*" in driver:
        first, second = driver.split("*")
        return driver_series(scene, first) * driver_series(scene, second)
    if driver == "time":
        return scene.years
    name = DRIVERS.get(driver, (driver, ""))[0]
    return scene.departures[name] if name else np.zeros(len(scene))


@cache
def compose_effect(
    acts_on: str, driver: str, form: str, *, name: str = "", words: str = "", usual: float = np.inf
) -> type[ComposedEffect]:
    """Create the class of a composed effect from its target, driver and form."""
    acted, shape = TARGETS[acts_on], FORMS[form]
    departures, units = zip(*(DRIVERS.get(each, (each, each)) for each in driver.split("*")), strict=True)
    unit = " ".join(units)
    per = "" if unit == "1" or not shape.per_driver else f"/({unit})" if " " in unit or "/" in unit else f"/{unit}"
    members = [
        (f"{column}{suffix}", float, parameter(base + per, f"{column} part", step, usual=usual))
        for column, base, step in acted.parameters
        for suffix in shape.suffixes
    ]
    for place, of in shape.places:
        described = parameter(unit if of == "of the driver" else of, "place that was looked for", 0.0)
        members.append((place, float, described))
    changed = acts_on.replace("field_horizontal", "horizontal field").replace("_", " ")
    space = {
        "name": name or f"{COMPOSED}{acts_on}/{driver}/{form}",
        "side": acted.side,
        "stage": acted.stage,
        "acts_on": acted.acts_on,
        "needs": (*filter(None, departures), *acted.needs),
        "words": words,
        "composition": (acts_on, driver, form),
        "driver": name if form == "always" else driver,
        "__doc__": f"The {changed} is changed {shape.words.format(driver.replace('_', ' '))}.",
        "__module__": __name__,
    }
    title = "".join(word.capitalize() for part in (acts_on, *driver.split("*"), form) for word in part.split("_"))
    return make_dataclass(title, members, bases=(ComposedEffect,), frozen=True, namespace=space)


# Composed effects that are common enough to have a name.
MOVES = "iron near the compass moves as the instrument leans, a battery or a cable"
Pressure = compose_effect(
    "field_horizontal", "depth", "linear", name="pressure",
    words="the iron near the compass, or the compass, depends on pressure",
)  # fmt: skip
IronMovedByPitch = compose_effect("field_horizontal", "pitch", "linear", name="moving_iron", words=MOVES)
IronMovedByRoll = compose_effect("field_horizontal", "roll", "linear", name="moving_iron", words=MOVES)
PivotFriction = compose_effect(
    "reading", "turn_rate", "sign", name="pivot_friction",
    words="the compass sticks on its pivot and stops short of each heading, on the side that it comes from",
)  # fmt: skip
BeamGain = compose_effect(
    "flow_gain", "time", "always", name="beam_gain", usual=0.05,  # of one beam pair relative to the other
    words="the beam pairs of this instrument are of unequal gain, which turns currents and no heading",
)  # fmt: skip
VelocityBias = compose_effect(
    "flow_offset", "time", "always", name="velocity_bias", usual=0.02,  # m/s
    words="the velocities of this instrument have a constant offset in its own frame, as by ringing",
)  # fmt: skip


def effect_by_name(effect: str) -> type[ComposedEffect]:
    """Create the class of a composed effect from its name, composed:ACTS_ON/DRIVER/FORM."""
    return compose_effect(*effect.removeprefix(COMPOSED).split("/"))


def as_current(term: ComposedEffect) -> ComposedEffect:
    """Make the corresponding term of the current's direction, with the same driver, form and places and zero size."""
    places = (getattr(term, f.name) for f in fields(term) if not f.metadata["step"])
    return place_effect(compose_effect("flow_direction", *term.composition[1:]), *places)


def place_effect(kind: type[ComposedEffect], *at: float) -> ComposedEffect:
    """Make a term of zero size with given places, in the order of the form's places."""
    names = [f.name for f in fields(kind) if not f.metadata["step"]]
    return kind(**dict(zip(names, at, strict=True)))
