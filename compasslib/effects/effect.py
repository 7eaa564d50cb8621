"""Base class of effects: a few parameters with units, and one method that applies the effect.

A compass effect acts on the magnetic field in the body frame, on the direction of magnetic north, or on the reading; a
water effect on the direction of the current, or on the velocity of the water that carries a ship; a clock effect on
time. Effects are applied in sequence to the field vector or the reading; deviations are never added.
"""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import Field, dataclass, field, fields, make_dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Literal, Self

import numpy as np

from compasslib import compass
from compasslib.types import DAY_S as DAY_S
from compasslib.types import HOUR_S as HOUR_S
from compasslib.types import YEAR_S as YEAR_S
from compasslib.types import Floats

Side = Literal["compass", "reference", "water", "clock"]
Stage = Literal["surroundings", "sensor", "readout", "clock"]

USUAL_DEG = 4.0  # prior rms change of heading by an effect whose physics sets no size
SHORT_RECORDINGS = ("platform", "swing", "magnetometer", "two_heads")
READINGS = ("mooring", *SHORT_RECORDINGS)  # recordings of a compass


@dataclass(frozen=True)
class Scene:
    """Conditions of a recording at each sample."""

    time_s: Floats  # (n,)
    horizontal_nT: Floats  # (n,) earth's field
    vertical_nT: Floats  # (n,) down positive
    pitch_deg: Floats  # (n,) forward up
    roll_deg: Floats  # (n,) starboard down
    begin_s: float  # origin of drifts
    departures: Mapping[str, Floats] = field(default_factory=dict)  # (n,) covariates minus their references
    turned: Any = None  # seconds ahead -> change of heading until then, (n,) degrees; None if unknown

    def __len__(self) -> int:
        return len(self.time_s)

    @cached_property
    def levelling(self) -> Floats:
        """Rotation from the body frame to the level frame at each sample, (n, 3, 3)."""
        return compass.levelling(np.nan_to_num(self.pitch_deg), np.nan_to_num(self.roll_deg))

    @property
    def years(self) -> Floats:
        """Years since the beginning, (n,)."""
        return (self.time_s - self.begin_s) / YEAR_S

    @property
    def elapsed_share(self) -> Floats:
        """Elapsed share of the record, (n,)."""
        return (self.time_s - self.time_s[0]) / max(float(np.ptp(self.time_s)), 1e-9)

    def since(self, date_s: float) -> Floats:
        """Compute a step from 0 to 1 at a date in UTC seconds since 1970, (n,)."""
        return np.asarray(self.time_s >= date_s, dtype=float)


def parameter(unit: str, meaning: str, step: float, *, usual: float = np.inf) -> Any:
    """Declare a parameter that is 0 where the effect is absent.

    Args:
        step: a change that turns the heading by very roughly a degree, for finite differences.
        usual: standard deviation of its prior; by default that of an effect of ``USUAL_DEG`` in the record.
    """
    return field(default=0.0, metadata={"unit": unit, "meaning": meaning, "step": step, "usual": usual})


def date_parameter() -> Any:
    """Declare a date that is searched for and not fitted."""
    return parameter("s", "UTC seconds since 1970 of the change", 0.0)


@dataclass(frozen=True)
class Effect(ABC):
    """One effect; its fields are parameters, whose default values mean that the effect is absent."""

    name: ClassVar[str]
    side: ClassVar[Side] = "compass"
    stage: ClassVar[Stage] = "surroundings"
    acts_on: ClassVar[Literal["field", "north", "reading", "water", "velocity", "time"]] = "field"
    literature: ClassVar[str]
    needs: ClassVar[tuple[str, ...]] = ()  # covariates without which it cannot be tested
    recordings: ClassVar[tuple[str, ...]] = ("mooring",)  # kinds of recordings in which it is tested
    driver: ClassVar[str] = "time"  # quantity that its size depends on; empty if constant
    words: ClassVar[str] = ""  # description of its physics, given on the first form of an effect
    shows_along: ClassVar[tuple[str, ...]] = ()  # covariates that reveal it, on the first form; empty: time
    separated_by: ClassVar[Mapping[str, str]] = {}  # name of another effect -> observation that separates the two
    detector: ClassVar[str] = ""  # comparison without forward model that detects it apart from the search
    instrument: ClassVar[bool] = False  # whether it belongs to the instrument and is the same in all its records

    @abstractmethod
    def apply(self, x: Floats, scene: Scene) -> Floats:
        """Apply the effect to the quantity on which it acts.

        Args:
            x: field in the body frame, (n, 3) nT; or shift of north, reading, or veer of the water, (n,) degrees; or
                velocity of the water that carries a ship, (n, 2) m/s; or clock error, (n,) seconds.
        """

    def invert(self, reading_deg: Floats, scene: Scene) -> Floats:
        """Remove the effect from a reading, (n,) degrees; this default is for shifts independent of the reading."""
        return reading_deg - self.apply(np.zeros_like(reading_deg), scene)

    @classmethod
    def fitted(cls) -> tuple[str, ...]:
        """List the names of the fitted parameters, without dates and places."""
        return tuple(f.name for f in fields(cls) if f.metadata["step"])

    @classmethod
    def steps(cls) -> Floats:
        """Return changes of the fitted parameters that each turn the heading by very roughly a degree, (p,)."""
        return np.array([f.metadata["step"] for f in fields(cls) if f.metadata["step"]])

    @classmethod
    def expected(cls) -> Floats:
        """Return the prior precision of each fitted parameter about 0, (p,); 0 for most."""
        return np.array([f.metadata["usual"] for f in fields(cls) if f.metadata["step"]]) ** -2.0

    @classmethod
    def units(cls) -> tuple[str, ...]:
        return tuple(f.metadata["unit"] for f in fields(cls) if f.metadata["step"])

    @classmethod
    def dated(cls) -> bool:
        """Check whether the effect has a date."""
        return any(f.name == "date_s" for f in fields(cls))

    @property
    def date(self) -> float:
        """Date of the effect, UTC seconds since 1970; 0 if it has none."""
        return float(getattr(self, "date_s", 0.0))

    @property
    def possible(self) -> bool:
        """Whether the values are possible, e.g. readings invertible and delays not negative; True by default."""
        return True

    @property
    def values(self) -> Floats:
        """Values of the fitted parameters, (p,)."""
        return np.array([getattr(self, name) for name in self.fitted()])

    def at(self, values: Floats) -> Self:
        """Replace the values of the fitted parameters."""
        return replace(self, **dict(zip(self.fitted(), np.asarray(values, dtype=float).tolist(), strict=True)))


def proportional(term: Effect, scene: Scene) -> Any:
    """Sum the parameters, each times the departure of its covariate, in the order of ``needs``."""
    return sum(value * scene.departures[name] for value, name in zip(term.values.tolist(), term.needs, strict=True))


def make_effect(title: str, summary: str, apply: Callable[[Any, Floats, Scene], Floats], **members: Any) -> type[Any]:
    """Create the class of an effect: a row of the catalogue, with its parameters, in order, and attributes."""
    parameters = [(name, float, value) for name, value in members.items() if isinstance(value, Field)]
    attributes = {name: value for name, value in members.items() if not isinstance(value, Field)}
    namespace = {"__doc__": summary, "apply": apply} | attributes
    return make_dataclass(title, parameters, bases=(Effect,), namespace=namespace, frozen=True)


def additive(title: str, summary: str, add: Callable[[Any, Scene], Any] = proportional, **members: Any) -> type[Any]:
    """Create the class of an effect that adds ``add(term, scene)`` to the quantity that it acts on."""
    return make_effect(title, summary, lambda term, x, scene: np.asarray(x + add(term, scene)), **members)


def parameter_slices(terms: Iterable[Effect | type[Effect]], first: int = 0) -> list[slice]:
    """Locate the fitted parameters of each term in the joint parameter vector, after ``first`` others."""
    ends = np.cumsum([first, *(len(term.fitted()) for term in terms)])
    return [slice(int(a), int(b)) for a, b in itertools.pairwise(ends)]


def turning_scene(scene: Scene, turned: Callable[[float], Floats]) -> Scene:
    """Add the rotation of the instrument to a scene, see ``Scene.turned``."""
    return replace(scene, turned=turned)
