"""Faults of the trusted instrument: its own compass, and what its beams make of the water."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from compasslib.core import angles
from compasslib.core.types import Floats
from compasslib.effects.term import Scene, Term, date, parameter


@dataclass(frozen=True)
class OfReference(Term):
    """The trusted directions are turned: what it does stands where a veer of the water would."""

    side: ClassVar = "reference"
    acts_on: ClassVar = "water"
    recordings: ClassVar[tuple[str, ...]] = ("mooring",)


@dataclass(frozen=True)
class ReferenceDeviation(OfReference):
    """The trusted compass has a deviation of its own."""

    name: ClassVar[str] = "reference_deviation"
    literature: ClassVar[str] = "B and C of von Appen 2015, eq. (1), by its own heading; reading minus true"
    needs: ClassVar[tuple[str, ...]] = ("reference_sine", "reference_cosine")

    sine_deg: float = parameter("degrees", "times the sine of the trusted heading", 1.0)
    cosine_deg: float = parameter("degrees", "times its cosine", 1.0)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the veer."""
        sine, cosine = (scene.departures[name] for name in self.needs)
        return x + self.sine_deg * sine + self.cosine_deg * cosine


@dataclass(frozen=True)
class ReferenceSlip(OfReference):
    """The trusted directions are shifted from a date on: its mount slipped, or its iron changed."""

    name: ClassVar[str] = "reference_slip"
    literature: ClassVar[str] = "a step of the trusted directions; clockwise positive"

    offset_deg: float = parameter("degrees", "of the trusted directions after the date", 1.0)
    date_s: float = date()

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the veer."""
        return x + self.offset_deg * scene.since(self.date_s)


@dataclass(frozen=True)
class ReferenceBeams(OfReference):
    """One beam pair of the trusted instrument gives larger velocities than the other."""

    name: ClassVar[str] = "reference_beams"
    literature: ClassVar[str] = "-(gain/2) sin 2(flow - heading), first order; forward over starboard gain less one"
    needs: ClassVar[tuple[str, ...]] = ("reference_flow_sine2",)

    gain: float = parameter("1", "forward over starboard gain of the trusted beams, less one", 0.035)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the veer."""
        return x - self.gain / 2.0 / angles.DEGREE * scene.departures[self.needs[0]]


@dataclass(frozen=True)
class ReferenceBias(OfReference):
    """A constant velocity in its own frame is added to what the trusted instrument measures, as by ringing."""

    name: ClassVar[str] = "reference_bias"
    literature: ClassVar[str] = "(bias/speed) sin(angle of the bias - angle of the flow), first order"
    needs: ClassVar[tuple[str, ...]] = ("reference_flow_sine", "reference_flow_cosine")

    forward_m_s: float = parameter("m/s", "velocity added forward", 0.003)
    starboard_m_s: float = parameter("m/s", "velocity added to starboard", 0.003)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the veer; the departures are sine and cosine of the flow's angle in the body, over the speed."""
        sine, cosine = (scene.departures[name] for name in self.needs)
        return x + (self.starboard_m_s * cosine - self.forward_m_s * sine) / angles.DEGREE
