"""Simulation of a compass near iron: the earth's field, iron, tilt and levelling, and its magnetometer."""

from dataclasses import dataclass, replace
from datetime import UTC, datetime

import numpy as np
from numpy.typing import ArrayLike

from compasslib import angles
from compasslib.types import DAY_S, Floats


@dataclass(frozen=True)
class Iron:
    """The iron fixed to an instrument, in its body frame: forward (beam 3), starboard, down."""

    hard_nt: tuple[float, float, float] = (0.0, 0.0, 0.0)
    #: matrix from the earth's field to that at the sensor
    soft: tuple[tuple[float, float, float], ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True)
class Field:
    """The earth's field at one place, at nodes in time."""

    time_s: Floats  # (k,)
    declination_deg: Floats  # (k,) east positive
    horizontal_nt: Floats  # (k,)
    vertical_nt: Floats  # (k,) down positive

    def at(self, time_s: Floats) -> tuple[Floats, Floats, Floats]:
        """Interpolate declination (degrees), horizontal and vertical field (nT) to times of any shape."""
        nodes = (self.declination_deg, self.horizontal_nt, self.vertical_nt)
        declination, horizontal, vertical = (np.interp(time_s, self.time_s, node) for node in nodes)
        return np.asarray(declination), np.asarray(horizontal), np.asarray(vertical)


def earth_field(latitude_deg: float, longitude_deg: float, span_s: tuple[float, float]) -> Field:
    """Compute the IGRF field over a span of time, at nodes a month apart."""
    import ppigrf  # deferred: the import takes half a second, most of it for pandas

    nodes = np.linspace(*span_s, 2 + int((span_s[1] - span_s[0]) / (30 * DAY_S)))
    dates = [datetime.fromtimestamp(t, UTC).replace(tzinfo=None) for t in nodes]
    east, north, up = (np.ravel(b).astype(float) for b in ppigrf.igrf(longitude_deg, latitude_deg, 0.0, dates))
    return Field(nodes, np.rad2deg(np.arctan2(east, north)), np.hypot(east, north), -up)


def recorded_heading(
    field_nt: tuple[ArrayLike, ArrayLike],
    heading_deg: ArrayLike,
    *,
    tilt_deg: tuple[ArrayLike, ArrayLike],
    sensed_tilt_deg: tuple[ArrayLike, ArrayLike] | None = None,
    iron: Iron,
) -> Floats:
    """Compute the recorded heading before noise, degrees.

    The field at the sensor is S C^T F + b with C = Rz(heading) Ry(pitch) Rx(roll).

    Args:
        field_nt: horizontal and vertical (down) field, each (n,) or a scalar.
        heading_deg: correct magnetic heading of beam 3, (n,).
        tilt_deg: true pitch (forward up) and roll (starboard down), (n,) each.
        sensed_tilt_deg: the same as recorded by the instrument's sensor; the true tilts if None.
    """
    felt_nt = body_field(field_nt, heading_deg, tilt_deg) @ np.asarray(iron.soft).T + np.asarray(iron.hard_nt)
    return angles.wrap360(levelled_heading(felt_nt, sensed_tilt_deg or tilt_deg))


def body_field(
    field_nt: tuple[ArrayLike, ArrayLike], heading_deg: ArrayLike, tilt_deg: tuple[ArrayLike, ArrayLike]
) -> Floats:
    """Rotate the earth's field into the body frame, (..., 3) nT; arguments as for ``recorded_heading``."""
    sine, cosine = angles.sin_cos(heading_deg)
    horizontal, vertical = np.broadcast_arrays(*field_nt, sine)[:2]
    level = np.stack([horizontal * cosine, -horizontal * sine, vertical], axis=-1)
    return np.einsum("...ji,...j->...i", tilting(*tilt_deg), level)


def levelled_heading(felt_nt: Floats, sensed_tilt_deg: tuple[ArrayLike, ArrayLike]) -> Floats:
    """Level the field at the sensor by the recorded tilts, and compute the angle of its horizontal part, degrees."""
    levelled = np.einsum("...ij,...j->...i", tilting(*sensed_tilt_deg), felt_nt)
    return np.rad2deg(np.arctan2(-levelled[..., 1], levelled[..., 0]))


def tilting(pitch_deg: ArrayLike, roll_deg: ArrayLike) -> Floats:
    """Compute Ry(pitch) Rx(roll), (..., 3, 3)."""
    sp, cp, sr, cr = np.broadcast_arrays(*angles.sin_cos(pitch_deg), *angles.sin_cos(roll_deg))
    rows = ((cp, sp * sr, sp * cr), (np.zeros_like(cp), cr, -sr), (-sp, cp * sr, cp * cr))
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


@dataclass(frozen=True, eq=False)
class Magnetometer:
    """Three sensors, one per row, and the iron near them, fixed to the body: forward, starboard, down."""

    magnets: tuple[tuple[Floats, Floats], ...]  # place, m, and moment, A m2, of each point dipole
    ball: tuple[Floats, float]  # place and radius, m, of a ball of soft iron, magnetised by the ambient field
    places_m: Floats  # (3, 3) positions of the sensors
    axes: Floats  # (3, 3) sensitivity of each sensor, nearly a unit vector
    trim_nt: ArrayLike = 0.0  # (3,) offset removed by the maker's calibration
    even: ArrayLike = 0.0  # (3,) quadratic error at full scale, as a fraction of it
    step_nt: float = 40.0


FULL_SCALE_NT = 50_000.0  # to which the quadratic error of a sensor refers


def build(rng: np.random.Generator, earth_nt: tuple[float, float], strength: float) -> Magnetometer:
    """Build a magnetometer whose hard iron is a given share of the horizontal field."""
    places = rng.normal(0.0, 0.015, (3, 3))
    axes = np.eye(3) * (1.0 + rng.normal(0.0, 0.004, 3))[:, None] + rng.normal(0.0, 0.004, (3, 3))
    magnets = []
    for _ in range(rng.integers(3, 6)):
        moment = rng.normal(0.0, 1.0, 3)
        magnets.append((_place(rng, 0.3, 1.0), moment))
    ball = (_place(rng, 0.6, 1.0), float(rng.uniform(0.08, 0.18)))
    made = Magnetometer(tuple(magnets), ball, places, axes, even=rng.normal(0.0, 0.0008, 3))
    added = response(made)[1]
    scale = strength * earth_nt[0] / max(float(np.hypot(added[0], added[1])), 1.0)
    meter = replace(made, magnets=tuple((place, scale * moment) for place, moment in magnets))
    matrix, added = response(meter)
    vertical = added[2] + (matrix[2, 2] - 0.5 * (matrix[0, 0] + matrix[1, 1])) * earth_nt[1]
    return replace(meter, trim_nt=np.array([0.0, 0.0, vertical + rng.normal(0.0, 100.0)]))


def response(meter: Magnetometer) -> tuple[Floats, Floats]:
    """Compute the linear response to the earth's field: matrix, (3, 3), and offset, (3,) nT."""
    added, soft, (ball_m, radius_m) = np.zeros((3, 3)), np.zeros((3, 3, 3)), meter.ball
    for k, sensor_m in enumerate(meter.places_m):
        added[k] = sum((dipole_nt(moment, sensor_m - place) for place, moment in meter.magnets), np.zeros(3))
        # A ball of high permeability adds a dipole along the field of the earth.
        distance = float(np.linalg.norm(sensor_m - ball_m))
        unit = (sensor_m - ball_m) / distance
        soft[k] = np.eye(3) + (radius_m / distance) ** 3 * (3.0 * np.outer(unit, unit) - np.eye(3))
    matrix = np.einsum("ij,ijk->ik", meter.axes, soft)
    return matrix, np.einsum("ij,ij->i", meter.axes, added) - meter.trim_nt


def felt(meter: Magnetometer, body_nt: Floats, nearby_nt: Floats | float = 0.0, *, stepped: bool = True) -> Floats:
    """Simulate the output of the sensors, (..., 3) nT, in the earth's field and that of objects near by."""
    matrix, added = response(meter)
    raw = body_nt @ matrix.T + added + nearby_nt
    curved = raw + FULL_SCALE_NT * np.asarray(meter.even) * (raw / FULL_SCALE_NT) ** 2
    return np.asarray(meter.step_nt * np.rint(curved / meter.step_nt) if stepped else curved)


def dipole_nt(moment_a_m2: Floats, away_m: Floats) -> Floats:
    """Compute the field of a dipole, (3,) nT, at a position relative to it."""
    distance = float(np.linalg.norm(away_m))
    unit = away_m / distance
    field_t = 1e-7 * (3.0 * unit * (moment_a_m2 @ unit) - moment_a_m2) / distance**3  # mu0 / 4 pi = 1e-7
    return np.asarray(1e9 * field_t)


def _place(rng: np.random.Generator, nearest: float, farthest: float) -> Floats:
    away = rng.normal(size=3)
    return np.asarray(rng.uniform(nearest, farthest) * away / np.linalg.norm(away))
