"""Diagnose a magnetometer's log against an iron-free, level compass.

The logged heading against that of the raw axes shows the processing in between; the modulus of the axes shows iron: its
relative change, taken as radians, is the size of the heading error.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.signal import savgol_filter

from compasslib import angles, compass
from compasslib.calibrations.magnetometer import ellipsoid
from compasslib.calibrations.magnetometer import log as magnetometer_log
from compasslib.calibrations.magnetometer.ellipsoid import ModelChoice
from compasslib.calibrations.magnetometer.log import Log
from compasslib.effects import iron
from compasslib.effects.effect import Effect, Scene, turning_scene
from compasslib.effects.iron import HardIron, LevelHardIron, LevelSoftIron
from compasslib.effects.readout import CompassDelay, HeadingSlip, MountingOffset, ReadingLevelled
from compasslib.inference import covariates as covariate_series
from compasslib.inference import diagnosis, short_search
from compasslib.inference.comparison import Options
from compasslib.inference.diagnosis import Diagnosis
from compasslib.inference.kinds.platform import PLACELESS_NT, READOUT, recording_scene, thin_indices
from compasslib.inference.short_model import ShortComparison
from compasslib.inference.short_search import build_outcome
from compasslib.types import Floats

LEVEL_TILT_DEG = 15.0  # largest plausible mean tilt of a log without tilts
DELAYED_BY = (7, 3)  # window (readings) and polynomial order of the filter for interpolating delayed headings
FEWEST_TURN_DEG = 5.0  # least rms variation of the headings for a comparison
# Accuracy of the simulated levelling and rounding: of a 3D-ACM by its cosine rule, a Signature500 by full rotation.
RULE_DEG = 0.03
WOBBLE_SAMPLES = 31  # window of the running mean of tilts; faster changes are mostly accelerations


def diagnose(files: Sequence[str | Path], settings: Mapping[str, Any], options: Options) -> Diagnosis:
    """Diagnose a magnetometer's log, CSV or A files of a 3D-ACM, against an iron-free, level compass."""
    log = magnetometer_log.read(files, settings)
    return diagnose_log(log, field=settings.get("field"), options=options)


def diagnose_log(log: Log, *, field: Mapping[str, float] | None, options: Options) -> Diagnosis:
    """Diagnose a log."""
    if len(log.raw) < magnetometer_log.MIN_READINGS:
        return diagnosis.insufficient(magnetometer_log.unusable_reason(log))
    choice: ModelChoice | str  # the fitted ellipsoid, or why the readings do not show iron
    if magnetometer_log.are_direction_cosines(log):
        choice = magnetometer_log.COSINES
    else:
        choice = magnetometer_log.unusable_reason(log) or ellipsoid.choose_model(log, log.raw)
    why_not = choice if isinstance(choice, str) else ""
    axes, no_heading = _axes(log, choice)
    missing = {
        "hard_iron": why_not,
        "tilt_uncompensated": "" if log.tilted else "no tilts were logged",
        "temperature": "" if _warmed(log) else "no temperature that varies was logged",
        "compass_lag": no_heading,
    }
    not_testable = tuple((effect, why) for effect, why in missing.items() if why)
    if why_not and no_heading:
        return diagnosis.insufficient(f"{why_not.rstrip('.')}, and {no_heading}", not_testable)
    parts = [] if isinstance(choice, str) else [_compare_modulus(log, axes, choice, field)]
    parts += [] if no_heading else [_compare_heading(log, axes, field)]
    outcomes = [build_outcome(short_search.search_effects(part, options), options.min_effect_deg) for part in parts]
    return diagnosis.combine_outcomes(outcomes, options, not_testable=not_testable)


def _axes(log: Log, choice: ModelChoice | str) -> tuple[Floats, str]:
    """Orient the axes, with or without their iron, by the logged heading, or explain why it does not follow them."""
    if log.heading_deg is None:
        return np.eye(3), "no heading was logged to hold that of the axes against"
    if angles.rms(angles.difference(log.heading_deg, float(angles.mean(log.heading_deg)))) < FEWEST_TURN_DEG:
        return np.eye(3), f"the logged heading varies by less than {FEWEST_TURN_DEG:.0f} degrees rms"
    tries = [magnetometer_log.search_axes(log)]
    if isinstance(choice, ModelChoice):
        centre = choice.scale * choice.fitted.iron[:3]
        tries.append(magnetometer_log.search_axes(replace(log, raw=log.raw - centre)))
    matrix, scatter, _ = min(tries, key=lambda candidate: candidate[1])
    if scatter > magnetometer_log.MAX_SCATTER_DEG:
        return matrix, f"the logged heading does not follow the axes (scatter {scatter:.0f} degrees)"
    return matrix, ""


def _compare_heading(log: Log, axes: Floats, field: Mapping[str, float] | None) -> ShortComparison:
    """Compare the logged heading with that of the axes."""
    body = log.raw @ axes.T
    working, unit = _scale_to_field(body, float(np.median(np.hypot(body[:, 0], body[:, 1]))), log, field, level=True)
    scene, covariates, samples, clocked = _conditions(log, body)
    terms: tuple[type[Effect], ...] = (MountingOffset, LevelHardIron, HeadingSlip)
    if log.tilted:  # otherwise an unlogged tilt may have any form along the heading
        terms = (ReadingLevelled, HardIron, MountingOffset, LevelSoftIron, *READOUT)
    terms += (CompassDelay,) if clocked else ()
    terms += (iron.TemperatureOfReading,) if _warmed(log) else ()
    confused = {"hard_iron": ("tilt_offset",)}  # constant in the body, near level
    if not log.tilted:
        confused = {term.name: ("tilt_uncompensated",) for term in terms if term is not CompassDelay}
    confused["mounting_offset"] = ("declination_error", *confused.get("mounting_offset", ()))
    assert log.heading_deg is not None
    return ShortComparison(
        what="the logged heading against that of the axes",
        residual=OfHeading(working[samples], log.heading_deg[samples], scene),
        start=np.zeros(0),
        steps=np.zeros(0),
        time_s=scene.time_s,
        clocked=clocked,
        terms=terms,
        covariates=covariates,
        rule_deg=RULE_DEG,
        confused=confused,
        field_unit=unit,
    )


def _compare_modulus(log: Log, axes: Floats, choice: ModelChoice, field: Mapping[str, float] | None) -> ShortComparison:
    """Compare the modulus of the axes with a constant."""
    far, level = ellipsoid.find_outliers(choice), choice.level
    log = log.take(~far) if far.any() else log
    body = log.raw @ axes.T
    working, unit = _scale_to_field(body, choice.scale, log, field, level=level)
    scene, covariates, samples, clocked = _conditions(log, body)
    terms: tuple[type[Effect], ...] = (LevelHardIron, LevelSoftIron) if level else (HardIron, iron.SoftIronInSpace)
    terms += (iron.HardIronStep, iron.HardIronTrend)
    terms += (iron.TemperatureOfField,) if _warmed(log) else ()
    strength = _strength(field, level)
    down: Floats = np.zeros((len(working), 3))
    wobble: Floats = np.zeros((len(working), 0))
    if level:
        down = log.levelling()[:, 2, :]
    if level and log.tilted:
        terms += (iron.Heeling,)
        wobble = _tilt_wobble(log, working, down, strength)
    return ShortComparison(
        what=f"the modulus of the {'horizontal ' if level else ''}axes against a constant",
        residual=OfModulus(working[samples], down[samples], strength, scene, wobble[samples]),
        start=np.zeros(1 + wobble.shape[1]),
        steps=np.ones(1 + wobble.shape[1]),
        time_s=scene.time_s,
        clocked=clocked,
        terms=terms,
        reads=False,
        covariates=covariates,
        confused=dict.fromkeys(("hard_iron", "soft_iron"), _tilted_instead(log, choice, body, field)),
        field_unit=unit,
    )


def _tilted_instead(log: Log, choice: ModelChoice, body: Floats, field: Mapping[str, float] | None) -> tuple[str, ...]:
    """Offer a mean tilt in the vertical field, of any strength, as an alternative to iron where no tilt was logged."""
    if not choice.level or log.tilted:
        return ()
    vertical = abs(float(body[:, 2].mean())) if log.has_z else 0.0
    if not log.has_z and field is not None:
        vertical = choice.scale * abs(field["vertical_nT"]) / field["horizontal_nT"]
    hard = choice.scale * float(np.hypot(*choice.fitted.iron[:2]))
    needed = float(np.arctan2(hard, max(vertical, 1e-12))) / angles.DEGREE
    return ("tilt_uncompensated",) if not vertical or needed < LEVEL_TILT_DEG else ()


def _strength(field: Mapping[str, float] | None, level: bool) -> float:
    if field is None:
        return PLACELESS_NT
    return field["horizontal_nT"] if level else float(np.hypot(field["horizontal_nT"], field["vertical_nT"]))


def _scale_to_field(
    body: Floats, scale: float, log: Log, field: Mapping[str, float] | None, *, level: bool
) -> tuple[Floats, tuple[float, str]]:
    """Scale the readings to nT, nominally where the earth's field is unknown, and get factor and unit of iron."""
    strength, cosines = _strength(field, level), magnetometer_log.are_direction_cosines(log)
    if field is not None and not cosines:
        return body * (strength / scale), (1.0, "nT")
    unit = "of the whole field" if cosines else "in the file's unit"
    return body * (strength / scale), (scale / strength, unit)


@dataclass(frozen=True)
class OfHeading:
    """Logged heading minus the heading of the raw axes with the terms applied."""

    field_nT: Floats  # (n, 3) forward, starboard, down; scaled readings
    logged_deg: Floats  # (n,)
    scene: Scene

    def __call__(self, base: Floats, terms: tuple[Effect, ...]) -> Floats:
        """Return observed minus simulated heading, (n,) degrees; iron terms are what the logger corrected for."""
        of_field = [term for term in terms if term.acts_on == "field"]
        field = _remove_iron(self.field_nT, [term for term in of_field if term.stage == "surroundings"], self.scene)
        for term in (term for term in of_field if term.stage == "sensor"):
            field = term.apply(field, self.scene)
        reading = angles.argument(field[:, 0] - 1j * field[:, 1])
        for term in (term for term in terms if term.acts_on == "reading"):
            reading = term.apply(reading, self.scene)
        return angles.difference(self.logged_deg, reading)


@dataclass(frozen=True)
class OfModulus:
    """Relative modulus of the axes, corrected for iron, minus 1, in degrees of the corresponding heading error."""

    field_nT: Floats  # (n, 3)
    down: Floats  # (n, 3) unit vector; zero for the modulus of all three axes
    strength_nT: float
    scene: Scene
    wobble: Floats  # (n, k) change of the modulus by the fast part of each tilt, degrees

    def __call__(self, base: Floats, terms: tuple[Effect, ...]) -> Floats:
        """Return observed minus simulated modulus, (n,) degrees; base[0] is the scale error of the axes, degrees."""
        scaled = self.field_nT * (1.0 - base[0] * angles.DEGREE)  # iron is in units of the scaled field
        modulus = ellipsoid.modulus(_remove_iron(scaled, terms, self.scene), self.down)
        return (modulus / self.strength_nT - 1.0) / angles.DEGREE - self.wobble @ base[1:]


def _remove_iron(field_nT: Floats, terms: Sequence[Effect], scene: Scene) -> Floats:
    """Remove the iron of terms from the field by inverting the sum of their matrices and vectors."""
    soft, zero = np.eye(3), np.zeros((len(field_nT), 3))
    hard: Floats = np.zeros((len(field_nT), 3))
    for term in terms:
        none = term.apply(zero, scene)
        hard = hard + none
        if term.name == "soft_iron":
            soft = soft + np.stack([(term.apply(zero + unit, scene) - unit)[0] for unit in np.eye(3)], axis=1)
    return np.asarray((field_nT - hard) @ np.linalg.inv(soft).T)


def _warmed(log: Log) -> bool:
    """Return whether a temperature that varies was logged."""
    return log.temperature_c is not None and bool(np.isfinite(log.temperature_c).any() and np.nanstd(log.temperature_c))


def _tilt_wobble(log: Log, field_nT: Floats, down: Floats, strength_nT: float) -> Floats:
    """Compute the change of the modulus by the fast part of each tilt, (n, 2) degrees: accelerations by waves."""
    assert log.pitch_deg is not None and log.roll_deg is not None
    tilts = np.array([log.pitch_deg, log.roll_deg])
    fast = tilts - uniform_filter1d(tilts, WOBBLE_SAMPLES)
    each = [compass.levelling(*(tilts + fast * axis[:, None]))[:, 2, :] for axis in np.eye(2)]
    moved = np.stack([ellipsoid.modulus(field_nT, tilted) for tilted in each], axis=1)
    return (moved - ellipsoid.modulus(field_nT, down)[:, None]) / strength_nT / angles.DEGREE


def _conditions(log: Log, body: Floats) -> tuple[Scene, dict[str, Floats], NDArray[np.intp], bool]:
    """Build scene and covariates of the log, thinned, with the indices of its samples and whether it has a clock."""
    n, heading = len(log.raw), angles.argument(body[:, 0] - 1j * body[:, 1])
    samples, zero = thin_indices(n), np.zeros(n)
    clocked = log.time_s is not None and bool(np.isfinite(log.time_s).all() and np.all(np.diff(log.time_s) > 0.0))
    time_s = log.time_s if clocked and log.time_s is not None else np.arange(1.0, n + 1.0)
    pitch, roll = (zero if tilt is None else tilt for tilt in (log.pitch_deg, log.roll_deg))
    turned = np.cumsum(np.append(0.0, angles.difference(heading[1:], heading[:-1])))
    rate = np.gradient(turned, time_s)
    columns = {"heading": angles.wrap360(heading), "time" if clocked else "reading": time_s}
    columns |= {"pitch": pitch, "roll": roll} if log.tilted else {}
    columns |= {"turn_rate": rate} if clocked else {}
    columns |= {"vertical_field": body[:, 2] / abs(body[:, 2].mean())} if log.has_z and body[:, 2].mean() else {}
    if log.temperature_c is not None and _warmed(log):
        columns["temperature"] = covariate_series.fill_gaps(log.temperature_c)
    columns = {name: column[samples] for name, column in columns.items()}
    departures = {name: column - column.mean() for name, column in columns.items() if name == "temperature"}
    departures["turn_rate"] = rate[samples]
    at = time_s[samples]
    # A projection on cubics: the noise of the difference of two values does not depend on the delay. With linear
    # interpolation it is smallest at half a step, which would bias the estimated delay.
    smooth = savgol_filter(turned, *DELAYED_BY)

    def ahead(seconds: float) -> Floats:
        return np.interp(at + seconds, time_s, smooth) - smooth[samples]

    tilt_deg = pitch[samples], roll[samples]
    scene, _ = recording_scene(at, None, tilt_deg=tilt_deg, departures=departures)
    scene = turning_scene(scene, ahead)
    scene.__dict__["levelling"] = log.levelling()[samples]  # the log's own rule, in place of the cached property
    return scene, columns, samples, clocked
