"""Coefficients from the eight principal courses: Moncunill Marimon et al. 2023 (MM), J. Navigation.

A pseudo-deviation is the course over ground minus the compass course. A, D and E from it are free of the water's set
and drift but for second-order terms; B and C hold them in full, and a single visual reference takes them out again.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from compasslib import angles
from compasslib.errors import InputError
from compasslib.types import Floats

POINTS = ("N", "NE", "E", "SE", "S", "SW", "W", "NW")
STEP_DEG = 45.0
HALF_ROOT = 0.707  # as MM print sin 45, so that their numbers come out to the last digit
NARROWEST_DEG, WIDEST_DEG = 60.0, 120.0  # between two headings that tell B and C (MM section 6)
NAN = float("nan")


def pseudo_deviations(course_deg: ArrayLike, recorded_deg: ArrayLike) -> dict[str, float]:
    """Return the mean of course minus compass on each of the eight points, degrees, NaN where none was steered.

    Each observation belongs to the nearest point, by the courses or by the compass: whichever was steered on points.

    Args:
        course_deg: courses over ground or headings, true, (n,).
        recorded_deg: compass courses, (n,).
    """
    steered = min((np.asarray(course_deg), np.asarray(recorded_deg)), key=_away_from_points)
    nearest = np.rint(steered / STEP_DEG).astype(int) % len(POINTS)
    psi = angles.difference(course_deg, recorded_deg)
    found = {}
    for k, point in enumerate(POINTS):
        mean = angles.wrap180(angles.mean(psi[nearest == k])) if (nearest == k).any() else NAN
        found[point] = float(mean)
    return found


def coefficients(psi: Mapping[str, float], declination_deg: float) -> dict[str, float | dict[str, float]]:
    """Return A, B bar, C bar, D and E from pseudo-deviations, MM (39), (44) to (50); NaN where a course is missing.

    D is the mean over the quadrants that were steered; over all four it is (47).

    Args:
        psi: degrees by point; deviations where the declination is 0.
        declination_deg: degrees east.
    """
    n, ne, e, se, s, sw, w, nw = (psi[point] for point in POINTS)
    a_bar, b_bar, c_bar = (n + e + s + w) / 4.0, (e - w) / 2.0, (n - s) / 2.0
    along, across = HALF_ROOT * (b_bar + c_bar), HALF_ROOT * (b_bar - c_bar)
    quadrants = {
        "NE": ne - a_bar - along,
        "SE": a_bar + across - se,
        "SW": sw - a_bar + along,
        "NW": a_bar - across - nw,
    }
    steered = [d for d in quadrants.values() if np.isfinite(d)]
    return {
        "A_bar": a_bar,
        "A": a_bar - declination_deg,
        "B_bar": b_bar,
        "C_bar": c_bar,
        "D": float(np.mean(steered)) if steered else NAN,
        "E": (n + s - e - w) / 4.0,
        "D_from": quadrants,
    }


def error_bound_deg(ratio: ArrayLike) -> Floats:
    """Return the largest error of D and of E that set and drift leave, MM (37), (43) and Table 1, degrees.

    Args:
        ratio: drift over the ship's speed, d/S.
    """
    return 0.5 / angles.DEGREE * np.asarray(ratio, dtype=float) ** 2


def set_and_drift_terms(ratio: float, set_deg: float) -> dict[str, float]:
    """Return what set and drift add to the deviations' coefficients, MM (22), (37) and (43), degrees.

    B = B bar + x, C = C bar - y, E = E bar + xy (its second-order term), D = D bar - (x2 - y2)/2.

    Args:
        ratio: drift over the ship's speed, d/S.
        set_deg: towards which the water flows, magnetic, degrees.
    """
    sine, cosine = angles.sin_cos(set_deg)
    sine2, cosine2 = angles.sin_cos(2.0 * set_deg)
    first, second = ratio / angles.DEGREE, float(error_bound_deg(ratio))
    return {
        "x": first * float(cosine),
        "y": first * float(sine),
        "E": second * float(sine2),
        "D": second * float(cosine2),
    }


def from_two_headings(
    known: Mapping[str, float], first: tuple[float, float], second: tuple[float, float]
) -> tuple[float, float]:
    """Return residual B and C from the deviations on two headings (MM section 6), degrees.

    Args:
        known: A, D and E, degrees.
        first: compass course and deviation on it, degrees.

    Raises:
        InputError: the headings are not 60 to 120 degrees apart.
    """
    apart = abs(float(angles.difference(first[0], second[0])))
    if not NARROWEST_DEG <= apart <= WIDEST_DEG:
        raise InputError(
            "visual",
            expected="two headings 60 to 120 degrees apart",
            found=f"{apart:.0f} degrees",
            advice="steer for another mark",
        )
    (eta1, eta2), (sine1, sine2), (cosine1, cosine2) = (
        [_beyond(known, *each) for each in (first, second)],
        *np.transpose([angles.sin_cos(each[0]) for each in (first, second)]),
    )
    across = float(angles.sin_cos(first[0] - second[0])[0])
    return (eta1 * cosine2 - eta2 * cosine1) / across, (eta2 * sine1 - eta1 * sine2) / across


def from_one_heading(
    known: Mapping[str, float], bars: tuple[float, float], compass_deg: float, deviation_deg: float
) -> dict[str, float]:
    """Return residual B and C from one visual reference by Lushnikov's method, MM (54) to (60), degrees.

    Args:
        known: A, D and E, degrees.
        bars: B bar and C bar, degrees.
    """
    sine, cosine = (float(x) for x in angles.sin_cos(compass_deg + deviation_deg))
    across = _beyond(known, compass_deg + deviation_deg, deviation_deg)
    along = bars[0] * cosine - bars[1] * sine
    return {
        "B": across * sine + along * cosine,
        "C": across * cosine - along * sine,
        "theta_1": across,
        "theta_2": along,
    }


def _beyond(known: Mapping[str, float], course_deg: float, deviation_deg: float) -> float:
    """Return the deviation less its constant and quadrantal parts."""
    sine2, cosine2 = angles.sin_cos(2.0 * course_deg)
    return deviation_deg - known["A"] - known["D"] * float(sine2) - known["E"] * float(cosine2)


def _away_from_points(course_deg: Floats) -> float:
    return angles.rms(course_deg - STEP_DEG * np.rint(course_deg / STEP_DEG))
