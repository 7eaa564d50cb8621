"""The International Geomagnetic Reference Field at one place along time.

The coefficients are those of the file in the package ppigrf; its own evaluation needs pandas, whose import costs fifty
times what a mooring's field does. A test holds the two together.
"""

from __future__ import annotations

from functools import cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compasslib import angles

Floats = NDArray[np.floating]

RADIUS_KM = 6371.2  # of the sphere that the coefficients belong to
EQUATOR_KM, FLATTENING = 6378.137, 1.0 / 298.257223563  # WGS84
NEAREST_POLE = 1e-9  # least sine of the colatitude: east has no meaning at the pole itself


def field(latitude: float, longitude: float, days: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the field to the east, north and down at sea level, (k,) nT each.

    The potential's gradient in spherical coordinates (Alken et al., Earth Planets Space 73, 49, 2021, eq. 1), turned by
    the angle between the sphere's vertical and the ellipsoid's.

    Args:
        latitude: degrees north, geodetic.
        longitude: degrees east.
        days: since 1970, within the model's years, (k,).
    """
    nodes, degree, order, values = _coefficients()
    g_and_h = np.array([np.interp(days, nodes, row) for row in values])
    latitude_there, radius_km = _on_the_sphere(latitude)
    legendre, slope = _legendre(90.0 - latitude_there, int(degree.max()))
    p, dp = legendre[degree, np.abs(order)], slope[degree, np.abs(order)]
    sine, cosine = angles.sin_cos(np.abs(order) * longitude)
    wave, turned = (np.where(order < 0, a, b) for a, b in ((sine, cosine), (cosine, -sine)))
    fall = (RADIUS_KM / radius_km) ** (degree + 2)
    across = max(float(angles.sin_cos(90.0 - latitude_there)[0]), NEAREST_POLE)
    outward = ((degree + 1) * fall * p * wave) @ g_and_h
    north = (fall * dp * wave) @ g_and_h
    east = -(fall * np.abs(order) * p * turned / across) @ g_and_h
    tilt_sine, tilt_cosine = angles.sin_cos(latitude - latitude_there)
    return east, north * tilt_cosine - outward * tilt_sine, -outward * tilt_cosine - north * tilt_sine


@cache
def _coefficients() -> tuple[Floats, NDArray[np.intp], NDArray[np.intp], Floats]:
    """Return days since 1970 of the epochs, degree and order (negative for sines) of each row, and the rows, nT."""
    spec = find_spec("ppigrf")
    folder = Path(str(spec.origin)).parent if spec else Path()
    lines = (folder / "IGRF14.shc").read_text(encoding="ascii").splitlines()
    numbers = [line.split() for line in lines if not line.startswith("#")][1:]
    years = [f"{float(year):.0f}-01-01" for year in numbers[0]]
    nodes = np.array(years, dtype="datetime64[D]").astype(float)
    rows = np.array(numbers[1:], dtype=float)
    return nodes, rows[:, 0].astype(int), rows[:, 1].astype(int), rows[:, 2:]


def _on_the_sphere(latitude: float) -> tuple[float, float]:
    """Return geocentric latitude (degrees) and distance from the centre (km) of a place on the ellipsoid."""
    sine, cosine = angles.sin_cos(latitude)
    squashed = (1.0 - FLATTENING) ** 2
    normal = EQUATOR_KM / np.sqrt(cosine**2 + squashed * sine**2)
    outward, upward = normal * cosine, normal * squashed * sine
    return 90.0 - float(angles.direction(outward, upward)), float(np.hypot(outward, upward))


def _legendre(colatitude_deg: float, degrees: int) -> tuple[Floats, Floats]:
    """Return Schmidt's quasi-normalised functions and their derivatives by the colatitude, (degrees + 1,) * 2 each.

    Recursions of Langel (in Jacobs, Geomagnetism, vol. 1, 1987, eq. 27).
    """
    s, c = angles.sin_cos(colatitude_deg)
    p, dp = np.zeros((2, degrees + 1, degrees + 1))
    p[0, 0] = 1.0
    for n in range(1, degrees + 1):
        step = np.sqrt(1.0 - 0.5 / n) if n > 1 else 1.0
        p[n, n], dp[n, n] = step * s * p[n - 1, n - 1], step * (s * dp[n - 1, n - 1] + c * p[n - 1, n - 1])
        m = np.arange(n)
        root, before = np.sqrt(n**2 - m**2), np.sqrt((n - 1.0) ** 2 - m**2)
        older = np.array([p[n - 2, :n], dp[n - 2, :n]]) if n > 1 else np.zeros((2, n))
        p[n, :n] = ((2 * n - 1) * c * p[n - 1, :n] - before * older[0]) / root
        dp[n, :n] = ((2 * n - 1) * (c * dp[n - 1, :n] - s * p[n - 1, :n]) - before * older[1]) / root
    return p, dp
