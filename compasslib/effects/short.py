"""Terms as short recordings need them: drifts over the record, not over a year, and what only a magnetometer shows."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from compasslib.effects.term import Scene, Term, horizontal, parameter
from compasslib.types import Floats

SHORT = ("platform", "swing", "magnetometer", "two_heads")


def elapsed(scene: Scene) -> Floats:
    """Return the share of the record that is over, (n,)."""
    return (scene.time_s - scene.time_s[0]) / max(float(np.ptp(scene.time_s)), 1e-9)


@dataclass(frozen=True)
class Moving(Scene):
    """A scene that knows how the instrument turns between its samples."""

    turned: Callable[[float], Floats] | None = None  # seconds ahead -> change of the heading until then, (n,) degrees


def moving(scene: Scene, turned: Callable[[float], Floats]) -> Moving:
    """Return a scene with the turns of its instrument.

    Args:
        turned: change of the heading until some seconds ahead, (n,) degrees.
    """
    return Moving(**vars(scene), turned=turned)


@dataclass(frozen=True)
class Delay(Term):
    """The reading is the heading of some time before, exactly: quick swings are no straight lines."""

    name: ClassVar[str] = "compass_lag"
    recordings: ClassVar[tuple[str, ...]] = ("magnetometer", "two_heads")
    stage: ClassVar = "readout"
    acts_on: ClassVar = "reading"
    literature: ClassVar[str] = "a delay; for slow turns its first order, reading minus lag times the rate of turn"

    lag_s: float = parameter("s", "time by which the reading is late", 0.1, least=-60.0, most=60.0)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the late reading."""
        assert isinstance(scene, Moving) and scene.turned is not None
        return x + scene.turned(-self.lag_s)


@dataclass(frozen=True)
class Drift(Term):
    """The reading grows along the record."""

    name: ClassVar[str] = "compass_drift"
    recordings: ClassVar[tuple[str, ...]] = SHORT
    stage: ClassVar = "readout"
    acts_on: ClassVar = "reading"
    literature: ClassVar[str] = "a trend of A in von Appen 2015, eq. (1); reading clockwise positive"

    deg_record: float = parameter("degrees over the record", "drift of the reading", 1.0)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the reading with the drift."""
        return x + self.deg_record * elapsed(scene)


@dataclass(frozen=True)
class IronDrift(Term):
    """A horizontal field in the body frame grows along the record."""

    name: ClassVar[str] = "hard_iron_drift"
    recordings: ClassVar[tuple[str, ...]] = SHORT
    literature: ClassVar[str] = "Poisson's P and Q, a trend in time; forward and starboard positive"

    b_x_nT: float = parameter("nT over the record", "change forward", 200.0)
    b_y_nT: float = parameter("nT over the record", "change to starboard", 200.0)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the field with the drift."""
        return x + horizontal(self.b_x_nT * elapsed(scene), self.b_y_nT * elapsed(scene))


@dataclass(frozen=True)
class MountingOffset(Term):
    """The heading is counted from another direction than the axes."""

    name: ClassVar[str] = "mounting_offset"
    words: ClassVar[str] = "the heading is turned by a constant from the magnetometer's axes"
    shows_along: ClassVar[tuple[str, ...]] = ("heading",)
    told_from: ClassVar[Mapping[str, str]] = {
        "tilt_uncompensated": "logged tilts",
        "declination_error": "the declination that the instrument was set to",
    }
    recordings: ClassVar[tuple[str, ...]] = ("magnetometer",)
    stage: ClassVar = "readout"
    acts_on: ClassVar = "reading"
    literature: ClassVar[str] = "A of von Appen 2015, eq. (1); clockwise positive"

    offset_deg: float = parameter("degrees", "recorded heading minus that of the axes", 1.0)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the reading with the offset."""
        return x + self.offset_deg


@dataclass(frozen=True)
class LevelIron(Term):
    """Hard iron as a level turn shows it: two components."""

    name: ClassVar[str] = "hard_iron"
    recordings: ClassVar[tuple[str, ...]] = ("magnetometer",)
    literature: ClassVar[str] = "Poisson's P and Q; Le Menn et al. 2023, eq. (1); forward, starboard positive"

    b_x_nT: float = parameter("nT", "field forward", 200.0)
    b_y_nT: float = parameter("nT", "field to starboard", 200.0)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the field with the iron's added."""
        return x + np.array([self.b_x_nT, self.b_y_nT, 0.0])


@dataclass(frozen=True)
class LevelSoftIron(Term):
    """Soft iron as the modulus of a level turn shows it: what stretches the circle to an ellipse."""

    name: ClassVar[str] = "soft_iron"
    words: ClassVar[str] = "a part that the earth's field magnetises distorts it (soft iron)"
    shows_along: ClassVar[tuple[str, ...]] = ("heading",)
    told_from: ClassVar[Mapping[str, str]] = {
        "tilt_uncompensated": "logged tilts: a tilt that goes with the heading stretches the circle"
    }
    recordings: ClassVar[tuple[str, ...]] = ("magnetometer",)
    literature: ClassVar[str] = "(a - e)/2 and (d + b)/2 of Poisson; Le Menn et al. 2023, eq. (1)"

    stretch: float = parameter("1", "stretch, (a - e)/2, forward against starboard", 0.02, least=-0.8, most=0.8)
    shear: float = parameter("1", "shear, (d + b)/2", 0.02, least=-0.8, most=0.8)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the field with the induced one added."""
        rows = [[self.stretch, self.shear, 0.0], [self.shear, -self.stretch, 0.0], [0.0, 0.0, 0.0]]
        return x + x @ np.array(rows)


@dataclass(frozen=True)
class SoftIronInSpace(Term):
    """Soft iron as the modulus over all orientations shows it: a symmetric matrix whose trace is the scale."""

    name: ClassVar[str] = "soft_iron"
    recordings: ClassVar[tuple[str, ...]] = ("magnetometer",)
    literature: ClassVar[str] = "Le Menn et al. 2023, eqs. (1), (2): an ellipsoid shows the symmetric part alone"

    stretch: float = parameter("1", "stretch, (xx - yy)/2, forward against starboard", 0.02, least=-0.8, most=0.8)
    vertical: float = parameter(
        "1", "vertical stretch, zz minus the mean of xx and yy, over 1.5", 0.02, least=-0.8, most=0.8
    )
    xy: float = parameter("1", "shear between forward and starboard", 0.02, least=-0.8, most=0.8)
    xz: float = parameter("1", "shear between forward and down", 0.02, least=-0.8, most=0.8)
    yz: float = parameter("1", "shear between starboard and down", 0.02, least=-0.8, most=0.8)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the field with the induced one added."""
        a, v = self.stretch, self.vertical
        rows = [[a - v / 2.0, self.xy, self.xz], [self.xy, -a - v / 2.0, self.yz], [self.xz, self.yz, v]]
        return x + x @ np.array(rows)


@dataclass(frozen=True)
class Levelled(Term):
    """The recorded heading is levelled by the tilts, the simulated one is not."""

    name: ClassVar[str] = "tilt_uncompensated"
    recordings: ClassVar[tuple[str, ...]] = ("magnetometer",)
    stage: ClassVar = "sensor"
    words: ClassVar[str] = "the recorded heading is compensated for tilt, the simulated one is not"
    literature: ClassVar[str] = "physics page, section 4: n = T m instead of m; 1 means that all levelling was left out"

    share: float = parameter("1", "share of the levelling that the simulation lacks", 0.05, least=0.5, most=1.5)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the field, partly levelled."""
        return (1.0 - self.share) * x + self.share * np.einsum("nij,nj->ni", scene.levelling, x)
