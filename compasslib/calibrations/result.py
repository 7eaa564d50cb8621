"""What a calibration leaves, of whatever kind: coefficients, table, budget of uncertainty, what it could not tell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from compasslib.types import Floats

LETTERS = "ABCDE"
TOO_EXACT_DEG = 1e-4  # rms that no reading of an instrument leaves
COVERAGE_FACTOR = 2.0  # k of an expanded uncertainty (Le Menn et al. 2023, section 2)


def _nothing() -> Floats:
    return np.zeros(0)


@dataclass(frozen=True)
class Source:
    """One line of an uncertainty budget."""

    name: str
    standard_deg: float  # standard uncertainty, degrees
    how: str  # where it comes from: the distribution assumed or the statistics made


@dataclass(frozen=True)
class DeviationTable:
    """Deviation by recorded heading."""

    heading_deg: Floats  # (m,) recorded, magnetic
    deviation_deg: Floats  # (m,) to be added to the recorded heading
    sigma_deg: Floats  # (m,) one standard deviation


@dataclass(frozen=True)
class Calibration:
    """The result of one calibration; without coefficients where there was too little, and ``why`` then says so."""

    kind: str  # platform | swing | magnetometer | declination | two_heads
    model: str  # the curve that was chosen
    n: int  # observations used
    coverage: int  # occupied sectors of 10 degrees of the recorded heading, of 36
    coefficients: Floats = field(default_factory=_nothing)  # (5,) A..E, degrees, series in the recorded heading
    covariance: Floats = field(default_factory=_nothing)  # (5, 5)
    exact: Floats = field(default_factory=_nothing)  # (5,) A..E of the exact compass, dimensionless
    exact_covariance: Floats = field(default_factory=_nothing)  # (5, 5)
    residual_rms_deg: float = float("nan")
    sources: tuple[Source, ...] = ()
    table: DeviationTable | None = None
    points: Mapping[str, Floats] = field(default_factory=dict)  # columns of what was observed, (n,) each
    details: Mapping[str, Any] = field(default_factory=dict)  # what only this kind has, ready for JSON
    why: str = ""
    warnings: tuple[str, ...] = ()


def too_exact(residual_rms_deg: float | None) -> tuple[str, ...]:
    """Return a warning where a curve leaves nothing of the readings, as where one column was computed from the other.

    Args:
        residual_rms_deg: what it leaves, None or NaN where there is no curve.
    """
    if residual_rms_deg is None or not residual_rms_deg < TOO_EXACT_DEG:
        return ()
    return (
        "the curve leaves nothing of the readings, which no instrument does: one column may have been computed from "
        "the other; the stated uncertainty holds no error of a reading",
    )
