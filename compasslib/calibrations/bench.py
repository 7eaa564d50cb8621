"""Field on a bench: changes from an observatory, homogeneity from a spun instrument, objects near a compass.

Le Menn et al. 2023, section 2, Table 3 and section 4. The paper lets the influence of an object fall as the square of
the distance; that of a dipole falls as the cube, and no object is a dipole at distances comparable to its size.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from compasslib import angles
from compasslib.calibrations import curves
from compasslib.calibrations.curves import FittedCurve
from compasslib.readers import iaga2002
from compasslib.types import Floats

DIPOLE = 3.0  # exponent of the decrease with distance
FAR_SIZES = 2.0  # distance, in sizes of the object, beyond which it may be a dipole
EXPONENTS = np.arange(0.5, 8.001, 0.01)
SAFE_DEG = 0.5  # harmless change of the deviation


def correct_field(
    reference_deg: Floats, time_s: Floats, files: Sequence[str], *, max_steps: float = 1.5
) -> tuple[Floats, dict[str, Any]]:
    """Correct reference directions, (n,), for changes of the declination about its mean over the readings.

    Readings at an unknown time or farther than ``max_steps`` sampling intervals from any sample are not corrected.

    Raises:
        InputError: a file cannot be read.
    """
    series = iaga2002.read(files)
    known = np.isfinite(series.declination_deg)
    at, declination = series.time_s[known], series.declination_deg[known]
    if len(at) < 2 or not np.isfinite(time_s).any():
        text = f"{series.station} has no declination at the times of the readings, which stay uncorrected"
        return reference_deg, {"station": series.station, "corrected": 0, "range_deg": None, "text": text}
    nearest = np.array([np.min(np.abs(at - t)) if np.isfinite(t) else np.inf for t in time_s])
    near = nearest <= max_steps * np.median(np.diff(at))
    change, count, size = np.zeros(reference_deg.shape), int(near.sum()), 0.0
    if count:
        change[near] = np.interp(time_s[near], at, declination)
        change[near] -= np.mean(change[near])
        size = float(np.ptp(change[near]))
    text = (
        f"{count} of {len(near)} readings are corrected for changes of the declination at {series.station}, "
        f"{size:.2f} degrees in all; field_deg may then be the noise alone"
    )
    corrected = {"station": series.station, "corrected": count, "range_deg": size, "text": text}
    return angles.wrap360(reference_deg - change), corrected


def measure_homogeneity(
    reference_deg: Floats,
    recorded_deg: Floats,
    spun_reference_deg: Floats,
    spun_recorded_deg: Floats,
) -> dict[str, Any]:
    """Compare an instrument spun in place, (m,), with the curve fitted to the rotated platform, (n,), degrees."""
    points = curves.deviation_points(recorded_deg, reference_deg)
    fits = [curves.fit_curve(form, points) for form in (curves.SMITH, curves.EXACT)]
    fitted = [fit for fit in fits if isinstance(fit, FittedCurve)]
    observed = angles.difference(spun_reference_deg, spun_recorded_deg)
    known = np.isfinite(observed)
    if not fitted or known.sum() < 4:  # Table 3
        few = f"{known.sum()} directions of the spun instrument, at least 4 tell it"
        text = f"The homogeneity of the field is not determined: {few if fitted else fits[0]}"
        return {"max_deg": None, "mean_deg": None, "text": text}
    off = angles.difference(observed[known], curves.select_curve(fitted).deviation(spun_recorded_deg[known]))
    largest, mean = float(off[np.argmax(np.abs(off))]), float(np.mean(off))
    text = (
        f"The instrument spun in {len(off)} directions differs from the rotated platform by up to {largest:+.2f} "
        f"degrees, by {mean:+.2f} on average: the largest is the homogeneity's row of the budget"
    )
    return {"max_deg": largest, "mean_deg": mean, "text": text}


@dataclass(frozen=True)
class ObjectChange:
    """Change by an object at one distance."""

    name: str  # of the calibration
    distance_m: float  # compass to the object's centre
    change_deg: Floats  # (2,) of B and C relative to the bench without it
    own: Floats  # (2, 2) covariance of the calibration with the object
    common: Floats  # (2, 2) covariance of the bench without it, whose error all changes have

    @property
    def size_deg(self) -> float:
        """Length of the vector of changes, degrees."""
        return float(np.hypot(*self.change_deg))

    @property
    def sigma_deg(self) -> float:
        """Standard uncertainty along the vector of changes, degrees."""
        along = self.change_deg / max(self.size_deg, 1e-12)
        return float(np.sqrt(along @ (self.own + self.common) @ along))


def changes_by_object(without: Mapping[str, Any], others: Sequence[Mapping[str, Any]]) -> list[ObjectChange]:
    """Collect the changes of (B, C) by an object from calibrations that state its distance, nearest first."""
    found = []
    for content in others if without["coefficients"] else ():
        if content.get("object") and content["coefficients"]:
            change = np.array([content["coefficients"][k] - without["coefficients"][k] for k in "BC"])
            own, common = (np.array(each["covariance"], dtype=float)[1:3, 1:3] for each in (content, without))
            found.append(ObjectChange(content["name"], content["object"]["distance_m"], change, own, common))
    return sorted(found, key=lambda each: each.distance_m)


def describe_object(
    changes: Sequence[ObjectChange],
    size_m: float,
    *,
    min_distances: int = 4,  # needed to fit an exponent
    two_sigma_chi2: float = 4.0,  # growth of chi-squared at the ends of an interval of 95 %, one parameter
    min_p_value: float = 0.01,  # below which changes are not those of a dipole
) -> dict[str, Any]:
    """Describe the changes by an object, nearest first, their decrease with distance and the safe distance.

    From there on a dipole changes no deviation by ``SAFE_DEG``; changes within twice the object's size do not count.
    """
    from scipy.special import chdtrc  # imported late: only needed for objects

    least_m = FAR_SIZES * size_m  # the object is no dipole at less
    near, far = ([each for each in changes if (each.distance_m <= least_m) == nearer] for nearer in (True, False))
    listed = [f"{each.size_deg:.2f} ± {2.0 * each.sigma_deg:.2f}° at {each.distance_m:g} m" for each in changes]
    texts = [f"The object changes (B, C) by {', '.join(listed)} (k = 2)."]
    content: dict[str, Any] = {
        "changes": [
            {"name": each.name, "distance_m": each.distance_m, "size_deg": each.size_deg, "sigma_deg": each.sigma_deg}
            | dict(zip("BC", each.change_deg.tolist(), strict=True))
            for each in changes
        ],
        **dict.fromkeys(("p_value", "exponent", "safe_distance_m")),
    }
    if near:
        where = ", ".join(f"{each.distance_m:g} m" for each in near)
        texts.append(f"At {where} it is nearer than twice its size and no dipole: nothing follows for other distances.")
    if len(changes) >= min_distances and not near:
        misfits = fit_fall(far, EXPONENTS)[2]
        within, best = EXPONENTS[misfits <= misfits.min() + two_sigma_chi2], float(EXPONENTS[np.argmin(misfits)])
        low, high = float(within[0]), float(within[-1])
        content["exponent"] = {"value": best, "low": low, "high": high}
        texts.append(f"They fall with the power {best:.1f} of the distance ({low:.1f} to {high:.1f}).")
    if far:
        strength, covariance, misfit = fit_fall(far, DIPOLE)
        p_value = float(chdtrc(2 * len(far) - 2, float(misfit))) if len(far) > 1 else None
        content["p_value"] = p_value
        if p_value is not None and p_value < min_p_value:
            texts.append("No dipole falls so: no safe distance follows.")
        else:
            size = float(np.hypot(*strength))
            sigma = float(np.sqrt(strength @ covariance @ strength)) / max(size, 1e-12)
            ends = {"value": size, "low": max(size - 2.0 * sigma, 0.0), "high": size + 2.0 * sigma}
            safe = {name: max((each / SAFE_DEG) ** (1.0 / DIPOLE), least_m) for name, each in ends.items()}
            content["safe_distance_m"] = safe
            law = "By a dipole's fall, which " + ("one distance cannot test" if p_value is None else "they fit")
            where = f"{safe['value']:.2f} m on ({safe['low']:.2f} to {safe['high']:.2f} m)"
            texts.append(f"{law}, no deviation changes by {SAFE_DEG:g}° from {where}.")
    return content | {"text": " ".join(texts)}


def fit_fall(changes: Sequence[ObjectChange], exponent: ArrayLike) -> tuple[Floats, Floats, Floats]:
    """Fit the vector M of changes M / r^n by generalized least squares: M, its covariance, chi-squared.

    The exponent n is a scalar or an array, whose shape precedes that of each result.
    """
    n = len(changes)
    covariance = np.einsum("kl,kij->kilj", np.eye(n), [each.own for each in changes]) + changes[0].common[:, None]
    precision = np.linalg.inv(covariance.reshape(2 * n, 2 * n)).reshape(n, 2, n, 2)
    observed = np.array([each.change_deg for each in changes])
    shares = np.array([each.distance_m for each in changes]) ** -np.asarray(exponent, dtype=float)[..., None]
    covariance = np.linalg.inv(np.einsum("...k,kilj,...l->...ij", shares, precision, shares))
    pull = np.einsum("...k,kilj,lj->...i", shares, precision, observed)
    strength = np.einsum("...ij,...j->...i", covariance, pull)
    square = np.einsum("ki,kilj,lj", observed, precision, observed) - np.einsum("...i,...i", pull, strength)
    return strength, covariance, np.maximum(square, 0.0)
