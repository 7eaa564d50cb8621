"""Three forms of a deviation curve behind one face: one likelihood fits them all, so they compare on equal terms.

The coefficients are dimensionless in every form (radians in the series), so that the same starts and priors serve.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from compasslib import angles, compass
from compasslib.deviation import von_appen
from compasslib.types import Floats

Sides = tuple[Floats, Floats]


class Form(Protocol):
    """A curve between correct heading beta and recorded heading gamma with five coefficients."""

    @property
    def name(self) -> str:
        """Its name in the results."""

    def sides(self, coefficients: Floats, recorded_deg: Floats, heading_deg: Floats) -> Sides:
        """Return what agrees where a recorded heading came from a correct one, (k,) and (f,) degrees."""

    def slopes(self, coefficients: Floats, recorded_deg: Floats, heading_deg: Floats) -> Floats:
        """Return the derivative by the coefficients of the second side less the first, (5, 1 or k, 1 or f) degrees."""


@dataclass(frozen=True)
class Exact:
    """The exact compass, gamma = arg q(beta): any strength of iron (compass.py)."""

    name: str = "exact"

    def sides(self, coefficients: Floats, recorded_deg: Floats, heading_deg: Floats) -> Sides:
        """Return the recorded heading and arg q."""
        return recorded_deg, compass.recorded_heading(coefficients, heading_deg)

    def slopes(self, coefficients: Floats, recorded_deg: Floats, heading_deg: Floats) -> Floats:
        """Return the derivative of arg q."""
        return compass.gradient(coefficients, heading_deg)[:, None, :]


@dataclass(frozen=True)
class SeriesInCorrect:
    """Smith's series in the correct heading, gamma = beta - Delta(beta) (von Appen 2015, eq. 1)."""

    name: str = "series_in_correct"

    def sides(self, coefficients: Floats, recorded_deg: Floats, heading_deg: Floats) -> Sides:
        """Return the recorded heading, and the correct one minus the deviation there."""
        return recorded_deg, heading_deg - von_appen.predict(coefficients, heading_deg) / angles.DEGREE

    def slopes(self, coefficients: Floats, recorded_deg: Floats, heading_deg: Floats) -> Floats:
        """Return minus the series' columns."""
        return -von_appen.design(heading_deg).T[:, None, :] / angles.DEGREE


@dataclass(frozen=True)
class SeriesInRecorded:
    """The same series in the recorded heading, beta = gamma + Delta(gamma) (Moncunill 2023, eq. 1; Le Menn 2023, 5)."""

    name: str = "series_in_recorded"

    def sides(self, coefficients: Floats, recorded_deg: Floats, heading_deg: Floats) -> Sides:
        """Return the recorded heading plus the deviation there, and the correct one."""
        return recorded_deg + von_appen.predict(coefficients, recorded_deg) / angles.DEGREE, heading_deg

    def slopes(self, coefficients: Floats, recorded_deg: Floats, heading_deg: Floats) -> Floats:
        """Return minus the series' columns."""
        return -von_appen.design(recorded_deg).T[:, :, None] / angles.DEGREE


EXACT = Exact()
FORMS: tuple[Form, ...] = (EXACT, SeriesInCorrect(), SeriesInRecorded())
