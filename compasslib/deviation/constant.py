"""A constant between the instruments that a mistake in the configuration would explain."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from compasslib import angles
from compasslib.deviation import model
from compasslib.deviation.model import Fit
from compasslib.records import Pairs
from compasslib.statistics import autocorrelation

LEAST_DEG, LEAST_SIGMAS = 5.0, 4.0  # a smaller constant is not questioned
NEAR_SIGMAS = 2.0  # within which it equals the angle of a mistake
ORDINARY_DEG = 4.0  # standard deviation of the constants of correctly configured moorings: mounts and mean veers
LEAST_ODDS = 10.0  # of the mistake against an ordinary constant
LARGE_DEG = 10.0  # a constant beyond this is mentioned even where no mistake explains it
DECLINATION = {
    1: "equal to the declination ({:+.1f}°): the directions of the reference hold it twice, being true already "
    "(direction_reference, declination_applied), or it was subtracted from affected headings that never held it "
    "(declination_applied)",
    -1: "equal to minus the declination ({:+.1f}°): the directions of the reference lack it, being magnetic "
    "(direction_reference, declination_applied), or the affected headings hold it already (declination_applied)",
    2: "equal to twice the declination ({:+.1f}°): it was applied with the wrong sign (declination_applied, longitude)",
    -2: "equal to minus twice the declination ({:+.1f}°): it was applied with the wrong sign (declination_applied, "
    "longitude)",
}
BIAS = (
    "equal to the heading bias EB of {:+.1f}° that was subtracted from the directions of {}, which may not hold it "
    "(declination_applied: 0 keeps them)"
)
BACKWARDS = "half a turn: the instrument is mounted backwards, or both components of one instrument have the other sign"


@dataclass(frozen=True)
class Constant:
    """The constant of a fit, and the mistake in the configuration that explains it, if one does."""

    angle_deg: float
    sigma_deg: float
    effect: str = ""  # declination_error or mounting_offset; empty where no mistake explains it
    cause: str = ""
    probability: float = 0.0  # of the mistake, against an ordinary constant at even prior odds

    @property
    def text(self) -> str:
        """What is known of it, in words; empty where it is as small as those of correct moorings."""
        size = f"the two instruments differ by a constant of {self.angle_deg:+.1f}° (1σ {self.sigma_deg:.1f}°)"
        if self.effect:
            return f"{size}, {self.cause}"
        if abs(self.angle_deg) > LARGE_DEG and abs(self.angle_deg) > NEAR_SIGMAS * self.sigma_deg:
            return (
                f"{size}: a mounting offset or a mistake; check declination, longitude, direction_reference and "
                "declination_applied"
            )
        return ""


def of_fit(
    fit: Fit, pairs: Pairs, declination_deg: float, heading_bias_deg: Mapping[str, float] | None = None
) -> Constant | None:
    """Compare the constant between the instruments with the angles that mistakes in the configuration leave.

    Args:
        fit: the fitted compass; of a calibration made elsewhere the constant is the mean residual of the pairs.
        declination_deg: mean declination of the deployment, east positive.
        heading_bias_deg: by instrument, the heading bias EB that was subtracted from its directions.

    Returns:
        The constant; None where the fit has none.
    """
    measured = _measured(fit, pairs)
    if measured is None:
        return None
    angle, sigma = measured
    if abs(angle) <= max(LEAST_DEG, LEAST_SIGMAS * sigma):
        return Constant(angle, sigma)
    questioned = []
    for effect, cause, mistake in _mistakes(declination_deg, heading_bias_deg or {}):
        off = float(angles.wrap180(angle - mistake))
        log_odds = _log_density(off, sigma) - _log_density(angle, np.hypot(sigma, ORDINARY_DEG))
        if abs(off) <= NEAR_SIGMAS * sigma and log_odds > np.log(LEAST_ODDS):
            questioned.append(Constant(angle, sigma, effect, cause, float(1.0 / (1.0 + np.exp(-log_odds)))))
    if not questioned:
        return Constant(angle, sigma)
    first = max(questioned, key=lambda constant: constant.probability)
    causes = "; or ".join(dict.fromkeys(constant.cause for constant in questioned))
    return Constant(angle, sigma, first.effect, causes, first.probability)


def _measured(fit: Fit, pairs: Pairs) -> tuple[float, float] | None:
    """Return the constant and its standard error, degrees."""
    if not fit.fitted or (fit.method == "von_appen" and fit.folded):  # the series' constant means nothing there
        return None
    if fit.method == "calibration":
        residual = model.residual(fit, pairs)
        known = np.isfinite(residual)
        if known.sum() < model.FEWEST_PAIRS:
            return None
        n = autocorrelation.effective_number(residual[known], pairs.time_s[known])
        own = float(np.sqrt(fit.covariance[0, 0])) / angles.DEGREE
        mean = float(angles.wrap180(angles.mean(residual[known])))
        return mean, float(np.hypot(own, angles.rms(residual[known]) / np.sqrt(n)))
    a, sigma = float(fit.coefficients[0]), float(np.sqrt(fit.covariance[0, 0]))
    if fit.method == "von_appen":
        return float(angles.wrap180(a)), sigma
    return float(angles.wrap180(angles.direction(a, 1.0))), sigma / angles.DEGREE


def _mistakes(declination_deg: float, heading_bias_deg: Mapping[str, float]) -> Iterator[tuple[str, str, float]]:
    """Give the effect, the cause in words and the angle that each mistake leaves, degrees."""
    for times, cause in DECLINATION.items():
        yield "declination_error", cause.format(declination_deg), times * declination_deg
    for name, bias in heading_bias_deg.items():
        if bias:
            yield from (("declination_error", BIAS.format(bias, name), angle) for angle in (bias, -bias))
    yield "mounting_offset", BACKWARDS, 180.0


def _log_density(off_deg: float, sigma_deg: float) -> float:
    """Return the logarithm of a normal density, without the constant that all share."""
    return -0.5 * (off_deg / sigma_deg) ** 2 - float(np.log(sigma_deg))
