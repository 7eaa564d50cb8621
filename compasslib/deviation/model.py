"""The fitted deviation: coefficients with covariance, noise, prior, and their transfer to another place.

B and C are (P + cZ)/(lambda H) and (Q + fZ)/(lambda H): the hard iron's part P, Q varies as 1/H, the part cZ, fZ
induced by the vertical field as tan I = Z/H. A, D and E result from horizontal induction and do not change. One place
yields only the sum; two of different tan I separate the parts (physics page, section 3; von Appen 2015, introduction).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from compasslib import angles, compass, earthfield
from compasslib.records import EarthField, Pairs, ReferenceCompass
from compasslib.statistics.resampling import NORMAL_95
from compasslib.types import Floats

MIN_PAIRS = 30
MAX_SOFT_IRON = 0.3  # magnitude of (D, E); spheres and frames induce a few per cent
LETTERS = "ABCDE"
UNKNOWN_COVARIANCE = (
    "the coefficients were given without their covariance, so that the uncertainty of all headings is unknown and they "
    "are flagged 3; write fit.covariance where it is known"
)


@dataclass(frozen=True)
class ScatterNoise:
    """Scatter of the observed heading about the compass: a floor, a part that grows as 1/speed, outliers."""

    floor_deg: float = 8.0  #: degrees, one standard deviation in fast water
    slow_deg_m_s: float = 2.5  #: degrees times m/s
    outliers: float = 0.02  #: share of pairs whose direction is random
    compass_deg: float = 1.5  #: degrees, noise of the recorded heading itself

    def width_deg(self, upper_speed: Floats, lower_speed: Floats) -> Floats:
        """Compute the width for each pair, (n,) degrees, which grows as the water becomes slow."""
        slow = self.slow_deg_m_s**2 * (1.0 / upper_speed**2 + 1.0 / lower_speed**2)
        return np.sqrt(self.floor_deg**2 + slow)


@dataclass(frozen=True)
class ReferenceErrors:
    """Errors of the reference's compass and of the mean veer in a fit to the reference's directions."""

    constant_deg: float  #: standard deviation of the reference's constant, from magnetic north
    veer_deg: float  #: of the mean veer between the depths
    iron: Floats  #: (5, 2) change of the coefficients by one standard deviation of the reference's B and of its C
    magnetic: bool  #: whether its directions are from magnetic north
    veer_included: bool  #: whether the covariance of the fit includes the mean veer
    share: float = 1.0  #: probability that the compass has a deviation, and follows the reference


@dataclass(frozen=True)
class DeviationFit:
    """A deviation model fitted to one mooring; without coefficients if there were too few pairs."""

    method: str  #: von_appen | exact (fitted); calibration | coefficients (exact compass known beforehand)
    n_pairs: int  #: number of pairs
    coefficients: Floats = field(
        default_factory=lambda: np.zeros(0)
    )  #: (5,) A..E, degrees for von_appen, dimensionless for exact
    covariance: Floats = field(default_factory=lambda: np.zeros(0))  #: (5, 5) of A..E
    n_effective: float = 0.0  #: effective number of independent pairs, allowing for autocorrelated residuals
    residual_rms_deg: float = float("nan")  #: degrees, of the pairs
    #: range of headings that the compass can record, clockwise, degrees; the second may exceed 360; None if unknown
    recorded_range_deg: tuple[float, float] | None = None
    folded: bool = False  #: whether a recorded heading can have two correct ones
    noise: ScatterNoise = ScatterNoise()  #: estimated by the exact fit only
    heading_density: Floats = field(
        default_factory=lambda: np.zeros(0)
    )  #: prior of the correct heading on its cells, sums to 1
    why: str = ""  #: the reason why nothing was fitted, else empty
    warnings: tuple[str, ...] = ()  #: sentences for the report
    fixed: bool = False  #: whether the coefficients were given and are not fitted to pairs
    covariance_known: bool = True  #: if False, the covariance is a wide placeholder
    prior: CoefficientPrior | None = None  #: prior from other records of the same compass
    reference: ReferenceErrors | None = None  #: errors of the reference; None if not considered, or none was used
    iron_declared: bool = False  #: whether the owner declares a sphere or the distance of its iron
    mistake: str = ""  #: mistake in the directions of an instrument that makes the fit wrong; empty without one

    def to_json(self) -> dict[str, Any]:
        """Convert to the content of deviation.json; some values are left out where they are the usual ones."""
        usual = {"fixed": False, "iron_declared": False, "covariance_known": True, "prior": None, "mistake": ""}
        stated = {name: value for name, value in vars(self).items() if name not in usual or value != usual[name]}
        parts = {
            name: part and listed(part) for name, part in stated.items() if name in ("noise", "prior", "reference")
        }
        letters = dict(zip(LETTERS, self.coefficients.tolist(), strict=True)) if self.fitted else None
        unit, covariance = "degrees" if self.method == "von_appen" else "1", self.covariance.tolist()
        density = self.heading_density.tolist()
        stated |= {"coefficients": letters, "unit": unit, "covariance": covariance or None, "heading_density": density}
        return stated | parts

    @property
    def fitted(self) -> bool:
        """Whether there are coefficients to correct with."""
        return self.coefficients.size > 0

    @property
    def has_implausible_iron(self) -> bool:
        """Whether the soft iron (D, E) of an exact fit exceeds that of any instrument by twice its standard error."""
        if self.method != "exact" or not self.fitted:
            return False
        soft = self.coefficients[3:5]
        size = float(np.hypot(*soft))
        sigma = float(np.sqrt(soft @ self.covariance[3:5, 3:5] @ soft)) / max(size, 1e-12)
        return size - 2.0 * sigma >= MAX_SOFT_IRON

    @property
    def known_beforehand(self) -> bool:
        """Whether it is an exact compass known beforehand, which the pairs check but do not change."""
        return self.method in ("calibration", "coefficients")


def listed(part: Any) -> dict[str, Any]:
    """List the fields of a dataclass, with arrays as lists."""
    return {name: x.tolist() if isinstance(x, np.ndarray) else x for name, x in vars(part).items()}


def fit_from_json(content: Mapping[str, Any]) -> DeviationFit:
    """Build a fit from the content of deviation.json."""
    stated = {part.name: content[part.name] for part in fields(DeviationFit) if part.name in content}
    letters, span, rms = content["coefficients"], content["recorded_range_deg"], content["residual_rms_deg"]
    reference = content.get("reference")
    stated |= {
        "coefficients": np.array([letters[k] for k in LETTERS] if letters else [], dtype=float),
        "covariance": np.array(content["covariance"] or [], dtype=float),
        "residual_rms_deg": float("nan") if rms is None else rms,
        "recorded_range_deg": None if span is None else (span[0], span[1]),
        "noise": ScatterNoise(**content["noise"]),
        "heading_density": np.array(content["heading_density"], dtype=float),
        "warnings": tuple(content.get("warnings", ())),
        "prior": prior_from_json(content.get("prior")),
        "reference": reference and ReferenceErrors(**reference | {"iron": np.array(reference["iron"])}),
    }
    return DeviationFit(**stated)


def unfitted(method: str, n_pairs: int) -> DeviationFit:
    """Make a fit without coefficients that states that there are too few pairs."""
    why = "no overlapping pairs" if n_pairs == 0 else f"{n_pairs} overlapping pairs, at least {MIN_PAIRS} are needed"
    return DeviationFit(method=method, n_pairs=n_pairs, why=why)


def observed_heading(pairs: Pairs) -> Floats:
    """Compute the correct heading observed by the pairs, beta = D_bot - D_top + gamma (von Appen 2015, eq. 2)."""
    return angles.wrap360(observed_deviation(pairs) + pairs.heading_deg)


def observed_deviation(pairs: Pairs) -> Floats:
    """Compute the deviation observed by the pairs, D_bot - D_top in [-180, 180) degrees (von Appen 2015, eq. 3)."""
    lower = angles.direction(pairs.lower_east, pairs.lower_north)
    return angles.difference(lower, angles.direction(pairs.upper_east, pairs.upper_north))


def nearest_root(roots_deg: Floats, observed_deg: Floats) -> Floats:
    """Select the root nearer to an observed heading, (n,) degrees, of (n, 2); NaN without a root."""
    off = np.abs(angles.difference(observed_deg[:, None], roots_deg))
    nearer = np.argmin(np.where(np.isfinite(off), off, np.inf), axis=1)
    return roots_deg[np.arange(len(roots_deg)), nearer]


def heading_residual(fit: DeviationFit, pairs: Pairs) -> Floats:
    """Compute the observed heading minus the model's nearest root, (n,) degrees; NaN without a root."""
    roots = compass.inverse(fit.coefficients, pairs.heading_deg)
    observed = observed_heading(pairs)
    return angles.difference(observed, nearest_root(roots, observed))


def pair_speeds(pairs: Pairs) -> tuple[Floats, Floats]:
    """Compute the current speeds at the upper and the lower instrument, (n,) m/s each."""
    return np.hypot(pairs.upper_east, pairs.upper_north), np.hypot(pairs.lower_east, pairs.lower_north)


def covariance_sigma(columns: Floats, covariance: Floats) -> Floats:
    """Compute the standard deviation of columns times parameters, (n, p) and (p, p) -> (n,)."""
    return np.sqrt(np.einsum("ni,ij,nj->n", columns, covariance, columns))


@dataclass(frozen=True)
class CoefficientPrior:
    """Normal prior of A..E; a precision of 0 leaves a coefficient unconstrained."""

    mean: Floats  #: (5,) A..E of the exact compass, dimensionless
    precision: Floats  #: (5, 5) inverse covariance


def prior_from_json(content: Mapping[str, Any] | None) -> CoefficientPrior | None:
    """Build the prior from the content of deviation.json, None if it has none."""
    return None if content is None else CoefficientPrior(np.array(content["mean"]), np.array(content["precision"]))


# Standard deviation of hard and of induced iron, nT, and where a steel sphere is declared. Accessories near a current
# meter make 7.4 to 14.8 degrees at Brest, 2700 to 5400 nT (Le Menn et al. 2023, section 4).
IRON_NT, SPHERE_NT = 2500.0, 4000.0


def weak_field_warnings(horizontal_nT: ArrayLike) -> tuple[str, ...]:
    """Warn below the horizontal field in which no correction is reliable (Le Menn et al. 2023, section 7)."""
    least = float(np.nanmin(horizontal_nT, initial=np.inf))
    if least >= 5000.0:
        return ()
    return (
        f"the horizontal field is {least:.0f} nT; below 5000 nT no correction is reliable (Le Menn "
        "et al. 2023, section 7): compare with a gyrocompass or an observatory",
    )


@dataclass(frozen=True)
class FieldAtPlace:
    """The earth's field at the place of a compass."""

    horizontal_nT: float
    vertical_nT: float  # down positive


@dataclass(frozen=True)
class PlacedCoefficients:
    """Coefficients of the exact compass and the field where they were determined."""

    coefficients: Floats  # (5,) A..E, dimensionless
    covariance: Floats  # (5, 5)
    field: FieldAtPlace


@dataclass(frozen=True)
class TransferredCoefficients:
    """Coefficients transferred to another place, with their uncertainty."""

    coefficients: Floats  # (5,) A..E of the exact compass, dimensionless
    covariance: Floats  # (5, 5) includes that hard and induced iron are unknown
    each: Floats  # (n, 5) coefficients there that each calibration tells, which differ if the compass changed
    warning: str  # a sentence if the iron is unknown or the field too weak, else empty


def iron_design(place: FieldAtPlace) -> Floats:
    """Build the derivative of A..E by A, P, Q, c, f, D, E at one place, (5, 7): nT for P, Q, all over lambda."""
    rows = np.zeros((5, 7))
    rows[0, 0] = rows[3, 5] = rows[4, 6] = 1.0
    rows[1, [1, 3]] = rows[2, [2, 4]] = np.array([1.0, place.vertical_nT]) / place.horizontal_nT
    return rows


def transfer_coefficients(
    calibrations: Sequence[PlacedCoefficients], away: FieldAtPlace, iron_nT: float = IRON_NT
) -> TransferredCoefficients:
    """Transfer coefficients calibrated at one or more places to another.

    P and cZ are unknown, of any sign: at the first place each has a normal prior of ``iron_nT`` or the calibrated B H,
    conditioned on the calibrations: one determines P + cZ, a second one at another dip both; likewise Q and fZ. The
    error of A counts as common, and a change of the compass from the first to the last as uniformly distributed.
    """
    n, first = len(calibrations), calibrations[0].field
    observed = np.array([each.coefficients for each in calibrations])
    level = np.array([each.field.horizontal_nT for each in calibrations])[:, None]
    iron = np.maximum(np.abs(level * observed[:, 1:3]).max(axis=0), iron_nT)
    # Near the magnetic equator cZ says nothing of c, which the horizontal field bounds there.
    induced = iron / max(abs(first.vertical_nT), first.horizontal_nT)
    prior = np.diag([10.0, *iron, *induced, 10.0, 10.0]) ** 2
    noise, scale = np.mean([each.covariance for each in calibrations], axis=0), np.sqrt([n, 1.0, 1.0, 1.0, 1.0])
    errors = np.kron(np.eye(n), np.outer(scale, scale) * noise)
    design, there = np.concatenate([iron_design(each.field) for each in calibrations]), iron_design(away)
    gain = np.linalg.solve(design @ prior @ design.T + errors, design @ prior).T
    found = gain @ observed.ravel()
    residual = observed - (design @ found).reshape(n, 5)
    residual[:, 1:3] *= level / away.horizontal_nT
    covariance = there @ (prior - gain @ design @ prior) @ there.T
    change = residual[-1] - residual[0]
    covariance = (covariance + covariance.T) / 2.0 + np.outer(change, change) / 12.0
    sigma, calibrated = (
        np.sqrt(np.diag(x)[1:3]) for x in (covariance, noise * np.mean(level / away.horizontal_nT) ** 2)
    )
    warning = (
        f"B and C are known to {sigma[0]:.3f} and {sigma[1]:.3f} here (1σ), as the shares of hard iron and of iron "
        "induced by the vertical field are unknown; a second calibration at another dip would tell"
        if np.any(sigma >= calibrated + 0.01)  # 0.6 degrees
        else ""
    )
    warning = next(iter(weak_field_warnings(away.horizontal_nT)), warning)
    return TransferredCoefficients(there @ found, covariance, there @ found + residual, warning)


DISTANCES_M = (0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0, 10.0)
ORIENTATION = (0.5, 2.0)  # a dipole's field along its axis is twice that across it, and either may have been measured


def estimate_safe_distance(fit: DeviationFit, sphere_distance_m: tuple[float, float] | None) -> dict[str, Any] | None:
    """Estimate the deviation at other distances from the iron's centre, asin(|p| (r0/r)^3), by bounds of r0 and |p|.

    Args:
        sphere_distance_m: bounds of the distance r0 from compass to iron's centre, not determined by the record.
    """
    if sphere_distance_m is None or not fit.fitted or fit.method == "von_appen":
        return None
    b_c = fit.coefficients[1:3]
    field = float(np.hypot(*b_c))
    sigma = float(np.sqrt(b_c @ fit.covariance[1:3, 1:3] @ b_c)) / max(field, 1e-12) if fit.covariance.size else 0.0
    bounds = max(field - NORMAL_95 * sigma, 0.0), field + NORMAL_95 * sigma
    reached = np.array([r for r in DISTANCES_M if r > sphere_distance_m[1]])
    ends = zip(bounds, ORIENTATION, sphere_distance_m, strict=True)
    fields = np.array([share * p * (r0 / reached) ** 3 for p, share, r0 in ends])
    largest = np.where(fields < 1.0, np.arcsin(np.minimum(fields, 1.0)) / angles.DEGREE, 180.0)
    return {
        "relative_field": field,
        "relative_field_sigma": sigma,
        "assumed": {"distance_m": list(sphere_distance_m), "orientation": list(ORIENTATION)},
        "distances": [
            {"m": r, "deviation_deg": both} for r, both in zip(reached.tolist(), largest.T.tolist(), strict=True)
        ],
    }


# Errors of the reference's own compass: a constant, with which a fit turns, and iron of its own, b sin + c cos of the
# *reference's* heading, of which it takes up what looks like iron of the affected compass.

# Assumed for a moored magnetic compass that was not calibrated in place (docs/background/limits.md; keys of the
# instrument give others), and for constants of affected compasses, by their mounting and alignment.
CONSTANT_SIGMA_DEG, ALIGNMENT_SIGMA_DEG, IRON_SIGMA_NT, TILT_OFFSET_DEG = 2.0, 4.0, 525.0, 0.4
STUDENT_68 = 1.1416  # 68.27 % of Student's t with four degrees of freedom lie within this, as of a normal within 1


def declination_sigma(field: EarthField) -> float:
    """Compute the standard deviation of the field model's declination, degrees."""
    return earthfield.model_sigma(float(np.mean(field.horizontal_nT)))


def reference_compass(
    name: str, field: EarthField, *, magnetic: bool, sigma_deg: float | None = None, iron_nT: float | None = None
) -> ReferenceCompass:
    """Describe the compass of a reference by its keys; true directions add the error of another declination.

    Args:
        sigma_deg: standard deviation of its constant error (``compass_sigma_deg``), None for the usual one.
        iron_nT: that of either component of its horizontal iron (``compass_iron_nT``), None for the usual one.
    """
    horizontal, declination = float(np.mean(field.horizontal_nT)), declination_sigma(field)
    dip_ratio = abs(float(np.mean(field.vertical_nT))) / horizontal
    usual = CONSTANT_SIGMA_DEG if magnetic else float(np.hypot(CONSTANT_SIGMA_DEG, declination))
    iron = (IRON_SIGMA_NT if iron_nT is None else iron_nT) / horizontal / angles.DEGREE
    return ReferenceCompass(
        name,
        usual if sigma_deg is None else sigma_deg,
        float(np.hypot(iron, TILT_OFFSET_DEG * dip_ratio)) if iron_nT is None else iron,
        0.0 if magnetic else declination,
    )


def iron_pattern(pairs: Pairs) -> Floats:
    """Compute the error of the reference's directions by one σ of its B and of its C, (n, 2) degrees."""
    heading = angles.direction(pairs.lower_east, pairs.lower_north)  # of a vane, the worst case, where not recorded
    if pairs.lower_heading_deg is not None:
        heading = np.where(np.isfinite(pairs.lower_heading_deg), pairs.lower_heading_deg, heading)
    return (pairs.compass.iron_deg if pairs.compass else 0.0) * np.column_stack(angles.sin_cos(heading))


def reference_errors(pairs: Pairs, iron: Floats, *, veer_included: bool) -> ReferenceErrors | None:
    """Collect the errors of the reference of a fit, with the change of A..E by its iron; None if not stated.

    Args:
        iron: (5, 2) change of the coefficients by each column of ``iron_pattern``.
    """
    if (compass := pairs.compass) is None:
        return None
    constant = float(np.hypot(compass.sigma_deg, compass.declination_deg))
    return ReferenceErrors(constant, pairs.veer_deg, iron, compass.declination_deg == 0.0, veer_included)


def constant_sigma(constant_deg: float, sigma_deg: float, error_deg: float) -> float:
    """Compute the rms of the part of a fitted constant, degrees, that is not the affected compass's own.

    The own part is normal with ``ALIGNMENT_SIGMA_DEG``, the error of the reference Student's t with four degrees of
    freedom, 68 % of it within ``error_deg``; given their sum, the error has a mean and a standard deviation.

    Args:
        sigma_deg: standard error of the fitted constant.
        error_deg: standard deviation of the error, in the sense that 68 % lie within.
    """
    if error_deg == 0.0:
        return 0.0
    width, scale = float(np.hypot(ALIGNMENT_SIGMA_DEG, sigma_deg)), error_deg / STUDENT_68
    error = np.linspace(-1.0, 1.0, 2001) * (abs(constant_deg) + 8.0 * error_deg + 4.0 * width)
    log_density = -2.5 * np.log1p((error / scale) ** 2 / 4.0)
    log_density = log_density - 0.5 * ((constant_deg - error) / width) ** 2
    weight = np.exp(log_density - log_density.max())
    return float(np.sqrt(np.average(error**2, weights=weight)))
