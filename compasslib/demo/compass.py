"""What a compass near iron reads: the earth's field, the iron's own, the tilt, and the instrument's levelling."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
from numpy.typing import ArrayLike

from compasslib.demo.series import DAY_S, Floats, circle

NOISE_DEG = 0.5
TILT_NOISE_DEG = 0.05  # of an average over an ensemble's pings; the vertical field turns it into heading noise
NO_SOFT_IRON = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True)
class Iron:
    """The iron fixed to an instrument, in its body frame: forward (beam 3), starboard, down."""

    hard_nt: tuple[float, float, float] = (0.0, 0.0, 0.0)
    soft: tuple[tuple[float, float, float], ...] = NO_SOFT_IRON  # field at the sensor from field of the earth


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
    import ppigrf  # half a second, most of it pandas: paid once, and only where a mooring is made

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
    """Compute the heading that the compass gives, before its noise, degrees in [0, 360).

    The field at the sensor is S C^T F + b with C = Rz(heading) Ry(pitch) Rx(roll); the instrument levels it with the
    tilts that its own sensor gives and takes the angle of the horizontal part.

    Args:
        field_nt: horizontal and vertical (down) field, each (n,) or one number.
        heading_deg: correct magnetic heading of beam 3, (n,).
        tilt_deg: true pitch (forward up) and roll (starboard down), (n,) each.
        sensed_tilt_deg: the same as the instrument senses them; the true ones where absent.
    """
    horizontal, vertical = np.broadcast_arrays(*field_nt, np.asarray(heading_deg, dtype=float))[:2]
    turn = np.deg2rad(np.asarray(heading_deg, dtype=float))
    level = np.stack([horizontal * np.cos(turn), -horizontal * np.sin(turn), vertical], axis=-1)
    body = np.einsum("nji,nj->ni", tilting(*tilt_deg), level)
    felt = body @ np.asarray(iron.soft).T + np.asarray(iron.hard_nt)
    levelled = np.einsum("nij,nj->ni", tilting(*(sensed_tilt_deg or tilt_deg)), felt)
    return circle(np.rad2deg(np.arctan2(-levelled[:, 1], levelled[:, 0])))


def tilting(pitch_deg: ArrayLike, roll_deg: ArrayLike) -> Floats:
    """Compute Ry(pitch) Rx(roll), (n, 3, 3)."""
    pitch, roll = np.broadcast_arrays(np.deg2rad(pitch_deg), np.deg2rad(roll_deg))
    sp, cp, sr, cr = np.sin(pitch), np.cos(pitch), np.sin(roll), np.cos(roll)
    zero = np.zeros_like(cp)
    rows = ((cp, sp * sr, sp * cr), (zero, cr, -sr), (-sp, cp * sr, cp * cr))
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
