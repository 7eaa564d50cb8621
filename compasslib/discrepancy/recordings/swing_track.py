"""A swing's log as the search needs it: samples that count, and the reading of its compass at any time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.calibration import swing_data, swing_time
from compasslib.calibration.swing_data import Observations

Floats = NDArray[np.floating]
Filter = Callable[[Floats], Floats]

KNOT_M_S = 1852.0 / 3600.0
LEAST_WATER_KN = 0.5  # of a ship's log that turns
SECOND = 1.0
SMOOTHED_S = 30.0
MOSTLY = 0.5  # share of the samples that a ship's log must have


@dataclass(frozen=True)
class Track:
    """Courses with the readings about them."""

    seen: Observations  # (n,)
    declination_deg: float
    time_s: Floats  # (m,) every second of the log
    turned_deg: Floats  # (m,) readings, not wrapped

    def reading(self, later_s: Floats | float = 0.0, filters: Sequence[Filter] = ()) -> Floats:
        """Return the reading some time after each course, (n,) degrees.

        Args:
            later_s: (n,).
            filters: of the series of readings, a sample a second.
        """
        series = self.turned_deg
        for filtered in filters:
            series = filtered(series)
        return np.interp(self.seen.time_s + later_s, self.time_s, series)

    @property
    def has_speed(self) -> bool:
        """Tell whether the courses are over ground and have speeds."""
        return self.seen.over_ground and bool(np.isfinite(self.seen.speed_kn).all())

    @property
    def ground_m_s(self) -> Floats | None:
        """Return the velocity over ground, speeds smoothed, (n, 2) true east and north; None without speeds."""
        if not self.has_speed:
            return None
        speed = KNOT_M_S * swing_time.smoothed(self.seen.speed_kn, self.seen.time_s, SMOOTHED_S)
        return np.stack(angles.components(speed, self.seen.course_deg), axis=-1)

    @property
    def logged_m_s(self) -> Floats | None:
        """Return the speed through the water, (n,), NaN where there is none; None where that is mostly so."""
        turns = np.nan_to_num(self.seen.water_speed_kn) > LEAST_WATER_KN
        return np.where(turns, KNOT_M_S * self.seen.water_speed_kn, np.nan) if turns.mean() > MOSTLY else None


def read(files: Sequence[str | Path], settings: Mapping[str, Any], declination_deg: float) -> Track:
    """Return a log's track: slow fixes are left out, turns are not, which show delays; readings are kept throughout.

    Args:
        files: tables or NMEA 0183 logs.
        settings: settled keys of the calibration's file.
        declination_deg: east positive.
    """
    turning = {**settings, "max_turn_deg_s": np.inf}
    every = swing_data.read(files, {**turning, "min_speed_kn": -1.0})
    time_s, first = np.unique(every.time_s, return_index=True)
    heading = every.recorded_deg[first]
    turned = np.cumsum(np.append(heading[:1], angles.difference(heading[1:], heading[:-1])))
    seconds = np.arange(time_s[0], time_s[-1] + SECOND, SECOND)
    return Track(swing_data.read(files, turning), declination_deg, seconds, np.interp(seconds, time_s, turned))
