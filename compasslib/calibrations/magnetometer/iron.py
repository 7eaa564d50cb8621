"""The iron in the frame of the instrument: the chosen ellipsoid, turned as far as tilts and a logged heading show."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from compasslib import angles, compass
from compasslib.calibrations.magnetometer import ellipsoid
from compasslib.calibrations.magnetometer.ellipsoid import FittedEllipsoid, ModelChoice, ScaledReadings
from compasslib.calibrations.magnetometer.log import Axes, Log, about_down, level_heading
from compasslib.calibrations.result import DeviationTable
from compasslib.deviation.series import series_design
from compasslib.types import Floats

TABLE_DEG = np.arange(0.0, 360.0, 10.0)
GRID_DEG = np.arange(0.0, 360.0, 5.0)
MAX_SCATTER_RATIO = 0.5  # scatter of a logged heading about the corrected one over that about the raw one
ROUNDS = 3  # of the tilt angles' linear step
MAX_DILUTION = 10.0  # tilt angles, radians for an error of the whole field: 0.3 % then makes 1.7 degrees


def exact_coefficients(iron: Floats, dip_ratio: float) -> Floats:
    """Compute A..E of the exact compass of an instrument that stands level, (5,).

    Args:
        dip_ratio: downward over horizontal field; 0 where the modulus is that of the horizontal field alone.
    """
    horizontal = 1.0 / np.hypot(1.0, dip_ratio)
    soft = np.linalg.inv(iron[3:].reshape(3, 3))
    return compass.level_coefficients(soft, iron[:3], horizontal_nT=horizontal, vertical_nT=dip_ratio * horizontal)


def exact_deviation(coefficients: Floats, recorded_deg: Floats) -> Floats:
    """Compute beta - gamma at recorded headings, the steadier root, (n,) degrees, of an exact compass A..E (5,)."""
    return angles.difference(compass.inverse(coefficients, recorded_deg)[:, 0], recorded_deg)


def series_coefficients(coefficients: Floats) -> Floats:
    """Fit A..E in degrees, the series in the recorded heading over the whole circle, to an exact compass, (5,)."""
    return np.linalg.lstsq(series_design(GRID_DEG), exact_deviation(coefficients, GRID_DEG), rcond=None)[0]


def deviation_table(coefficients: Floats, replicates: Floats, moved: Floats) -> DeviationTable:
    """Tabulate the exact deviation every 10 degrees of the recorded heading.

    Its uncertainty follows from the coefficients without each block, (blocks, 5), and from those moved by one standard
    deviation of what no reading shows, (5,).
    """
    value = exact_deviation(coefficients, TABLE_DEG)
    off = np.array([angles.difference(exact_deviation(each, TABLE_DEG), value) for each in (moved, *replicates)])
    return DeviationTable(TABLE_DEG, value, ellipsoid.sigma(off[1:], off[0]))


def compute_headings(iron: Floats, readings: ScaledReadings, levelling: Floats) -> tuple[Floats, Floats]:
    """Compute recorded and corrected heading of each reading, (n,) degrees each."""
    field = ellipsoid.corrected(iron, readings)
    return level_heading(readings.field, levelling), level_heading(field, levelling)


def modulus_harmonics(modulus: Floats, heading_deg: Floats) -> tuple[float, float]:
    """Fit the first and second harmonic of a modulus against the heading, percent of its mean."""
    k = np.linalg.lstsq(series_design(heading_deg), modulus, rcond=None)[0]
    return float(100.0 * np.hypot(k[1], k[2]) / k[0]), float(100.0 * np.hypot(k[3], k[4]) / k[0])


def estimate_tilt_misalignment(iron: Floats, readings: ScaledReadings, down: Floats) -> tuple[Floats, float, Floats]:
    """Estimate the small turn from the magnetometer to the tilt sensor that keeps the vertical field constant.

    With the downward direction t the vertical field t . (h + e x h) is one number c wherever the instrument points, so
    t . h = c - e . (h x t) is linear in the turn e about forward, starboard and down.

    Returns:
        The turn (3,) in degrees, NaN about an axis that the tilts do not determine; c, the sine of the dip; and the
        iron with the turn in its G.
    """
    field = ellipsoid.corrected(iron, readings)
    turn, wide = np.eye(3), np.zeros(3, dtype=bool)
    for _ in range(ROUNDS):
        turned = field @ turn.T
        columns = np.column_stack([np.ones(len(field)), -np.cross(turned, down)])
        if not wide.any():
            values, vectors = np.linalg.eigh(columns.T @ columns / len(columns))
            inverse = (vectors / np.maximum(values, 1e-14)) @ vectors.T
            wide = np.sqrt(np.diag(inverse))[1:] > MAX_DILUTION
        columns[:, 1:] *= ~wide
        solved = np.linalg.lstsq(columns, np.sum(turned * down, axis=1), rcond=None)[0]
        turn = _rotation(solved[1:]) @ turn
    vector = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2.0
    matrix = turn @ iron[3:].reshape(3, 3)
    return np.where(wide, np.nan, vector / angles.DEGREE), float(solved[0]), np.append(iron[:3], matrix.ravel())


def _rotation(vector: Floats) -> Floats:
    """Rotate about a vector by its length, radians (Rodrigues)."""
    length = float(np.linalg.norm(vector))
    x, y, z = vector / max(length, 1e-300)
    across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, cosine = (float(v) for v in angles.sin_cos(length / angles.DEGREE))
    return np.eye(3) + sine * across + (1.0 - cosine) * across @ across


@dataclass(frozen=True)
class SolvedIron:
    """The iron with all that a heading needs; a replicate is the same without one block of the readings."""

    log: Log
    axes: Axes
    choice: ModelChoice
    fitted: FittedEllipsoid
    readings: ScaledReadings
    iron: Floats  # (12,) centre and G over the readings' scale
    replicates: Floats  # (blocks, 12)
    levelling: Floats  # (n, 3, 3)
    dip_ratio: float  # downward over horizontal field; 0 on a level platform, NaN where unknown
    dip_replicates: Floats  # (blocks,)
    turn_deg: Floats  # (3,) from magnetometer to instrument about forward, starboard, down; NaN where open
    turn_sigma_deg: Floats  # (3,)
    turn_replicates_deg: Floats  # (blocks, 3) what tilts add to the turn, 0 where nothing
    logged_is_correct: bool = False  # the logged heading follows the corrected axes

    @property
    def headed(self) -> bool:
        """Whether the readings have headings: they are levelled, or level."""
        return self.log.tilted or self.choice.level

    @property
    def down(self) -> Floats:
        """The downward direction in the body frame, (n, 3)."""
        return self.levelling[:, 2, :]

    @property
    def moved(self) -> Floats:
        """The iron moved by a vertical iron that the tilts do not show, (12,).

        On a level platform with a mean tilt a vertical iron looks like a horizontal one. It may be as strong as that.
        """
        if not (self.choice.level and self.log.tilted):
            return self.iron
        hard = float(np.hypot(*self.iron[:2]))
        return self.iron + np.append(hard * self.down[:, :2].mean(axis=0), np.zeros(10))

    def corrected(self) -> Floats:
        """Take the iron off the readings: the field over its modulus, (n, 3)."""
        return ellipsoid.corrected(self.iron, self.readings)

    def headings(self) -> tuple[Floats, Floats]:
        """Compute recorded and corrected heading of each reading, (n,) degrees each."""
        return compute_headings(self.iron, self.readings, self.levelling)

    def gain(self, iron: Floats) -> float:
        """Compute the field's modulus over the readings' scale: the mean of the axes that are seen."""
        soft = np.linalg.inv(iron[3:].reshape(3, 3))
        return float(np.mean(np.diag(soft)[: 2 if self.choice.level else 3]))

    def soft(self, iron: Floats) -> Floats:
        """Compute the soft iron over the mean of its seen diagonal, body frame, (3, 3)."""
        return np.linalg.inv(iron[3:].reshape(3, 3)) / self.gain(iron)


def solve_iron(log: Log, axes: Axes, choice: ModelChoice, field: Mapping[str, float] | None) -> SolvedIron | None:
    """Express the iron in the frame of the instrument; None where the choice holds no fit.

    Args:
        field: the earth's field {horizontal_nT, vertical_nT}, which gives the dip where no tilts do; None if unknown.
    """
    if choice.fitted is None or choice.readings is None:
        return None
    iron, replicates = choice.fitted.iron()
    dip = 0.0 if choice.level else np.nan if field is None else field["vertical_nT"] / field["horizontal_nT"]
    turn, sigma = np.array([np.nan, np.nan, axes.vertical_deg]), np.array([np.nan, np.nan, axes.vertical_sigma_deg])
    levelling, dips = log.levelling(), np.full(len(replicates), dip)
    parts = (log, axes, choice, choice.fitted, choice.readings, iron, replicates, levelling, dip, dips, turn, sigma)
    solved = SolvedIron(*parts, np.zeros((len(replicates), 3)))
    if log.tilted and not choice.level:
        solved = _align_to_tilts(solved)
    return _align_to_heading(solved)


def _align_to_tilts(solved: SolvedIron) -> SolvedIron:
    """Turn the iron into the frame of the tilt sensor, in which the vertical field is constant; that is the dip."""
    readings, down, block = solved.readings, solved.down, ellipsoid.blocks(len(solved.readings))
    turn, sine, turned = estimate_tilt_misalignment(solved.iron, readings, down)
    parts = [(each, block != k) for k, each in enumerate(solved.replicates)]
    each = [estimate_tilt_misalignment(iron, readings.take(kept), down[kept]) for iron, kept in parts]
    turns = np.array([replicate[0] for replicate in each])
    sigma = ellipsoid.sigma(turns)
    by_heading = np.isfinite(solved.turn_deg)
    return replace(
        solved,
        iron=turned,
        replicates=np.array([replicate[2] for replicate in each]),
        dip_ratio=_dip_ratio(sine),
        dip_replicates=np.array([_dip_ratio(replicate[1]) for replicate in each]),
        turn_deg=np.where(by_heading, solved.turn_deg + np.nan_to_num(turn), turn),
        turn_sigma_deg=np.where(by_heading, np.hypot(solved.turn_sigma_deg, np.nan_to_num(sigma)), sigma),
        turn_replicates_deg=np.nan_to_num(turns),
    )


def _dip_ratio(sine: float) -> float:
    return sine / float(np.sqrt(max(1.0 - sine**2, 1e-6)))


def _align_to_heading(solved: SolvedIron) -> SolvedIron:
    """Turn the iron about the vertical onto a logged heading that follows the corrected axes better than the raw ones.

    Such a heading knows what is correct, so it shows how the magnetometer is mounted.
    """
    logged = solved.log.heading_deg
    if logged is None or not solved.headed:
        return solved
    recorded, corrected = solved.headings()
    centre, scatter = _about_mean(angles.difference(logged, corrected))
    if scatter > MAX_SCATTER_RATIO * _about_mean(angles.difference(logged, recorded))[1]:
        return solved
    block, angles_deg = ellipsoid.blocks(len(logged)), []
    for k, replicate in enumerate(solved.replicates):  # each on the readings that it was made of
        remaining = block != k
        headings = compute_headings(replicate, solved.readings.take(remaining), solved.levelling[remaining])
        angles_deg.append(_about_mean(angles.difference(logged[remaining], headings[1]))[0])
    turns_deg = np.array(angles_deg)
    sigma = float(ellipsoid.sigma(angles.difference(turns_deg, centre) + solved.turn_replicates_deg[:, 2]))
    turns = zip(solved.replicates, turns_deg, strict=True)
    return replace(
        solved,
        iron=_about_down(solved.iron, centre),
        replicates=np.array([_about_down(replicate, float(angle)) for replicate, angle in turns]),
        turn_deg=np.append(solved.turn_deg[:2], np.nan_to_num(solved.turn_deg[2]) + centre),
        turn_sigma_deg=np.append(solved.turn_sigma_deg[:2], sigma),
        logged_is_correct=True,
    )


def _about_mean(off_deg: Floats) -> tuple[float, float]:
    centre = float(angles.wrap180(angles.mean(off_deg)))
    return centre, angles.rms(angles.difference(off_deg, centre))


def _about_down(iron: Floats, angle_deg: float) -> Floats:
    """Turn iron so that corrected headings are an angle larger."""
    return np.append(iron[:3], (about_down(angle_deg) @ iron[3:].reshape(3, 3)).ravel())
