"""The iron in the frame of the instrument: the chosen ellipsoid, turned as far as tilts and a logged heading show."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from compasslib import angles
from compasslib.calibrations.magnetometer import ellipsoid, heading
from compasslib.calibrations.magnetometer.choice import Choice
from compasslib.calibrations.magnetometer.ellipsoid import FittedEllipsoid, ScaledReadings
from compasslib.calibrations.magnetometer.log import Axes, Log, about_down
from compasslib.types import Floats

FOLLOWS = 0.5  # scatter of a logged heading about the corrected one over that about the raw one


@dataclass(frozen=True)
class Solved:
    """The iron with all that a heading needs; a replicate is the same without one block of the readings."""

    log: Log
    axes: Axes
    choice: Choice
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
        """Return the downward direction in the body frame, (n, 3)."""
        return self.levelling[:, 2, :]

    @property
    def moved(self) -> Floats:
        """Return the iron, moved by what a vertical iron that the tilts do not show would do to it, (12,).

        On a level platform with a mean tilt a vertical iron looks like a horizontal one. It may be as strong as that.
        """
        if not (self.choice.level and self.log.tilted):
            return self.iron
        hard = float(np.hypot(*self.iron[:2]))
        return self.iron + np.append(hard * self.down[:, :2].mean(axis=0), np.zeros(10))

    def corrected(self) -> Floats:
        """Return the field without iron over its modulus, (n, 3)."""
        return ellipsoid.corrected(self.iron[:3], self.iron[3:].reshape(3, 3), self.readings)

    def headings(self) -> tuple[Floats, Floats]:
        """Return recorded and corrected heading of each reading, (n,) degrees each."""
        return heading.headings(self.iron, self.readings, self.levelling)

    def gain(self, iron: Floats) -> float:
        """Return the field's modulus over the readings' scale: the mean of the axes that are seen."""
        soft = np.linalg.inv(iron[3:].reshape(3, 3))
        return float(np.mean(np.diag(soft)[: 2 if self.choice.level else 3]))

    def soft(self, iron: Floats) -> Floats:
        """Return the soft iron over the mean of its seen diagonal, body frame, (3, 3)."""
        return np.linalg.inv(iron[3:].reshape(3, 3)) / self.gain(iron)


def solve(log: Log, axes: Axes, choice: Choice, field: Mapping[str, float] | None) -> Solved | None:
    """Return the iron in the frame of the instrument; None where the choice holds no fit.

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
    solved = Solved(*parts, np.zeros((len(replicates), 3)))
    if log.tilted and not choice.level:
        solved = _on_tilts(solved)
    return _on_heading(solved)


def _on_tilts(solved: Solved) -> Solved:
    """Turn the iron into the frame of the tilt sensor, in which the vertical field is constant; that is the dip."""
    readings, down, block = solved.readings, solved.down, ellipsoid.blocks(len(solved.readings))
    turn, sine, turned = heading.tilt_angles(solved.iron, readings, down)
    each = [
        heading.tilt_angles(one, readings.take(block != k), down[block != k]) for k, one in enumerate(solved.replicates)
    ]
    turns = np.array([one[0] for one in each])
    sigma = ellipsoid.sigma(turns)
    by_heading = np.isfinite(solved.turn_deg)
    return replace(
        solved,
        iron=turned,
        replicates=np.array([one[2] for one in each]),
        dip_ratio=_ratio(sine),
        dip_replicates=np.array([_ratio(one[1]) for one in each]),
        turn_deg=np.where(by_heading, solved.turn_deg + np.nan_to_num(turn), turn),
        turn_sigma_deg=np.where(by_heading, np.hypot(solved.turn_sigma_deg, np.nan_to_num(sigma)), sigma),
        turn_replicates_deg=np.nan_to_num(turns),
    )


def _ratio(sine: float) -> float:
    return sine / float(np.sqrt(max(1.0 - sine**2, 1e-6)))


def _on_heading(solved: Solved) -> Solved:
    """Turn the iron about the vertical onto a logged heading that follows the corrected axes better than the raw ones.

    Such a heading knows what is correct, so it shows how the magnetometer is mounted.
    """
    logged = solved.log.heading_deg
    if logged is None or not solved.headed:
        return solved
    recorded, corrected = solved.headings()
    centre, scatter = _about_mean(angles.difference(logged, corrected))
    if scatter > FOLLOWS * _about_mean(angles.difference(logged, recorded))[1]:
        return solved
    own = np.array([_turn_without(solved, k, logged) for k in range(len(solved.replicates))])
    sigma = float(ellipsoid.sigma(angles.difference(own, centre) + solved.turn_replicates_deg[:, 2]))
    turns = zip(solved.replicates, own, strict=True)
    return replace(
        solved,
        iron=_about_down(solved.iron, centre),
        replicates=np.array([_about_down(one, float(angle)) for one, angle in turns]),
        turn_deg=np.append(solved.turn_deg[:2], np.nan_to_num(solved.turn_deg[2]) + centre),
        turn_sigma_deg=np.append(solved.turn_sigma_deg[:2], sigma),
        logged_is_correct=True,
    )


def _about_mean(off_deg: Floats) -> tuple[float, float]:
    centre = float(angles.wrap180(angles.mean(off_deg)))
    return centre, angles.rms(angles.difference(off_deg, centre))


def _turn_without(solved: Solved, k: int, logged_deg: Floats) -> float:
    """Return the mean angle from the corrected to the logged heading by a replicate, on the readings it was made of."""
    kept = ellipsoid.blocks(len(logged_deg)) != k
    parts = solved.replicates[k], solved.readings.take(kept), solved.levelling[kept]
    return _about_mean(angles.difference(logged_deg[kept], heading.headings(*parts)[1]))[0]


def _about_down(iron: Floats, angle_deg: float) -> Floats:
    """Return iron whose corrected headings are an angle larger."""
    return np.append(iron[:3], (about_down(angle_deg) @ iron[3:].reshape(3, 3)).ravel())
