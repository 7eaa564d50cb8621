"""Corrected headings and velocities with their uncertainty, for every sample of the affected instrument."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib import angles, earthfield
from compasslib.deviation import find_implausibility
from compasslib.deviation.average import CompassSeries, average_compasses, compass_series
from compasslib.deviation.branches import HeadingDecision, choose_branches, open_branches, shows_branch, single_branch
from compasslib.deviation.doubts import Doubt, doubt_whole_record, evaluate_doubts
from compasslib.deviation.exact import MIN_SLOPE, correct_roots, heading_sensitivity, reading_slope
from compasslib.deviation.likelihood import scatter_density, scatter_widths, squared_chords
from compasslib.deviation.model import (
    IRON_SIGMA_NT,
    UNKNOWN_COVARIANCE,
    DeviationFit,
    constant_sigma,
    covariance_sigma,
    declination_sigma,
    observed_heading,
    pair_speeds,
)
from compasslib.deviation.series import series_sigma
from compasslib.records import (
    BAD,
    GOOD,
    MISSING,
    PROBABLY_BAD,
    PROBABLY_GOOD,
    CorrectedRecord,
    EarthField,
    Pairs,
    Readings,
    Record,
    pieces,
    take,
)
from compasslib.statistics import single_threaded
from compasslib.statistics.resampling import angle_resolution
from compasslib.types import Complexes, Floats

Flags = NDArray[np.int8]

MIN_PROBABILITY = 0.95  # a heading is flagged if its branch is less probable
INDUCED_SHARE = 0.01  # of the vertical field, induced along the vertical axis: standard deviation


@dataclass(frozen=True)
class CorrectedPieces:
    """A corrected record as an iterable of at least one piece in time, whose velocities are rotated on access."""

    record: Record
    decision: HeadingDecision
    field: EarthField
    declination_deg: float  # standard deviation of the declination, where the headings do not include it

    def __iter__(self) -> Iterator[CorrectedRecord]:
        yield from map(self.piece, pieces(len(self.record.time_s)))

    def piece(self, stretch: slice) -> CorrectedRecord:
        """Rotate the velocities of some samples."""
        record, decision = take(self.record, stretch), take(self.decision, stretch)
        deviation = angles.difference(decision.heading_deg, record.heading_deg)
        declination = earthfield.declination_at(self.field, record.time_s)
        east, north = record.east, record.north
        if record.direction_reference != "true":
            east, north = angles.turn(east, north, declination[:, None])
        corrected_east, corrected_north = angles.turn(east, north, deviation[:, None])
        variance = (angles.DEGREE * np.hypot(decision.sigma_deg, self.declination_deg))[:, None] ** 2
        across, along = angles.rotation_errors(variance)
        quality = _heading_quality(record, decision)
        worse = np.maximum(np.maximum(record.quality, GOOD), quality[:, None])
        return CorrectedRecord(
            record=record,
            heading_corrected_deg=decision.heading_deg,
            heading_uncertainty_deg=decision.sigma_deg,
            heading_common_deg=decision.common_deg,
            heading_corrected_quality=quality,
            deviation_deg=deviation,
            branch_probability=decision.probability,
            declination_deg=declination,
            east=corrected_east,
            north=corrected_north,
            east_recorded=east,
            north_recorded=north,
            east_uncertainty=np.sqrt(across * corrected_north**2 + along * corrected_east**2),
            north_uncertainty=np.sqrt(across * corrected_east**2 + along * corrected_north**2),
            velocity_quality=np.where(record.quality == MISSING, MISSING, worse).astype(np.int8),
        )


def correct(
    record: Record, fit: DeviationFit, field: EarthField, pairs: Pairs, at: CompassSeries | None = None, **further: Any
) -> CorrectedRecord:
    """Correct a record; headings that cannot be corrected are NaN with flag 4. Arguments as ``correct_in_pieces``."""
    return correct_in_pieces(record, fit, field, pairs, at, **further).piece(slice(None))


@single_threaded()
def correct_in_pieces(
    record: Record,
    fit: DeviationFit,
    field: EarthField,
    pairs: Pairs,
    at: CompassSeries | None = None,
    *,
    unmodelled_deg: float = 0.0,
    doubts: Sequence[Doubt] = (),
) -> CorrectedPieces:
    """Correct a record in pieces along time, so that a decade of velocities fits in memory.

    Args:
        at: the compass at each sample, if effects beyond those of the fit acted on it.
        unmodelled_deg: standard deviation of known unmodelled effects, degrees.
        doubts: periods whose headings are flagged as doubtful, with increased uncertainty.
    """
    decision = correct_headings(record_readings(record), fit, pairs, at)
    tilted_deg = tilted_iron_sigma(record, field) if at is None or not at.tilted else 0.0
    denied = ("" if fit.covariance_known else UNKNOWN_COVARIANCE, find_implausibility(fit, record))
    doubts = (*doubts, *(doubt_whole_record(angles.UNIFORM_SIGMA_DEG, why) for why in denied if why))
    doubted, doubted_deg = evaluate_doubts(doubts, record.time_s)
    slope = reading_slope(fit, decision.heading_deg) if fit.fitted else np.ones(decision.heading_deg.shape)
    resolution = angle_resolution(record.heading_deg) / np.sqrt(3.0)  # rounded down, up or to the nearest
    rounded_deg = resolution / np.maximum(np.nan_to_num(slope, nan=1.0), MIN_SLOPE)
    whole, common = (
        np.minimum(np.sqrt(known**2 + unmodelled_deg**2 + doubted_deg**2 + further), angles.UNIFORM_SIGMA_DEG)
        for known, further in ((decision.sigma_deg, rounded_deg**2 + tilted_deg**2), (decision.common_deg, 0.0))
    )
    probability = np.where(doubted, np.minimum(decision.probability, 0.0), decision.probability)
    decision = replace(decision, sigma_deg=whole, common_deg=common, probability=probability)
    # Where the fit's reference is true, the headings include the error of the declination.
    declination_deg = declination_sigma(field) if fit.reference is None or fit.reference.magnetic else 0.0
    return CorrectedPieces(record, decision, field, declination_deg)


def describe_correction(name: str, product: CorrectedPieces) -> str:
    """Describe the corrected record in a log line."""
    record, decision = product.record, product.decision
    recorded, corrected = np.isfinite(record.heading_deg), np.isfinite(decision.heading_deg)
    if not corrected.any():
        return f"{name}: none of {int(recorded.sum())} headings corrected"
    unsure = int(np.sum(_heading_quality(record, decision) == PROBABLY_BAD))
    turned = float(np.nanmax(np.abs(angles.difference(decision.heading_deg, record.heading_deg))))
    return (
        f"{name}: {int(corrected.sum())} of {int(recorded.sum())} headings corrected, by up to {turned:.0f} degrees; "
        f"{unsure} flagged as doubtful"
    )


def correct_headings(
    readings: Readings, fit: DeviationFit, pairs: Pairs, at: CompassSeries | None = None
) -> HeadingDecision:
    """Estimate the correct heading, its standard deviation and the probability of its branch."""
    if not fit.fitted:
        return HeadingDecision(*(np.full(readings.heading_deg.shape, np.nan) for _ in range(5)))
    if fit.method == "von_appen" and at is None:
        heading = correct_roots(fit, readings.heading_deg)[:, 0]
        decision = single_branch(heading, reading_slope(fit, heading))
        parameters = series_sigma(fit, heading)
    else:
        at = compass_series(fit, readings) if at is None else at
        overlap = np.searchsorted(readings.time_s, pairs.time_s)
        width = scatter_widths(fit.noise, *pair_speeds(pairs))
        scatter = scatter_density(squared_chords(observed_heading(pairs)), width, fit.noise.outliers)
        decision = choose_branches(readings, at, fit, overlap, scatter)
        shown = int(shows_branch(at.roots()[overlap], width).sum())
        decision = open_branches(decision, shown, len(pairs))
        average = average_compasses(at, decision.heading_deg)
        shifted, parameters = angles.wrap360(decision.heading_deg + average.shift_deg), average.sigma_deg
        decision = replace(
            decision,
            heading_deg=np.where(average.shift_deg == 0.0, decision.heading_deg, shifted),
            probability=np.minimum(decision.probability, np.where(average.agreed < 0.9, average.agreed, np.inf)),
        )
    common = np.sqrt(parameters**2 + np.sum(reference_modes(fit, decision.heading_deg) ** 2, axis=1))
    sigma = np.hypot(decision.sigma_deg, common)
    return replace(decision, sigma_deg=np.minimum(sigma, angles.UNIFORM_SIGMA_DEG), common_deg=common)


def tilted_iron_sigma(record: Record, field: EarthField) -> Floats:
    """Compute the deflection of a tilted compass by vertical iron that the level model leaves out, (n,) degrees, 1σ.

    Along the vertical axis, iron adds as much as it usually does across it away from a sphere, and 1 % of the vertical
    field. Its deflection, rms over headings, is doubled for errors of the tilts. A tilt of 5 degrees is assumed where
    none was recorded (von Appen 2015: typically 5).
    """
    tilt_deg = np.hypot(record.pitch_deg, record.roll_deg)
    vertical_nT = np.hypot(IRON_SIGMA_NT, INDUCED_SHARE * float(np.mean(field.vertical_nT)))
    share = vertical_nT / np.sqrt(2.0) / float(np.mean(field.horizontal_nT))
    return np.asarray(2.0 * share * np.where(np.isfinite(tilt_deg), tilt_deg, 5.0))


def reference_modes(fit: DeviationFit, heading_deg: Floats) -> Floats:
    """Decompose the error of headings due to the reference, (n, 3) degrees: constant with veer, its B and C."""
    reference = fit.reference
    if reference is None or not fit.fitted:
        return np.zeros((len(heading_deg), 3))
    constant, sigma = float(fit.coefficients[0]), float(np.sqrt(fit.covariance[0, 0]))
    if fit.method != "von_appen":
        constant, sigma = float(angles.direction(constant, 1.0)), sigma / (1.0 + constant**2) / angles.DEGREE
    if reference.veer_included:
        sigma = float(np.sqrt(max(sigma**2 - reference.veer_deg**2, 0.0)))
    error = float(np.hypot(reference.constant_deg, reference.veer_deg))
    included = reference.veer_deg if reference.veer_included else 0.0  # in the covariance
    whole = constant_sigma(float(angles.wrap180(constant)), sigma, error)
    further = np.sqrt(reference.share * max(whole**2 - included**2, 0.0))
    by_iron = np.nan_to_num(heading_sensitivity(fit, heading_deg) @ reference.iron)
    return np.column_stack([np.full(len(heading_deg), further), by_iron])


def readings_at_pairs(pairs: Pairs) -> Readings:
    """Extract the affected compass's readings at the pairs."""
    water = _to_body_frame(pairs.upper_east, pairs.upper_north, pairs.heading_deg)
    return Readings(pairs.time_s, pairs.heading_deg, pairs.pitch_deg, pairs.roll_deg, water)


def _to_body_frame(east: Floats, north: Floats, recorded_deg: Floats) -> Complexes:
    """Rotate a current into the instrument's frame: speed times e^{i alpha}, alpha clockwise from forward."""
    return (north + 1j * east) * np.conj(angles.phasor(recorded_deg))


def record_readings(record: Record) -> Readings:
    """Extract the affected compass's readings, NaN where flagged bad, and the mean water of the good bins."""
    heading = np.where(record.heading_quality < BAD, record.heading_deg, np.nan)
    east, north = np.empty((2, len(record.time_s)))
    for rows in pieces(len(record.time_s)):
        flow = record.east[rows], record.north[rows]
        good = (record.quality[rows] <= PROBABLY_GOOD) & np.isfinite(flow[0]) & np.isfinite(flow[1])
        with np.errstate(invalid="ignore", divide="ignore"):
            east[rows], north[rows] = (np.where(good, x, 0.0).sum(axis=1) / good.sum(axis=1) for x in flow)
    water = _to_body_frame(east, north, record.heading_deg)
    return Readings(record.time_s, heading, record.pitch_deg, record.roll_deg, water)


def _heading_quality(record: Record, decision: HeadingDecision) -> Flags:
    with np.errstate(invalid="ignore"):
        unsure = decision.probability < MIN_PROBABILITY
    quality = np.where(unsure, PROBABLY_BAD, np.maximum(record.heading_quality, GOOD))
    return np.where(np.isfinite(decision.heading_deg), quality, BAD).astype(np.int8)


LOOKUP_COLUMNS = ("recorded_deg", "corrected_deg", "deviation_deg", "sigma_deg", "root")


def tabulate_deviation(
    fit: DeviationFit, unmodelled_deg: float = 0.0, doubts: Sequence[Doubt] = ()
) -> dict[str, Floats]:
    """Tabulate the level compass at every whole degree that it records; root 1 has the larger slope."""
    if not fit.fitted:
        return {name: np.zeros(0) for name in LOOKUP_COLUMNS}
    roots = correct_roots(fit, np.arange(360.0))
    recorded, number = np.nonzero(np.isfinite(roots))
    root = roots[recorded, number]
    whole = [doubt.sigma_deg for doubt in doubts if np.isinf([doubt.from_s, doubt.to_s]).all()]
    if fit.method == "von_appen":
        parameters = series_sigma(fit, root)
    else:
        parameters = covariance_sigma(heading_sensitivity(fit, root), fit.covariance)
    reading = single_branch(root, reading_slope(fit, root)).sigma_deg
    further = np.sum(reference_modes(fit, root) ** 2, axis=1) + unmodelled_deg**2 + float(np.sum(np.square(whole)))
    sigma = np.minimum(np.sqrt(parameters**2 + reading**2 + further), angles.UNIFORM_SIGMA_DEG)
    columns = (recorded.astype(float), root, angles.difference(root, recorded), sigma, number + 1.0)
    return dict(zip(LOOKUP_COLUMNS, columns, strict=True))
