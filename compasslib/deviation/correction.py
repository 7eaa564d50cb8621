"""Corrected headings and velocities with their uncertainty, for every sample of the affected instrument."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compasslib import angles, compass, deviation, earthfield
from compasslib.deviation import along, branches, likelihood, model, von_appen
from compasslib.deviation.along import Along, Averaged
from compasslib.deviation.branches import Decision
from compasslib.deviation.doubts import KNOWS_NOTHING_DEG, Doubt, along_time, whole_record
from compasslib.deviation.model import Fit
from compasslib.preparation import plausibility
from compasslib.records import (
    BAD,
    GOOD,
    MISSING,
    PROBABLY_BAD,
    PROBABLY_GOOD,
    Corrected,
    EarthField,
    Pairs,
    Readings,
    Record,
    take,
)
from compasslib.statistics import resolution
from compasslib.threads import single_threaded
from compasslib.types import Complexes, Floats

Flags = NDArray[np.int8]

PIECE = 32_768  # samples whose velocities are turned at once: of forty bins, 10 MB an array
FAST = 2.0  # times as fast as its instrument a compass may turn and its recorded headings still tell outliers
AGREED = 0.9  # weight of compasses that agree below which a heading is flagged
SURE = 0.95  # a branch less probable than this is flagged: the record cannot tell
# An allowance, a degree of tilt, for what a level model leaves out: at 5 degrees a vertical field of the iron of 4 % of
# H, or one of 1 % induced where Z is four times H, each turn the compass by some 0.2 degrees along either axis.
LEFT_OUT_BY_TILT = 0.08
UNKNOWN_TILT_DEG = 5.0  # assumed where no tilt was recorded (von Appen 2015: typically 5)
DECLINATION_SIGMA_DEG = 0.5  # assumed of a main-field model at high latitude; crust and storms are left out


@dataclass(frozen=True)
class Pieces:
    """A corrected record in pieces along time, at least one; a piece's velocities are turned when it is asked for."""

    record: Record
    decision: Decision
    field: EarthField

    def __iter__(self) -> Iterator[Corrected]:
        for begin in range(0, max(len(self.record.time_s), 1), PIECE):
            some = slice(begin, begin + PIECE)
            yield _turned(take(self.record, some), take(self.decision, some), self.field)


@single_threaded()
def correct(
    record: Record,
    fit: Fit,
    field: EarthField,
    pairs: Pairs,
    at: Along | None = None,
    *,
    unmodelled_deg: float = 0.0,
    doubts: Sequence[Doubt] = (),
) -> Corrected:
    """Return the corrected record; headings that cannot be corrected are NaN with flag 4.

    Args:
        record: the affected instrument inside the deployment.
        fit: the deviation model, perhaps without coefficients.
        pairs: where the reference overlaps.
        at: the compass at each sample, where more acted on it than the fit holds.
        unmodelled_deg: standard deviation of what the fit is known to lack.
        doubts: stretches whose headings are flagged doubtful and less certain.
    """
    return _turned(*_decided(record, fit, pairs, at, unmodelled_deg, doubts), field)


def in_pieces(
    record: Record,
    fit: Fit,
    field: EarthField,
    pairs: Pairs,
    at: Along | None = None,
    *,
    unmodelled_deg: float = 0.0,
    doubts: Sequence[Doubt] = (),
) -> Pieces:
    """Return what ``correct`` does of the same arguments, in pieces along time: a decade's velocities fit in memory."""
    return Pieces(*_decided(record, fit, pairs, at, unmodelled_deg, doubts), field)


def _decided(
    record: Record, fit: Fit, pairs: Pairs, at: Along | None, unmodelled_deg: float, doubts: Sequence[Doubt]
) -> tuple[Record, Decision]:
    record, decision = _without_outliers(record, headings(readings_of_record(record), fit, pairs, at), fit)
    if why := deviation.implausible(fit, record):
        doubts = (*doubts, whole_record(KNOWS_NOTHING_DEG, why))
    doubted, doubted_deg = along_time(doubts, record.time_s)
    slope = np.maximum(np.nan_to_num(_slope(fit, decision.heading_deg), nan=1.0), along.FLATTEST)
    rounded_deg = resolution.sigma(resolution.along(record.heading_deg)) / slope
    sigma = np.sqrt(decision.sigma_deg**2 + unmodelled_deg**2 + doubted_deg**2 + rounded_deg**2)
    probability = np.where(doubted, np.minimum(decision.probability, 0.0), decision.probability)
    return record, replace(decision, sigma_deg=np.minimum(sigma, KNOWS_NOTHING_DEG), probability=probability)


def _without_outliers(record: Record, decision: Decision, fit: Fit) -> tuple[Record, Decision]:
    """Flag headings to which no instrument turned, and remove the decision where that is certain.

    Where iron makes the compass turn much faster than the instrument, a right heading may be an outlier as it was
    recorded: there the corrected headings are judged, but for those whose branch is unsure, which are flagged anyway.
    """
    judged = record.heading_deg
    if _slope(fit, np.arange(360.0)).max() > FAST:
        with np.errstate(invalid="ignore"):
            judged = np.where(decision.probability < SURE, np.nan, decision.heading_deg)
    flags = plausibility.heading_outliers(record, judged)
    columns = {name: np.where(flags == BAD, np.nan, column) for name, column in vars(decision).items()}
    return plausibility.with_headings_flagged(record, flags), Decision(**columns)


def _slope(fit: Fit, heading_deg: Floats) -> Floats:
    """Return how many times as fast as its instrument the compass turns, (n,); 1 without a fit."""
    if not fit.fitted:
        return np.ones(heading_deg.shape)
    return np.abs((von_appen if fit.method == "von_appen" else compass).slope(fit.coefficients, heading_deg))


def _turned(record: Record, decision: Decision, field: EarthField) -> Corrected:
    deviation = angles.difference(decision.heading_deg, record.heading_deg)
    declination = earthfield.declination_at(field, record.time_s)
    east, north = _recorded_to_true(record, declination)
    corrected_east, corrected_north = angles.turn(east, north, deviation[:, None])
    direction_sigma = np.hypot(decision.sigma_deg, DECLINATION_SIGMA_DEG)
    quality = _heading_quality(record, decision)
    return Corrected(
        record=record,
        heading_corrected_deg=decision.heading_deg,
        heading_uncertainty_deg=decision.sigma_deg,
        heading_corrected_quality=quality,
        deviation_deg=deviation,
        branch_probability=decision.probability,
        declination_deg=declination,
        east=corrected_east,
        north=corrected_north,
        east_recorded=east,
        north_recorded=north,
        velocity_uncertainty=np.hypot(east, north) * angles.turned_share(direction_sigma)[:, None],
        velocity_quality=_velocity_quality(record, quality),
    )


def log_line(name: str, product: Pieces) -> str:
    """Return what the job says of its result."""
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


def headings(readings: Readings, fit: Fit, pairs: Pairs, at: Along | None = None) -> Decision:
    """Return the correct heading, its standard deviation and how sure its branch is.

    Args:
        readings: what the compass recorded, n samples.
        fit: the deviation model, perhaps without coefficients.
        pairs: overlaps that may decide between branches; their times are among those of the readings.
        at: the compass at each sample, where more acted on it than the fit holds.
    """
    if not fit.fitted:
        nothing = np.full(readings.heading_deg.shape, np.nan)
        return Decision(nothing, nothing, nothing, nothing)
    if fit.method == "von_appen" and at is None:
        decision = _published(readings.heading_deg, fit)
    else:
        at = along.of_fit(fit, readings) if at is None else at
        seen, width, scatter = _overlaps(readings.time_s, fit, pairs)
        decision = branches.decide(readings, at, fit, seen, scatter)
        shown = int(branches.resolved(at.roots()[seen], width).sum())
        decision = branches.undecided(decision, shown, len(pairs))
    if at is None:
        parameters = von_appen.sigma(fit, decision.heading_deg)
    else:
        average = along.averaged(at, decision.heading_deg)
        decision, parameters = _moved(decision, average), average.sigma_deg
    left_out = np.zeros(parameters.shape) if at is not None and at.tilted else _left_out_by_tilt(readings)
    sigma = np.sqrt(decision.sigma_deg**2 + parameters**2 + left_out**2)
    return replace(decision, sigma_deg=np.minimum(sigma, KNOWS_NOTHING_DEG))


def _moved(decision: Decision, average: Averaged) -> Decision:
    """Return the decision moved to the average of the compasses, as unsure as they where they do not agree."""
    heading = angles.wrap360(decision.heading_deg + average.shift_deg)
    probability = np.where(average.agreed < AGREED, average.agreed, np.inf)
    return replace(
        decision,
        heading_deg=np.where(average.shift_deg == 0.0, decision.heading_deg, heading),
        probability=np.minimum(decision.probability, probability),
    )


def _left_out_by_tilt(readings: Readings) -> Floats:
    tilt_deg = np.hypot(readings.pitch_deg, readings.roll_deg)
    return LEFT_OUT_BY_TILT * np.where(np.isfinite(tilt_deg), tilt_deg, UNKNOWN_TILT_DEG)


def readings_of(pairs: Pairs) -> Readings:
    """Return what the affected compass recorded at the overlaps."""
    water = in_body_frame(pairs.upper_east, pairs.upper_north, pairs.heading_deg)
    return Readings(pairs.time_s, pairs.heading_deg, pairs.pitch_deg, pairs.roll_deg, water)


def in_body_frame(east: Floats, north: Floats, recorded_deg: Floats) -> Complexes:
    """Return a current in the instrument's frame, speed times e^{i alpha}, alpha clockwise from forward.

    Args:
        east: by the recorded heading, m/s, (n,).
        north: by the recorded heading, m/s, (n,).
        recorded_deg: recorded headings, (n,), degrees.
    """
    return (north + 1j * east) * np.conj(angles.phasor(recorded_deg))


def readings_of_record(record: Record) -> Readings:
    """Return what the affected compass recorded, headings that are flagged bad left out.

    Args:
        record: the affected instrument.
    """
    heading = np.where(record.heading_quality < BAD, record.heading_deg, np.nan)
    return Readings(record.time_s, heading, record.pitch_deg, record.roll_deg, _water(record))


def _water(record: Record) -> Complexes:
    """Average the good bins of each sample: the whole layer turns less from hour to hour than one bin."""
    good = (record.quality <= PROBABLY_GOOD) & np.isfinite(record.east) & np.isfinite(record.north)
    count = good.sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        east, north = (np.where(good, x, 0.0).sum(axis=1) / count for x in (record.east, record.north))
    return in_body_frame(east, north, record.heading_deg)


def _published(recorded_deg: Floats, fit: Fit) -> Decision:
    heading = von_appen.invert(fit.coefficients, recorded_deg)
    slope = np.maximum(np.abs(von_appen.slope(fit.coefficients, heading)), 0.05)
    one = np.where(np.isfinite(heading), 1.0, np.nan)
    return Decision(heading, one * branches.PRECISION_DEG / slope, one, np.full(heading.shape, np.nan))


def _overlaps(time_s: Floats, fit: Fit, pairs: Pairs) -> tuple[NDArray[np.intp], Floats, Floats]:
    seen = np.searchsorted(time_s, pairs.time_s)
    width = likelihood.widths(fit.noise, *model.speeds(pairs))
    chords = likelihood.squared_chords(model.observed_heading(pairs))
    return seen, width, likelihood.scatter(chords, width, fit.noise.outliers)


def _recorded_to_true(record: Record, declination: Floats) -> tuple[Floats, Floats]:
    if record.direction_reference == "true":
        return record.east, record.north
    return angles.turn(record.east, record.north, declination[:, None])


def _heading_quality(record: Record, decision: Decision) -> Flags:
    with np.errstate(invalid="ignore"):
        unsure = decision.probability < SURE
    quality = np.where(unsure, PROBABLY_BAD, np.maximum(record.heading_quality, GOOD))
    return np.where(np.isfinite(decision.heading_deg), quality, BAD).astype(np.int8)


def _velocity_quality(record: Record, heading_quality: Flags) -> Flags:
    """Give each velocity the worse of its own flag and its heading's; missing stays missing."""
    worse = np.maximum(np.maximum(record.quality, GOOD), heading_quality[:, None])
    return np.where(record.quality == MISSING, MISSING, worse).astype(np.int8)
