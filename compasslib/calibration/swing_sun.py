"""True azimuth of the sun: by an ephemeris that ships with its library, and by the navigator's formula."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from compasslib import angles

Floats = NDArray[np.floating]

UNIX_EPOCH_IN_EPHEM_DAYS = 25567.5  # days from its zero, noon of 31 December 1899
DAY_S = 86400.0
DEGREES_AN_HOUR = 15.0


def azimuth(latitude: float, longitude: float, time_s: float) -> float:
    """Return the sun's azimuth from true north, degrees, by VSOP87 (PyEphem).

    Args:
        latitude: degrees north.
        longitude: degrees east.
        time_s: UTC seconds since 1970.
    """
    return position(latitude, longitude, time_s)["azimuth_deg"]


def position(latitude: float, longitude: float, time_s: float) -> dict[str, float]:
    """Return azimuth, altitude without refraction, and declination of the sun, degrees, and its next meridian passage.

    Args:
        latitude: degrees north.
        longitude: degrees east.
        time_s: UTC seconds since 1970.
    """
    import ephem  # only swings by the sun need it

    here = ephem.Observer()
    here.lat, here.lon, here.pressure = str(latitude), str(float(angles.wrap180(longitude))), 0.0
    here.date = time_s / DAY_S + UNIX_EPOCH_IN_EPHEM_DAYS
    sun = ephem.Sun(here)
    return {
        "azimuth_deg": float(angles.wrap360(sun.az / angles.DEGREE)),
        "altitude_deg": float(sun.alt / angles.DEGREE),
        "declination_deg": float(sun.dec / angles.DEGREE),
        "passage_s": (float(here.next_transit(ephem.Sun())) - UNIX_EPOCH_IN_EPHEM_DAYS) * DAY_S,
    }


def hour_angle(utc_h: ArrayLike, passage_h: ArrayLike, longitude: ArrayLike) -> Floats:
    """Return the local hour angle, MM (52) with its sign put right: east longitudes add, degrees.

    Args:
        utc_h: time, hours UTC.
        passage_h: meridian passage at Greenwich, hours UTC.
        longitude: degrees east.
    """
    return (np.asarray(utc_h) - np.asarray(passage_h)) * DEGREES_AN_HOUR + np.asarray(longitude)


def azimuth_by_formula(latitude: float, declination_deg: ArrayLike, hour_angle_deg: ArrayLike) -> Floats:
    """Return the sun's azimuth from true north, MM (51), degrees in [0, 360).

    A negative Z counts from south, so that |Z| from the nearer pole lies east before noon and west after.

    Args:
        latitude: degrees north.
        declination_deg: of the sun.
        hour_angle_deg: local hour angle, negative before noon.
    """
    sine, cosine = angles.sin_cos(hour_angle_deg)
    sin_phi, cos_phi = angles.sin_cos(latitude)
    sin_dec, cos_dec = angles.sin_cos(declination_deg)
    from_north = angles.direction(np.abs(sine), cos_phi * sin_dec / cos_dec - sin_phi * cosine)
    return angles.wrap360(np.where(angles.wrap180(hour_angle_deg) < 0.0, from_north, -from_north))
