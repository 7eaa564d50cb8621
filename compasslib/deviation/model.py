"""The fitted deviation as it travels: coefficients with covariance, noise, what can be inverted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from compasslib import angles, compass
from compasslib.deviation import prior as priors
from compasslib.deviation.prior import Prior
from compasslib.records import Pairs
from compasslib.types import Floats

FEWEST_PAIRS = 30
LETTERS = "ABCDE"


def _nothing() -> Floats:
    return np.zeros(0)


@dataclass(frozen=True)
class Noise:
    """Scatter of the observed heading about the compass: a floor, a part that grows as 1/speed, outliers."""

    floor_deg: float = 8.0
    slow_deg_m_s: float = 2.5  # degrees times m/s
    outliers: float = 0.02  # share of pairs whose direction says nothing
    compass_deg: float = 1.5  # noise of the recorded heading itself

    def width_deg(self, upper_speed: Floats, lower_speed: Floats) -> Floats:
        """Return the width for each pair, (n,) degrees: slow water has no direction.

        Args:
            upper_speed: m/s, (n,).
            lower_speed: m/s, (n,).
        """
        slow = self.slow_deg_m_s**2 * (1.0 / upper_speed**2 + 1.0 / lower_speed**2)
        return np.sqrt(self.floor_deg**2 + slow)


@dataclass(frozen=True)
class Fit:
    """A deviation model fitted to one mooring; without coefficients where there was too little to fit."""

    method: str  # von_appen | exact | calibration: the exact compass, calibrated elsewhere
    n_pairs: int
    coefficients: Floats = field(default_factory=_nothing)  # (5,) A..E: degrees for von_appen, dimensionless for exact
    covariance: Floats = field(default_factory=_nothing)  # (5, 5)
    n_effective: float = 0.0
    residual_rms_deg: float = float("nan")
    recorded_range_deg: tuple[float, float] | None = None
    folded: bool = False
    noise: Noise = Noise()  # only the exact fit estimates it
    heeling: float = 0.0  # K, vertical hard iron over the horizontal field; its row of the covariance is the sixth
    dip_ratio: float = 0.0  # Z/H that the tilt was fitted with; 0 for a level model
    heading_density: Floats = field(default_factory=_nothing)  # prior of the correct heading on its cells, sums to 1
    why: str = ""  # the reason, where nothing was fitted
    warnings: tuple[str, ...] = ()  # sentences for the report
    prior: Prior | None = None  # what other records of the same compass told beforehand

    def to_json(self) -> dict[str, Any]:
        """Return deviation.json's content but for the share that is correctable."""
        return {
            "method": self.method,
            "coefficients": dict(zip(LETTERS, self.coefficients.tolist(), strict=True)) if self.fitted else None,
            "unit": "degrees" if self.method == "von_appen" else "1",
            "covariance": self.covariance.tolist() if self.fitted else None,
            "n_pairs": self.n_pairs,
            "n_effective": self.n_effective,
            "residual_rms_deg": self.residual_rms_deg,
            "recorded_range_deg": self.recorded_range_deg,
            "folded": self.folded,
            "noise": vars(self.noise),
            "heeling": self.heeling if self.tilted else None,
            "dip_ratio": self.dip_ratio if self.tilted else None,
            "heading_density": self.heading_density.tolist(),
            "why": self.why,
            "warnings": self.warnings,
            **({} if self.prior is None else {"prior": self.prior.to_json()}),
        }

    @property
    def fitted(self) -> bool:
        """Whether there is anything to correct with."""
        return self.coefficients.size > 0

    @property
    def tilted(self) -> bool:
        """Whether pitch and roll enter."""
        return self.dip_ratio != 0.0


def from_json(content: Mapping[str, Any]) -> Fit:
    """Return the fit that a deviation.json describes."""
    letters, span, rms = content["coefficients"], content["recorded_range_deg"], content["residual_rms_deg"]
    return Fit(
        method=content["method"],
        n_pairs=content["n_pairs"],
        coefficients=np.array([letters[k] for k in LETTERS] if letters else [], dtype=float),
        covariance=np.array(content["covariance"] or [], dtype=float),
        n_effective=content["n_effective"],
        residual_rms_deg=float("nan") if rms is None else rms,
        recorded_range_deg=None if span is None else (span[0], span[1]),
        folded=content["folded"],
        noise=Noise(**content["noise"]),
        heeling=content.get("heeling") or 0.0,
        dip_ratio=content.get("dip_ratio") or 0.0,
        heading_density=np.array(content["heading_density"], dtype=float),
        why=content["why"],
        warnings=tuple(content.get("warnings", ())),
        prior=priors.from_json(content.get("prior")),
    )


def too_few(method: str, n_pairs: int) -> Fit:
    """Return the fit that says there was not enough to fit."""
    why = "no overlapping pairs" if n_pairs == 0 else f"{n_pairs} overlapping pairs, at least {FEWEST_PAIRS} are needed"
    return Fit(method=method, n_pairs=n_pairs, why=why)


def observed_heading(pairs: Pairs) -> Floats:
    """Return the correct heading as the overlap shows it, beta = D_bot - D_top + gamma (von Appen 2015, eq. 2)."""
    return angles.wrap360(observed_deviation(pairs) + pairs.heading_deg)


def observed_deviation(pairs: Pairs) -> Floats:
    """Return the deviation as the overlap shows it, D_bot - D_top in [-180, 180) (von Appen 2015, eq. 3)."""
    lower = angles.direction(pairs.lower_east, pairs.lower_north)
    return angles.difference(lower, angles.direction(pairs.upper_east, pairs.upper_north))


def nearest_root(roots_deg: Floats, observed_deg: Floats) -> Floats:
    """Return of each pair of roots the one nearer to an observed heading, (n,) degrees, NaN without a root.

    Args:
        roots_deg: roots of a recorded heading, (n, 2), NaN where there is none.
        observed_deg: observed headings, (n,).
    """
    off = np.abs(angles.difference(observed_deg[:, None], roots_deg))
    nearer = np.argmin(np.where(np.isfinite(off), off, np.inf), axis=1)
    return roots_deg[np.arange(len(roots_deg)), nearer]


def residual(fit: Fit, pairs: Pairs) -> Floats:
    """Return the observed heading minus the model's, the nearer of two roots, degrees; NaN without a root."""
    roots = compass.inverse(fit.coefficients, pairs.heading_deg)
    observed = observed_heading(pairs)
    return angles.difference(observed, nearest_root(roots, observed))


def speeds(pairs: Pairs) -> tuple[Floats, Floats]:
    """Return the speeds of the upper and the lower water, m/s."""
    return np.hypot(pairs.upper_east, pairs.upper_north), np.hypot(pairs.lower_east, pairs.lower_north)
