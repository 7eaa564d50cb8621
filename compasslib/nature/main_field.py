"""The IGRF at one place from its definition; ppigrf's own evaluation imports pandas, half of what a mooring costs."""

from __future__ import annotations

from importlib.util import find_spec
from math import factorial
from pathlib import Path

import numpy as np
from numpy.polynomial import Legendre

from compasslib.nature.series import Floats

RADIUS_KM = 6371.2  # of the sphere that the coefficients belong to
EQUATOR_KM, SQUARED_ECCENTRICITY = 6378.137, 0.0066943799901413165  # WGS84


def main_field(latitude_deg: float, longitude_deg: float, days: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the field to the east, north and up at sea level, nT, (k,) each; not at a pole.

    The potential of Alken et al. (Earth Planets Space 73, 49, 2021, eq. 1), derived term by term.

    Args:
        latitude_deg: degrees north, geodetic.
        longitude_deg: degrees east.
        days: since 1970, (k,).
    """
    latitude, longitude = np.deg2rad([latitude_deg, longitude_deg])
    normal = EQUATOR_KM / np.sqrt(1.0 - SQUARED_ECCENTRICITY * np.sin(latitude) ** 2)
    across, along = normal * np.cos(latitude), normal * (1.0 - SQUARED_ECCENTRICITY) * np.sin(latitude)
    radius = np.hypot(across, along)
    epochs, terms = _coefficients()
    east, north, up = np.zeros((3, len(days)))
    for degree, order, values in terms:
        size = np.interp(days, epochs, values) * (RADIUS_KM / radius) ** (degree + 2)
        legendre, slope = _schmidt(degree, abs(order), along / radius, across / radius)
        wave = np.exp(1j * abs(order) * longitude)
        here, turned = (wave.imag, wave.real) if order < 0 else (wave.real, -wave.imag)
        east -= size * abs(order) * turned * legendre * radius / across
        north += size * here * slope
        up += size * here * legendre * (degree + 1)
    lean = latitude - np.arctan2(along, across)  # between the ellipsoid's vertical and the sphere's
    return east, north * np.cos(lean) - up * np.sin(lean), up * np.cos(lean) + north * np.sin(lean)


def _schmidt(degree: int, order: int, cosine: float, sine: float) -> tuple[float, float]:
    """Return Schmidt's function of a colatitude, by derivatives of Legendre's polynomial, and its slope."""
    scale = np.sqrt((1 + (order > 0)) * factorial(degree - order) / factorial(degree + order))
    bent, more = (Legendre.basis(degree).deriv(k)(cosine) for k in (order, order + 1))
    slope = order * sine ** (order - 1) * cosine * bent - sine ** (order + 1) * more
    return scale * sine**order * bent, scale * slope


def _coefficients() -> tuple[Floats, list[tuple[int, int, list[float]]]]:
    """Return the epochs in days since 1970, and of each term degree, order (negative for sines) and nT at them."""
    found = find_spec("ppigrf")
    text = Path(str(found and found.origin)).with_name("IGRF14.shc").read_text(encoding="ascii")
    _, years, *rows = [line.split() for line in text.splitlines() if not line.startswith("#")]
    epochs = np.array([f"{float(year):.0f}-01-01" for year in years], dtype="datetime64[D]").astype(float)
    return epochs, [(int(row[0]), int(row[1]), [float(x) for x in row[2:]]) for row in rows]
