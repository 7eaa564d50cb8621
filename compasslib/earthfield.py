"""The earth's field by IGRF at one place along time, with a check for dates outside the model.

The coefficients are those of IGRF-14 (IAGA, doi:10.5281/zenodo.14012302). The package ppigrf is not used because it
needs pandas, whose import takes fifty times as long as the field of a mooring; a test compares the two.
"""

from collections.abc import Mapping
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from compasslib import angles
from compasslib.errors import InputError
from compasslib.records import EarthField
from compasslib.types import DAY_S, Floats

FIRST_YEAR, LAST_YEAR = 1900, 2030  # IGRF-14
RADIUS_KM = 6371.2  # reference radius of the coefficients
DEGREE_KM = 111.2  # of latitude
EQUATOR_KM, FLATTENING = 6378.137, 1.0 / 298.257223563  # WGS84


def igrf(latitude: float, longitude: float, time_s: ArrayLike) -> tuple[Floats, Floats, Floats]:
    """Compute declination (degrees east), horizontal and downward field (nT) at sea level by IGRF.

    The gradient of the potential in spherical coordinates (Alken et al., Earth Planets Space 73, 49, 2021, eq. 1) is
    rotated by the angle between the geocentric and the geodetic vertical.

    Args:
        latitude: degrees north, geodetic.
        time_s: UTC seconds since 1970, in order, (k,).

    Raises:
        InputError: a date is outside the model.
    """
    seconds = np.atleast_1d(np.asarray(time_s, dtype=float))
    for date in (datetime.fromtimestamp(t, UTC) for t in seconds[[0, -1]]):
        if not FIRST_YEAR <= date.year < LAST_YEAR:
            expected = f"dates from {FIRST_YEAR} to {LAST_YEAR - 1}, which IGRF covers"
            raise InputError("earth's field", expected=expected, found=f"{date:%Y-%m-%d}", advice="correct the dates")
    nodes, degree, order, values = _coefficients()
    g_and_h = np.array([np.interp(seconds / DAY_S, nodes, row) for row in values])
    # Geocentric latitude and radius of a place on the ellipsoid.
    sine, cosine = angles.sin_cos(latitude)
    squashed = (1.0 - FLATTENING) ** 2
    normal = EQUATOR_KM / np.sqrt(cosine**2 + squashed * sine**2)
    equatorial, polar = normal * cosine, normal * squashed * sine
    latitude_there, radius_km = 90.0 - float(angles.direction(equatorial, polar)), float(np.hypot(equatorial, polar))
    legendre, slope = _legendre(90.0 - latitude_there, int(degree.max()))
    p, dp = legendre[degree, np.abs(order)], slope[degree, np.abs(order)]
    sine, cosine = angles.sin_cos(np.abs(order) * longitude)
    wave, turned = (np.where(order < 0, a, b) for a, b in ((sine, cosine), (cosine, -sine)))
    fall = (RADIUS_KM / radius_km) ** (degree + 2)
    across = max(float(angles.sin_cos(90.0 - latitude_there)[0]), 1e-9)  # east is undefined at the pole
    outward = ((degree + 1) * fall * p * wave) @ g_and_h
    north = (fall * dp * wave) @ g_and_h
    east = -(fall * np.abs(order) * p * turned / across) @ g_and_h
    tilt_sine, tilt_cosine = angles.sin_cos(latitude - latitude_there)
    north, down = north * tilt_cosine - outward * tilt_sine, -outward * tilt_cosine - north * tilt_sine
    return angles.wrap180(angles.direction(east, north)), np.hypot(east, north), down


def field_along(
    latitude: float,
    longitude: float,
    start_s: float,
    end_s: float,
    declination: float | None = None,
    applied: Mapping[str, float] | None = None,
) -> EarthField:
    """Compute the field over a deployment; a given declination overrides the model's and is compared with it.

    Args:
        declination: declination in the metadata, degrees east, or None for the model's.
        applied: by instrument, declination that its files already include according to the metadata, degrees; an
            instrument may be set up with a chart some years old.

    Raises:
        InputError: a date is outside the model.
    """
    nodes = np.linspace(start_s, end_s, 2 + int((end_s - start_s) // (30 * DAY_S)))
    model, horizontal, vertical = igrf(latitude, longitude, nodes)
    warnings = [] if declination is None else _disagreement("declination", declination, model, 1.0)
    for name, degrees in (applied or {}).items():
        warnings += _disagreement(f"{name}: declination_applied", degrees, model, 2.0)
    return EarthField(
        time_s=nodes,
        declination_deg=model if declination is None else np.full(nodes.shape, float(declination)),
        horizontal_nT=horizontal,
        vertical_nT=vertical,
        model_declination_deg=model,
        source="IGRF" if declination is None else "metadata",
        warnings=tuple(warnings),
    )


def declination_at(field: EarthField, time_s: ArrayLike) -> Floats:
    """Interpolate the declination to use to given times, degrees east."""
    return np.interp(np.asarray(time_s, dtype=float), field.time_s, field.declination_deg)


def model_sigma(horizontal_nT: float) -> float:
    """Compute the standard deviation of a field model's declination, with crust and daily variation, degrees."""
    # That of WMM2025 (Chulliat et al. 2025, The US/UK World Magnetic Model for 2025-2030) is used for IGRF.
    return float(np.hypot(0.26, 5417.0 / horizontal_nT))


def field_from_json(content: Mapping[str, Any]) -> EarthField:
    """Build the field from the content of field.json."""
    texts: dict[str, Any] = {"source": content["source"], "warnings": tuple(content["warnings"])}
    series: dict[str, Any] = {key: np.array(value) for key, value in content.items() if key not in texts}
    return EarthField(**series, **texts)


def describe_field(name: str, field: EarthField) -> str:
    """Compose the log line of the job that computes the field of a mooring."""
    first, last = field.declination_deg[[0, -1]]
    horizontal = field.horizontal_nT.mean()
    line = f"{name}: declination {first:+.2f} to {last:+.2f} degrees ({field.source}), H {horizontal:.0f} nT"
    return "\n".join([line, *(f"{name}: warning: {warning}" for warning in field.warnings)])


def _disagreement(name: str, degrees: float, model: Floats, tolerance_deg: float) -> list[str]:
    """Report if a value disagrees with the model's declination, with the mistake that may explain it."""
    off = angles.difference(degrees, model)
    worst = float(off[np.argmax(np.abs(off))])
    if abs(worst) <= tolerance_deg:
        return []
    return [
        f"{name} {degrees:+.2f} degrees in the metadata is {worst:+.2f} degrees off IGRF ({model.mean():+.2f})"
        f"{recognize_mistake(degrees, float(model.mean()))}; check its sign, or write auto"
    ]


def recognize_mistake(degrees: float, model: float) -> str:
    """Describe the mistake that explains a declination other than the model's; empty if there is none."""
    mistakes = {
        ", which has the other sign": -model,
        ", of which it looks like the double": 2.0 * model,
        ", of which it looks like the double with the other sign": -2.0 * model,
    }
    text, value = min(mistakes.items(), key=lambda mistake: abs(degrees - mistake[1]))
    tolerance_deg = min(max(0.5, 0.05 * abs(value)), abs(value) / 2.0)
    return text if abs(degrees - value) <= tolerance_deg and abs(model) > 0.5 else ""


@cache
def _coefficients() -> tuple[Floats, NDArray[np.intp], NDArray[np.intp], Floats]:
    """Read days since 1970 of the epochs, degree and order (negative for sines) of each row, and the rows, nT."""
    lines = Path(__file__).with_name("igrf14.shc").read_text(encoding="ascii").splitlines()
    numbers = [line.split() for line in lines if not line.startswith("#")][1:]
    years = [f"{float(year):.0f}-01-01" for year in numbers[0]]
    nodes = np.array(years, dtype="datetime64[D]").astype(float)
    rows = np.array(numbers[1:], dtype=float)
    return nodes, rows[:, 0].astype(int), rows[:, 1].astype(int), rows[:, 2:]


def _legendre(colatitude_deg: float, degrees: int) -> tuple[Floats, Floats]:
    """Compute Schmidt quasi-normalised Legendre functions and colatitude derivatives (Langel 1987, eq. 27)."""
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


class AppliedDeclination(NamedTuple):
    """Declination already included in recorded headings and in recorded earth velocities, degrees east."""

    heading: float
    velocity: float

    @property
    def differs(self) -> bool:
        """Whether headings and velocities were rotated by different angles."""
        return self.heading != self.velocity

    def __str__(self) -> str:
        return f"{{heading: {self.heading:g}, velocity: {self.velocity:g}}}" if self.differs else f"{self.heading:g}"


def parse_applied_declination(stated: float | Mapping[Any, float] | None) -> AppliedDeclination | None:
    """Parse ``declination_applied`` of a mooring file, one number for both or one for each; None if it is absent."""
    if stated is None:
        return None
    if isinstance(stated, Mapping):
        return AppliedDeclination(float(stated["heading"]), float(stated["velocity"]))
    return AppliedDeclination(float(stated), float(stated))


def resolve_settings(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Add ``field`` and ``declination_deg`` to the keys of a YAML file, as all kinds require them.

    The field is a mapping of horizontal_nT, vertical_nT and declination_deg if latitude, longitude and date are given,
    else None. The declination is the number given, else that of the field, else None.

    Raises:
        InputError: the date lies outside the model of the earth's field.
    """
    given = settings.get("declination", "auto")
    by_model = given in (None, "auto")
    latitude, longitude, date_s = (settings.get(key) for key in ("latitude", "longitude", "date_s"))
    if latitude is None or longitude is None or date_s is None:
        return {**settings, "field": None, "declination_deg": None if by_model else given}
    declination, horizontal, vertical = (float(x[0]) for x in igrf(latitude, longitude, date_s))
    field = {"horizontal_nT": horizontal, "vertical_nT": vertical, "declination_deg": declination}
    return {**settings, "field": field, "declination_deg": declination if by_model else given}
