"""The constant between two instruments, and the configuration errors and turned axes that it may come from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from compasslib import angles, earthfield
from compasslib.deviation.exact import constant_sigmas, fit_exact
from compasslib.deviation.likelihood import normal_density
from compasslib.deviation.model import (
    ALIGNMENT_SIGMA_DEG,
    CONSTANT_SIGMA_DEG,
    MIN_PAIRS,
    DeviationFit,
    heading_residual,
)
from compasslib.records import EarthField, Pairs
from compasslib.statistics.noise import effective_sample_size

LEAST_DEG, LEAST_SIGMAS = 5.0, 4.0  # smaller constants are not told
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
    "equal to the {:+.1f}° that were subtracted from the directions of {} (heading bias EB, declination_applied), "
    "which may not hold them (declination_applied: 0 keeps them)"
)
BACKWARDS = "half a turn: the instrument is mounted backwards, or both components of one instrument have the other sign"
TURNED = (
    "more than mountings and iron explain: the axes of a processed file may be rotated, or the mount turned; check the "
    "directions of both instruments, declination, longitude, direction_reference and declination_applied"
)


@dataclass(frozen=True)
class ConstantOffset:
    """Constant direction offset of a fit, and the configuration error that explains it, if any."""

    angle_deg: float
    sigma_deg: float
    effect: str = ""  # declination_error or mounting_offset; empty if no mistake explains it
    cause: str = ""
    probability: float = 0.0  # posterior of the effect, against an ordinary constant and one of any other cause
    between_instruments: bool = True  # else common to both, relative to the model of the earth's field

    @property
    def text(self) -> str:
        """Description for the report; empty if the constant is small or not significant."""
        if not self.between_instruments:
            return self.cause
        size = f"the two instruments differ by a constant of {self.angle_deg:+.1f}° (1σ {self.sigma_deg:.1f}°)"
        if self.effect:
            return f"{size}, {self.cause}"
        if abs(self.angle_deg) <= max(LEAST_DEG, LEAST_SIGMAS * self.sigma_deg):
            return ""
        return (
            f"{size}{self.cause and ', '}{self.cause}: a mounting offset or a mistake; check declination, longitude, "
            "direction_reference and declination_applied"
        )


def find_declination_error(field: EarthField) -> ConstantOffset | None:
    """Compare the declination of the metadata with IGRF, by which both err alike; None without a known mistake.

    The crustal field changes the declination at sea by 0.4 to 2° (IGRF), with a margin by 5°.
    """
    stated, model = float(np.mean(field.declination_deg)), float(np.mean(field.model_declination_deg))
    size, mistake = float(angles.difference(stated, model)), earthfield.recognize_mistake(stated, model)
    if min(abs(size), abs(stated)) <= 5.0 or not mistake:  # near 0 may be intended: magnetic north throughout
        return None
    cause = (
        f"the declination of the metadata is {size:+.1f}° off IGRF ({model:+.1f}°){mistake}: it is probably wrong, and "
        "so are all corrected directions"
    )
    return ConstantOffset(size, 1.0, "declination_error", cause, 0.99, between_instruments=False)


def find_constant_offset(
    fit: DeviationFit, pairs: Pairs, declination_deg: float, heading_bias_deg: Mapping[str, float] | None = None
) -> ConstantOffset | None:
    """Compare the constant between the instruments with the angles of mistakes, such as a heading bias EB.

    Args:
        heading_bias_deg: by instrument, the heading bias EB that was subtracted from its directions.
    """
    measured = _measured(fit, pairs)
    if measured is None:
        return None
    angle, sigma = measured
    if abs(angle) > max(LEAST_DEG, LEAST_SIGMAS * sigma) and not fit.known_beforehand:
        shown = constant_sigmas(pairs, fit if fit.method == "exact" else fit_exact(pairs))
        sigma = max(sigma, abs(angle) / max(shown, 0.1))
    return question_constant(angle, sigma, declination_deg, heading_bias_deg or {})


def question_constant(
    angle_deg: float, sigma_deg: float, declination_deg: float, heading_bias_deg: Mapping[str, float]
) -> ConstantOffset:
    """Question a constant above 12 degrees by twice its standard error, and compare any with the angles of mistakes.

    12 degrees are three standard deviations of mountings: 0.8 % of sound moorings have more. Angles of mistakes within
    2° of ±6° have 27 % of sound moorings, of ±12° 4 %.
    """
    mistakes = [
        ("declination_error", cause.format(declination_deg), n * declination_deg) for n, cause in DECLINATION.items()
    ]
    for name, bias in heading_bias_deg.items():
        mistakes += [("declination_error", BIAS.format(bias, name), angle) for angle in (bias, -bias) if bias]
    mistakes.append(("mounting_offset", BACKWARDS, 180.0))
    off = np.array([float(angles.wrap180(angle_deg - mistake)) for _, _, mistake in mistakes])
    density = normal_density(off, sigma_deg) / len(mistakes)
    near = [k for k in np.argsort(-density) if abs(off[k]) <= 2.0 * sigma_deg]
    causes = "; or ".join(dict.fromkeys(mistakes[k][1] for k in near))
    if abs(angle_deg) - 2.0 * sigma_deg <= 12.0:
        return ConstantOffset(angle_deg, sigma_deg, cause=causes)
    # Equal prior odds of a mistake (all kinds equally likely), a sound constant and a uniformly distributed angle.
    effect, uniform = mistakes[near[0]][0] if near else "mounting_offset", 1.0 / 360.0
    ordinary = float(np.hypot.reduce([sigma_deg, ALIGNMENT_SIGMA_DEG, CONSTANT_SIGMA_DEG]))
    sound = float(normal_density(angle_deg, ordinary))
    named = sum(density[k] for k in range(len(mistakes)) if mistakes[k][0] == effect) if near else uniform
    probability = float(named / (density.sum() + sound + uniform))
    return ConstantOffset(angle_deg, sigma_deg, effect, causes or TURNED, probability)


def _measured(fit: DeviationFit, pairs: Pairs) -> tuple[float, float] | None:
    """Estimate the constant and its standard error, degrees; of a calibration it is the pairs' mean residual."""
    if not fit.fitted or (fit.method == "von_appen" and fit.folded):  # the series' constant has no meaning then
        return None
    if fit.mistake:  # nor has that of a wrong fit
        return None
    if fit.known_beforehand:
        residual = heading_residual(fit, pairs)
        known = np.isfinite(residual)
        if known.sum() < MIN_PAIRS:
            return None
        n = effective_sample_size(residual[known], pairs.time_s[known])
        current = float(np.sqrt(fit.covariance[0, 0])) / angles.DEGREE
        mean = float(angles.wrap180(angles.mean(residual[known])))
        return mean, float(np.hypot(current, angles.rms(angles.difference(residual[known], mean)) / np.sqrt(n)))
    a, sigma = float(fit.coefficients[0]), float(np.sqrt(fit.covariance[0, 0]))
    if fit.method == "von_appen":
        return float(angles.wrap180(a)), sigma
    return float(angles.wrap180(angles.direction(a, 1.0))), sigma / (1.0 + a**2) / angles.DEGREE
