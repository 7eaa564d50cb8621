"""Forward models of a magnetometer's log: the heading of its axes and their modulus, with terms of physics between."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compasslib import angles, compass
from compasslib.calibration import ellipsoid
from compasslib.calibration.magnetometer_log import Log
from compasslib.discrepancy import covariates as covariates_of
from compasslib.discrepancy.recordings.channel import thinned
from compasslib.discrepancy.recordings.terms import moving
from compasslib.physics.term import Scene, Term

Floats = NDArray[np.floating]

MOST_SAMPLES = 2500
WOBBLE_SAMPLES = 31  # tilts faster than this are mostly accelerations
DEGREES_A_RADIAN = 1.0 / angles.DEGREE


@dataclass(frozen=True)
class OfHeading:
    """Logged heading minus that of the axes as they stand, taken through the terms."""

    field_nT: Floats  # (n, 3) forward, starboard, down, scaled
    logged_deg: Floats  # (n,)
    scene: Scene

    def __call__(self, base: Floats, terms: tuple[Term, ...]) -> Floats:
        """Return observed minus simulated heading, (n,) degrees; iron is what the logged heading was freed of."""
        field = self.field_nT
        iron = [term for term in terms if term.acts_on == "field" and term.stage == "surroundings"]
        field = freed(field, iron, self.scene)
        for term in (term for term in terms if term.acts_on == "field" and term.stage == "sensor"):
            field = term.act(field, self.scene)
        reading = angles.argument(field[:, 0] - 1j * field[:, 1])
        for term in (term for term in terms if term.acts_on == "reading"):
            reading = term.act(reading, self.scene)
        return angles.difference(self.logged_deg, reading)


@dataclass(frozen=True)
class OfModulus:
    """The relative modulus of the axes, freed of iron, minus a constant, in degrees of what it does to a heading."""

    field_nT: Floats  # (n, 3)
    down: Floats  # (n, 3) zero in space
    strength_nT: float
    scene: Scene
    wobble: Floats  # (n, k) what the noise of the tilt sensor makes of the modulus, a share of it

    def __call__(self, base: Floats, terms: tuple[Term, ...]) -> Floats:
        """Return observed minus simulated modulus, (n,) degrees."""
        modulus = ellipsoid.modulus(freed(self.field_nT, terms, self.scene), self.down)
        return DEGREES_A_RADIAN * (modulus / self.strength_nT - 1.0) - base[0] - self.wobble @ base[1:]


def freed(field_nT: Floats, terms: Sequence[Term], scene: Scene) -> Floats:
    """Return the field without the iron that terms add: the inverse of their sum of a matrix and a vector.

    Args:
        field_nT: as read, (n, 3).
        terms: that act on the field.
        scene: in what it was read.
    """
    soft, zero = np.eye(3), np.zeros((len(field_nT), 3))
    hard: Floats = np.zeros((len(field_nT), 3))
    for term in terms:
        none = term.act(zero, scene)
        hard = hard + none
        if term.name == "soft_iron":
            soft = soft + np.stack([(term.act(zero + unit, scene) - unit)[0] for unit in np.eye(3)], axis=1)
    return np.asarray((field_nT - hard) @ np.linalg.inv(soft).T)


def warmed(log: Log) -> bool:
    """Return whether a temperature that varies was logged.

    Args:
        log: of the magnetometer.
    """
    return log.temperature_c is not None and bool(np.isfinite(log.temperature_c).any() and np.nanstd(log.temperature_c))


def wobble(log: Log, field_nT: Floats, down: Floats, strength_nT: float) -> Floats:
    """Return what the fast part of each tilt does to the modulus, (n, 2) degrees.

    Waves and handling accelerate the tilt sensor: what it then adds to the tilt stands in the modulus too.
    """
    modulus, pairs = ellipsoid.modulus(field_nT, down), ((1.0, 0.0), (0.0, 1.0))
    assert log.pitch_deg is not None and log.roll_deg is not None
    columns = []
    for by_pitch, by_roll in pairs:
        fast = by_pitch * _fast(log.pitch_deg) + by_roll * _fast(log.roll_deg)
        moved = compass.levelling(log.pitch_deg + by_pitch * fast, log.roll_deg + by_roll * fast)[:, 2, :]
        columns.append(DEGREES_A_RADIAN * (ellipsoid.modulus(field_nT, moved) - modulus) / strength_nT)
    return np.stack(columns, axis=1)


def _fast(x: Floats) -> Floats:
    """Return a series without its running mean."""
    span = min(WOBBLE_SAMPLES, len(x))
    together = np.convolve(np.ones(len(x)), np.ones(span), "same")
    return x - np.convolve(x, np.ones(span), "same") / together


def scene_of(log: Log, simulated_deg: Floats, body: Floats) -> tuple[Scene, dict[str, Floats], NDArray[np.intp], bool]:
    """Return in what the log was made and its covariates, thinned, which samples stay, and whether it has a clock."""
    n = len(log.raw)
    some = thinned(n, MOST_SAMPLES)
    clocked = log.time_s is not None and bool(np.isfinite(log.time_s).all() and np.all(np.diff(log.time_s) > 0.0))
    time_s = log.time_s if clocked and log.time_s is not None else np.arange(1.0, n + 1.0)
    zero = np.zeros(n)
    pitch, roll = (zero if tilt is None else tilt for tilt in (log.pitch_deg, log.roll_deg))
    turned = np.cumsum(np.append(0.0, angles.difference(simulated_deg[1:], simulated_deg[:-1])))
    rate = np.gradient(turned, time_s)
    columns = {"heading": angles.wrap360(simulated_deg), "time" if clocked else "reading": time_s}
    columns |= {"pitch": pitch, "roll": roll} if log.tilted else {}
    columns |= {"turn_rate": rate} if clocked else {}
    columns |= {"vertical_field": body[:, 2] / abs(body[:, 2].mean())} if log.has_z and body[:, 2].mean() else {}
    if log.temperature_c is not None and warmed(log):
        columns["temperature"] = covariates_of.filled(log.temperature_c)
    columns = {name: column[some] for name, column in columns.items()}
    departures = {name: column - column.mean() for name, column in columns.items() if name == "temperature"}
    departures["turn_rate"] = rate[some]
    one, at = np.ones(len(some)), time_s[some]

    def ahead(seconds: float) -> Floats:
        return np.interp(at + seconds, time_s, turned) - turned[some]

    scene = moving(Scene(at, one, one, pitch[some], roll[some], float(time_s[0]), departures), ahead)
    scene.__dict__["levelling"] = log.levelling()[some]  # by the log's own rule, where the cached property keeps it
    return scene, columns, some, clocked
