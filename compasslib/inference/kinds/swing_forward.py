"""Forward models of a swing's log: the heading by its courses against that by its compass, and its two speeds."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.calibrations.swing import data
from compasslib.calibrations.swing import data as swing_time
from compasslib.calibrations.swing.data import Observations
from compasslib.deviation import von_appen
from compasslib.effects import composition
from compasslib.effects.composition import Simulation
from compasslib.effects.term import Scene, Term
from compasslib.statistics import robust
from compasslib.types import Floats

Filter = Callable[[Floats], Floats]

STRETCH_S, MOST_STRETCHES = 20.0, 150  # a helmsman's swing about the course is over in that time
FULL = 0.25  # of the usual number of samples that a stretch needs
WIDE = 4.0  # robust widths from its stretch's median beyond which a sample is an outlier


@dataclass(frozen=True)
class Stretches:
    """Samples gathered in stretches of time, k of them, those without a stretch left out."""

    number: NDArray[np.intp]  # (n,) of each sample's stretch, -1 for none
    count: NDArray[np.intp]  # (k,) samples

    def __len__(self) -> int:
        return len(self.count)

    def without(self, lost: NDArray[np.bool_]) -> Stretches:
        """Return the stretches without some samples; those that keep none are left out.

        Args:
            lost: (n,).
        """
        number = np.where(lost, -1, self.number)
        count = np.bincount(number[number >= 0], minlength=len(self))
        new = np.where(count > 0, np.cumsum(count > 0) - 1, -1)
        return Stretches(np.where(number >= 0, new[number], -1), count[count > 0])

    def mean(self, x: Floats) -> Floats:
        """Return the mean over each stretch, (k,).

        Args:
            x: (n,).
        """
        used = self.number >= 0
        return np.asarray(np.bincount(self.number[used], x[used], len(self.count)) / self.count)

    def heading(self, x_deg: Floats) -> Floats:
        """Return the mean direction of each stretch, (k,) degrees.

        Args:
            x_deg: (n,).
        """
        sine, cosine = angles.sin_cos(x_deg)
        return angles.direction(self.mean(sine), self.mean(cosine))


def stretches(time_s: Floats, good: NDArray[np.bool_]) -> Stretches:
    """Return stretches of 20 s, longer ones where a log lasts hours; thin ones are left out.

    Args:
        time_s: (n,) increasing.
        good: samples that count, (n,).
    """
    count = len(np.unique(np.floor((time_s - time_s[0]) / STRETCH_S)))
    length = STRETCH_S * max(1.0, count / MOST_STRETCHES)
    number = np.floor((time_s - time_s[0]) / length).astype(np.intp)
    there = np.bincount(number[good])
    full = there >= FULL * np.median(there[there > 0])
    new = np.where(full, np.cumsum(full) - 1, -1)
    kept = np.where(good, new[np.minimum(number, len(new) - 1)], -1)
    return Stretches(kept, there[full])


def without_outliers(time_s: Floats, off_deg: Floats) -> Stretches:
    """Return the stretches without the samples that lie far from their neighbours.

    Args:
        time_s: (n,) increasing.
        off_deg: course minus reading, (n,).
    """
    first = stretches(time_s, np.ones(len(time_s), dtype=bool))
    inside = first.number >= 0
    middle = np.full(len(first), np.nan)
    for k in range(len(first)):
        own = off_deg[first.number == k]
        middle[k] = own[0] + np.median(angles.difference(own, own[0]))
    away = np.where(inside, np.abs(angles.difference(off_deg, middle[first.number])), np.inf)
    return stretches(time_s, away <= WIDE * max(robust.width(away[inside]), 0.5))


@dataclass(frozen=True)
class ByCourse:
    """Heading by the courses, freed of the water, minus that by the compass: means over stretches."""

    ground_m_s: Floats | None  # (n, 2) velocity over ground, true east and north; None without speeds
    course_deg: Floats  # (n,) true north
    declination_deg: float
    reading: Callable[[Floats, Sequence[Filter]], Floats]  # seconds later, (n,), filters of the series -> (n,) degrees
    scene: Scene
    exact: bool  # the exact compass instead of the series in the recorded heading
    over: Stretches

    def __call__(self, base: Floats, terms: tuple[Term, ...]) -> Floats:
        """Return observed minus simulated heading, (k,) degrees; base is A to E, degrees or dimensionless."""
        correct = self.by_course(terms)
        later: Floats = np.zeros(len(self.scene))
        for term in (term for term in terms if term.acts_on == "time"):
            later = term.act(later, self.scene)
        recorded = self.reading(later, [partial(term.act, scene=self.scene) for term in terms if _of_course(term)])
        rest = tuple(term for term in terms if term.acts_on in ("field", "reading") and not _of_course(term))
        if self.exact:
            simulation = Simulation(base, float(np.mean(self.scene.horizontal_nT)), rest)
            shown = composition.recorded_heading(simulation, self.scene, correct)
            return self.over.mean(angles.difference(shown, recorded))
        bare = Simulation(np.zeros(5), float(np.mean(self.scene.horizontal_nT)), rest)
        undone = composition.undone_readout(bare, self.scene, recorded)
        return self.over.mean(angles.difference(correct, undone + von_appen.design(undone) @ base))

    def by_course(self, terms: tuple[Term, ...]) -> Floats:
        """Return the magnetic headings that the courses stand for, (n,) degrees.

        Args:
            terms: those of the water take their part of the velocity over ground.
        """
        if self.ground_m_s is None:
            return self.course_deg - self.declination_deg
        through = self.ground_m_s - water(terms, self.scene)
        return angles.direction(through[:, 0], through[:, 1]) - self.declination_deg


@dataclass(frozen=True)
class BySpeed:
    """Speed through the water by the velocity over ground minus that of the ship's log, as degrees of the speed."""

    ground_m_s: Floats  # (n, 2) true east and north
    logged_m_s: Floats  # (n,)
    scene: Scene
    over: Stretches

    def __call__(self, base: Floats, terms: tuple[Term, ...]) -> Floats:
        """Return observed minus simulated speed over the mean speed, (k,) degrees; base is the log's scale and zero."""
        through = self.ground_m_s - water(terms, self.scene)
        off = np.hypot(through[:, 0], through[:, 1]) - base[0] * self.logged_m_s - base[1]
        return self.over.mean(off / angles.DEGREE / float(np.mean(np.hypot(*self.ground_m_s.T))))


def _of_course(term: Term) -> bool:
    """Tell whether a term acts on the heading that the course follows."""
    return term.acts_on == "reading" and term.side == "reference"


def water(terms: tuple[Term, ...], scene: Scene) -> Floats:
    """Return the velocity of the water, (n, 2) m/s true east and north."""
    moving: Floats = np.zeros((len(scene), 2))
    for term in (term for term in terms if term.acts_on == "velocity"):
        moving = term.act(moving, scene)
    return moving


# A swing's log as the search needs it: samples that count, and the reading of its compass at any time.

KNOT_M_S = 1852.0 / 3600.0
LEAST_WATER_KN = 0.5  # of a ship's log that turns
SECOND = 1.0  # s: spacing of the grid on which courses are filtered
SMOOTHED_S = 30.0  # of a ship's log, whose ticks are coarse: longer than a swell, shorter than a turn
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
    every = data.read(files, {**turning, "min_speed_kn": -1.0})
    time_s, first = np.unique(every.time_s, return_index=True)
    heading = every.recorded_deg[first]
    turned = np.cumsum(np.append(heading[:1], angles.difference(heading[1:], heading[:-1])))
    seconds = np.arange(time_s[0], time_s[-1] + SECOND, SECOND)
    return Track(data.read(files, turning), declination_deg, seconds, np.interp(seconds, time_s, turned))
