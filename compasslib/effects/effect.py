"""What a term of physics is: a few parameters with units, and one method that acts.

A compass term acts on the magnetic field in the body frame, on the direction of magnetic north, or on the reading; a
water term on the direction of the water, or on the velocity of what carries a ship, a clock term on time. Terms compose
in the order of their stages, on the field vector: deviations are never added.
"""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, ClassVar, Literal, Self

import numpy as np

from compasslib import compass
from compasslib.types import Floats

Side = Literal["compass", "reference", "water", "clock"]
Stage = Literal["surroundings", "sensor", "readout", "clock"]

HOUR_S, DAY_S, YEAR_S = 3600.0, 86400.0, 365.25 * 86400.0
USUAL_DEG = 4.0  # turn of the heading, rms, that an effect usually makes where its physics sets no size
READINGS = ("mooring", "platform", "swing", "magnetometer", "two_heads")  # recordings of a compass


@dataclass(frozen=True)
class Scene:
    """In what a recording was made, sample by sample."""

    time_s: Floats  # (n,)
    horizontal_nT: Floats  # (n,) earth's field
    vertical_nT: Floats  # (n,) down positive
    pitch_deg: Floats  # (n,) forward up
    roll_deg: Floats  # (n,) starboard down
    begin_s: float  # drifts count from here
    departures: Mapping[str, Floats] = field(default_factory=dict)  # (n,) covariates minus their references

    def __len__(self) -> int:
        return len(self.time_s)

    @cached_property
    def levelling(self) -> Floats:
        """What turns the body level at each sample, (n, 3, 3)."""
        return compass.levelling(np.nan_to_num(self.pitch_deg), np.nan_to_num(self.roll_deg))

    @property
    def years(self) -> Floats:
        """Years since the beginning, (n,)."""
        return (self.time_s - self.begin_s) / YEAR_S

    def since(self, date_s: float) -> Floats:
        """Step from 0 to 1 at a date, UTC seconds since 1970, (n,)."""
        return np.asarray(self.time_s >= date_s, dtype=float)


def parameter(unit: str, meaning: str, step: float, *, usual: float = np.inf) -> Any:
    """Declare a parameter that is 0 where the effect is absent.

    Args:
        step: a change that turns the heading by very roughly a degree, for differences.
        usual: standard deviation of its prior; where absent that of a turn of some degrees in the record.
    """
    described = {"unit": unit, "meaning": meaning, "step": step, "usual": usual}
    return field(default=0.0, metadata=described)


def date_parameter() -> Any:
    """Declare a date that is searched for and not fitted; without effect by itself."""
    return field(default=0.0, metadata={"unit": "s", "meaning": "UTC seconds since 1970 of the change", "step": 0.0})


def place_parameter(unit: str) -> Any:
    """Declare a place along a covariate that is searched for and not fitted, as a date is."""
    return field(default=0.0, metadata={"unit": unit, "meaning": "place that was looked for", "step": 0.0})


@dataclass(frozen=True)
class Effect(ABC):
    """One effect; its fields are parameters, its defaults mean that it is absent."""

    name: ClassVar[str]
    side: ClassVar[Side] = "compass"
    stage: ClassVar[Stage] = "surroundings"
    acts_on: ClassVar[Literal["field", "north", "reading", "water", "velocity", "time"]] = "field"
    literature: ClassVar[str]
    needs: ClassVar[tuple[str, ...]] = ()  # covariates without which it cannot be tested
    recordings: ClassVar[tuple[str, ...]] = ("mooring",)  # whose search tests it
    driver: ClassVar[str] = "time"  # on what its size depends; empty where it is constant
    words: ClassVar[str] = ""  # its physics in words, of all forms of an effect on the first
    shows_along: ClassVar[tuple[str, ...]] = ()  # covariates along which it shows, on the first form; empty: time
    separated_by: ClassVar[Mapping[str, str]] = {}  # by the name of another effect: what observation separates the two
    detector: ClassVar[str] = ""  # what finds it apart from the search: a comparison that needs no forward model
    instrument: ClassVar[bool] = False  # whether it is of the instrument itself, the same in every record of it
    # Whether what it needs is there only where it acts: only its size is asked for.
    always_present: ClassVar[bool] = False

    @abstractmethod
    def apply(self, x: Floats, scene: Scene) -> Floats:
        """Apply the effect to what it acts on.

        Args:
            x: field in the body frame, (n, 3) nT; else direction of north, reading or direction of the water's veer,
                (n,) degrees; velocity of the water a ship swims in, (n, 2) m/s; for a clock its error, (n,) seconds.
        """

    def invert(self, reading_deg: Floats, scene: Scene) -> Floats:
        """Remove the effect from a reading, (n,) degrees; here for effects that add the same to any reading."""
        return reading_deg - self.apply(np.zeros_like(reading_deg), scene)

    @classmethod
    def fitted(cls) -> tuple[str, ...]:
        """List the names of the fitted parameters, dates left out."""
        return tuple(f.name for f in fields(cls) if f.metadata["step"])

    @classmethod
    def steps(cls) -> Floats:
        """Give a change of each fitted parameter that turns the heading by very roughly a degree."""
        return np.array([f.metadata["step"] for f in fields(cls) if f.metadata["step"]])

    @classmethod
    def expected(cls) -> Floats:
        """Give the prior precision about 0 of each fitted parameter, 0 for most."""
        return np.array([f.metadata["usual"] for f in fields(cls) if f.metadata["step"]]) ** -2.0

    @classmethod
    def units(cls) -> tuple[str, ...]:
        return tuple(f.metadata["unit"] for f in fields(cls) if f.metadata["step"])

    @classmethod
    def dated(cls) -> bool:
        """Return whether the effect has a date."""
        return any(f.name == "date_s" for f in fields(cls))

    @property
    def date(self) -> float:
        """The date of a term that has one, UTC seconds since 1970; else 0."""
        return float(getattr(self, "date_s", 0.0))

    @property
    def possible(self) -> bool:
        """Whether such a compass can be: a reading has one heading, and none precedes it. No size is excluded else."""
        return True

    @property
    def values(self) -> Floats:
        """The fitted parameters' values."""
        return np.array([getattr(self, name) for name in self.fitted()])

    def at(self, values: Floats) -> Self:
        """Replace the values of the fitted parameters."""
        return replace(self, **dict(zip(self.fitted(), np.asarray(values, dtype=float).tolist(), strict=True)))


@dataclass(frozen=True)
class Proportional(Effect):
    """An effect that adds each parameter times the departure of a covariate, in the order of what it needs."""

    def apply(self, x: Floats, scene: Scene) -> Floats:
        """Add each parameter times its departure."""
        each = zip(self.fitted(), self.needs, strict=True)
        return x + sum(getattr(self, factor) * scene.departures[name] for factor, name in each)


@dataclass(frozen=True)
class OfReading(Effect):
    """An effect of the readout, which acts on the reading."""

    stage = "readout"
    acts_on = "reading"


def parameter_slices(terms: Iterable[Effect | type[Effect]], first: int = 0) -> list[slice]:
    """Locate the fitted parameters of each term among those of all, ``first`` others before them."""
    ends = np.cumsum([first, *(len(term.fitted()) for term in terms)])
    return [slice(int(a), int(b)) for a, b in itertools.pairwise(ends)]


def horizontal_field(forward: Floats, starboard: Floats) -> Floats:
    """Build a field in the body's horizontal plane, (n, 3), of its parts forward and to starboard, (n,) each."""
    return np.stack([forward, starboard, np.zeros_like(forward)], axis=-1)


SHORT_RECORDINGS = ("platform", "swing", "magnetometer", "two_heads")


def elapsed_share(scene: Scene) -> Floats:
    """Compute the share of the record that is over, (n,)."""
    return (scene.time_s - scene.time_s[0]) / max(float(np.ptp(scene.time_s)), 1e-9)


@dataclass(frozen=True)
class TurningScene(Scene):
    """A scene that knows how the instrument turns between its samples."""

    turned: Callable[[float], Floats] | None = None  # seconds ahead -> change of the heading until then, (n,) degrees


def turning_scene(scene: Scene, turned: Callable[[float], Floats]) -> TurningScene:
    """Add the turns of its instrument to a scene: see ``TurningScene.turned``."""
    return TurningScene(**vars(scene), turned=turned)
