"""Series logged beside the headings, as the search may use them; never anything derived from the lower direction alone.

A regressor built from the lower direction shares its noise with the residual and alarms in every record.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.deviation.model import pair_speeds
from compasslib.effects.effect import DAY_S, HOUR_S
from compasslib.preparation.pairs import mean_of_nearest_bins
from compasslib.records import MAGNETOMETER, Pairs, Record
from compasslib.types import Floats

TILT_CORRECTIONS = ("lean_pitch", "lean_roll")  # names of the series, degrees
NEAR_CELLS = 2  # whose mean is the water at the instrument
SHORTEST_STUCK_S, FEWEST_MOVING = 10 * 86400.0, 100  # of a stretch without any change, and of moving tilts beside it
HIGHEST = 0.01  # quantile of the depths at which an instrument stands upright
LEAST_EXPLAINED = 0.25  # share of the moving tilts' variance from which on the flow predicts them

FEWEST_VALUES = 5  # different values below which a covariate says nothing
OBSERVATORY = ("declination_observatory", "horizontal_observatory")
INDICES = ("ap", "kp")  # of storms: how far magnetic north swings, and never whereto, so that they drive nothing
NAMED_SERIES = (
    "temperature",
    "supply_voltage",
    "depth",
    "speed",
    *OBSERVATORY,
    *INDICES,
    *TILT_CORRECTIONS,
)  # else: a channel
ZERO_WHERE_MISSING = (*OBSERVATORY, *TILT_CORRECTIONS)  # departures: what is missing counts as none
WITHOUT_REFERENCE = TILT_CORRECTIONS  # departures whose zero means something
BATTERY_JUMP = 0.3  # of its whole range: a supply voltage that rises by more within a day was given a new battery
FEWEST_PREDICTED = 100  # samples that tell the weights
SHEAR_REACH = 6  # samples to either side over which water shears and instruments' own noise averages out
NEIGHBOURS = (2, 3, 4, 5, 6, 7)  # samples before and after; the nearest may share the residual's noise
FAINTEST = 0.03  # of the harmonics' largest combination: what an arc of flow hardly separates is not scaled up
CLIPPED_RAD = 0.6  # of the angle between two directions, for its memory: slow water may point anywhere
FLOW_NAMES = ("flow_east", "flow_north", "flow_sine2", "flow_cosine2")
# ap of every third of Kp, from 0 to 9 (Bartels 1957)
AP_OF_KP = np.array([
    0, 2, 3, 4, 5, 6, 7, 9, 12, 15, 18, 22, 27, 32, 39, 48, 56, 67, 80, 94, 111, 132, 154, 179, 207, 236, 300, 400.0
])  # fmt: skip
HIGHEST_KP = 9.0  # of its scale
SPEED_SPAN_S, SLOWEST_M_S = 6 * 3600.0, 0.03  # of the speed by which a constant velocity turns a direction
NEIGHBOUR_S = 1.5 * HOUR_S  # neighbours farther apart say nothing of a rate


def tilt_corrections(record: Record) -> dict[str, Floats]:
    """Estimate true minus recorded pitch and roll while the tilts stick, (n,) each, 0 elsewhere; empty if they do not.

    A moored instrument leans with the drag of the water, and sinks with the square of the lean. Flow in its own frame
    and depth need no compass, so that what the healthy part of the record shows of lean against both predicts the tilt
    when the sensor no longer tells it. Where the lean follows neither, its mean over the healthy part does.
    """
    if not np.isfinite(record.pitch_deg + record.roll_deg).any():
        return {}
    stretch = longest_constant_tilt(record)
    moving = np.isfinite(record.pitch_deg + record.roll_deg)
    moving[stretch] = False
    if stretch.stop == stretch.start or moving.sum() < FEWEST_MOVING:
        return {}
    # Powers of the flow along and across the instrument, and the direction of flow times the lean by depth.
    velocity, _ = mean_of_nearest_bins(record, np.zeros(len(record.time_s)), NEAR_CELLS)
    sine, cosine = angles.sin_cos(record.heading_deg)
    along, across = velocity.imag * cosine + velocity.real * sine, velocity.real * cosine - velocity.imag * sine
    speed = np.abs(velocity)
    highest = np.nanquantile(record.depth_m, HIGHEST) if np.isfinite(record.depth_m).any() else np.nan
    sunk = np.sqrt(np.nan_to_num(record.depth_m - highest).clip(0.0)) / np.maximum(speed, SLOWEST_M_S)
    flow = np.column_stack([along, across])
    columns = np.column_stack([np.ones(len(speed)), speed[:, None] * flow, flow, sunk[:, None] * flow])
    known = np.asarray(np.isfinite(columns).all(axis=1))
    columns = np.where(known[:, None], columns, 0.0)
    if (moving & known).sum() < FEWEST_MOVING:
        return {}
    tilts = np.column_stack([record.pitch_deg, record.roll_deg])
    learnt, *_ = np.linalg.lstsq(columns[moving & known], tilts[moving & known], rcond=None)
    left = tilts[moving & known] - columns[moving & known] @ learnt
    if np.sum(left.var(axis=0)) > (1.0 - LEAST_EXPLAINED) * np.sum(tilts[moving & known].var(axis=0)):
        learnt = np.vstack([tilts[moving & known].mean(axis=0), np.zeros((columns.shape[1] - 1, 2))])
    lean = np.zeros_like(tilts)
    lean[stretch] = np.where(known[stretch, None], columns[stretch] @ learnt - tilts[stretch], 0.0)
    return dict(zip(TILT_CORRECTIONS, lean.T, strict=True))


def longest_constant_tilt(record: Record) -> slice:
    """Find the longest stretch in which neither tilt changes, empty where none is long enough."""
    still = (np.diff(record.pitch_deg) == 0.0) & (np.diff(record.roll_deg) == 0.0)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(int), [0]])))
    if not len(edges):
        return slice(0, 0)
    begins, ends = edges[::2], edges[1::2]
    k = int(np.argmax(ends - begins))
    first, last = int(begins[k]), int(ends[k])
    long = record.time_s[last] - record.time_s[first] >= SHORTEST_STUCK_S and last - first >= FEWEST_MOVING
    return slice(first, last + 1) if long else slice(0, 0)


def logged_series(record: Record, observatory_files: Sequence[str], at: Pairs | None = None) -> dict[str, Floats]:
    """Collect the series beside heading and tilt that hold anything, (n,) each.

    Args:
        record: the affected instrument.
        observatory_files: IAGA-2002 files of one observatory, perhaps none.
        at: overlaps at whose times they are wanted; at every sample of the record where absent.

    Raises:
        InputError: an observatory's file cannot be read.
    """
    velocity, _ = mean_of_nearest_bins(record, np.zeros(len(record.time_s)), NEAR_CELLS)
    series = {
        "temperature": record.temperature_c,
        "supply_voltage": record.supply_voltage,
        "depth": record.depth_m,
        "speed": np.abs(velocity),
        **{name: channel for name, channel in record.channels.items() if name not in MAGNETOMETER},
    } | tilt_corrections(record)
    if observatory_files:
        from compasslib.calibrations import observatory  # only where one is named

        series |= zip(OBSERVATORY, observatory.covariates(observatory_files, record.time_s), strict=True)
    where = slice(None) if at is None else np.searchsorted(record.time_s, at.time_s)
    return {name: column[where] for name, column in series.items() if np.isfinite(column).any()}


def pair_covariates(pairs: Pairs, logged: Mapping[str, Floats]) -> dict[str, Floats]:
    """Collect the covariates along which the residual is tested, (n,) each; constants are left out."""
    upper, _ = pair_speeds(pairs)
    series = {
        "heading": pairs.heading_deg,
        "time": pairs.time_s,
        "pitch": pairs.pitch_deg,
        "roll": pairs.roll_deg,
        "depth": pairs.upper_depth_m,
        "separation": pairs.lower_depth_m - pairs.upper_depth_m,
        "speed": upper,
        "hour_of_day": angles.wrap360(360.0 * (pairs.time_s / DAY_S)) / 15.0,
    } | {
        name: np.nan_to_num(column) if name in ZERO_WHERE_MISSING else smooth_supply(name, column, pairs.time_s)
        for name, column in logged.items()
    }
    if pairs.lower_heading_deg is not None:
        series["reference_heading"] = pairs.lower_heading_deg
    return {name: fill_gaps(column) for name, column in series.items() if name in TILT_CORRECTIONS or varies(column)}


def reference_values(columns: Mapping[str, Floats]) -> dict[str, float]:
    """Compute the references of departures by covariate: means, or 0 for what is a departure itself."""
    means = {name: 0.0 if name in WITHOUT_REFERENCE else float(np.mean(column)) for name, column in columns.items()}
    tilts = [columns[name] for name in ("pitch", "roll") if name in columns]
    return means | ({"tilt": float(np.mean(np.hypot.reduce(tilts)))} if tilts else {})


def smooth_supply(name: str, column: Floats, time_s: Floats) -> Floats:
    """Average a supply voltage over a day; other series are returned as they are, (n,).

    Batteries change within days; what is faster is mostly the converter's count, and would hide that a voltage falls as
    evenly as time goes.
    """
    return running_mean(column, time_s, DAY_S) if name == "supply_voltage" and len(column) else column


def running_mean(column: Floats, time_s: Floats, span_s: float) -> Floats:
    """Average a series over a span around each sample, (n,).

    Args:
        column: (n,), NaN where missing.
        span_s: length of the span, seconds.
    """
    first, last = (np.searchsorted(time_s, time_s + half, "left") for half in (-span_s / 2.0, span_s / 2.0))
    total, count = (
        np.concatenate([[0.0], np.cumsum(x)]) for x in (np.nan_to_num(column), np.isfinite(column).astype(float))
    )
    known = count[last] - count[first]
    return np.asarray(np.where(known > 0.0, (total[last] - total[first]) / np.maximum(known, 1.0), np.nan))


def varies(column: Floats) -> bool:
    """Return whether most samples of a covariate are there and take more than a few values."""
    known = column[np.isfinite(column)]
    return 2 * len(known) > len(column) and len(np.unique(known)) >= FEWEST_VALUES


def fill_gaps(column: Floats) -> Floats:
    """Fill missing values with the median, which is neutral."""
    return np.where(np.isfinite(column), column, np.nanmedian(column))


def departures(
    pairs: Pairs, covariates: Mapping[str, Floats], references: Mapping[str, float], heading_deg: Floats
) -> dict[str, Floats]:
    """Compute the series that the terms need: covariates minus their references, and rates, (n,) each.

    Args:
        covariates: as ``pair_covariates`` gives them.
        references: what is taken off, by name.
        heading_deg: headings as the fit corrects them, (n,), degrees; NaN where it cannot.
    """
    result = {name: column - references.get(name, 0.0) for name, column in covariates.items()}
    if np.any(rate := turn_rate(pairs.heading_deg, pairs.time_s)):
        result["turn_rate"] = rate
    result |= _flow_departures(pairs, np.nan_to_num(angles.difference(heading_deg, pairs.heading_deg)))
    if "flow_east" in result:
        upper, lower = (running_mean(speed, pairs.time_s, SPEED_SPAN_S) for speed in pair_speeds(pairs))
        true_heading = np.where(np.isfinite(heading_deg), heading_deg, pairs.heading_deg) + pairs.declination_deg
        result |= _body_frame_flow(true_heading, upper, result, "body")
        if "reference_heading" in covariates:
            result |= _body_frame_flow(
                covariates["reference_heading"] + pairs.declination_deg, lower, result, "reference"
            )
    if "reference_heading" in covariates:
        for name, wave in zip(("sine", "cosine"), angles.sin_cos(covariates["reference_heading"]), strict=True):
            result[f"reference_{name}"] = wave - wave.mean()
    if (index := storm_index(covariates)) is not None:
        result["storm_index"] = index
    if "pitch" in result or "roll" in result:
        result["tilt"] = np.hypot.reduce([covariates[x] for x in ("pitch", "roll") if x in covariates])
        result["tilt"] = result["tilt"] - references["tilt"]
    if "supply_voltage" in covariates:
        number = battery_count(covariates["supply_voltage"])
        if number[-1] > 0:
            result["battery_number"] = number
    return result


def storm_index(covariates: Mapping[str, Floats]) -> Floats | None:
    """Take the storm index ap, or convert Kp to it; None where neither was given, (n,).

    Args:
        covariates: by name, of which ``ap`` and ``kp`` count; tenths of Kp are known by values beyond its highest.
    """
    if "ap" in covariates:
        return np.maximum(covariates["ap"], 0.0)
    if "kp" not in covariates:
        return None
    kp = covariates["kp"] / (10.0 if covariates["kp"].max() > HIGHEST_KP else 1.0)
    return np.interp(3.0 * kp, np.arange(len(AP_OF_KP)), AP_OF_KP)


def turn_rate(angle_deg: Floats, time_s: Floats) -> Floats:
    """Differentiate an angle between the neighbours of each sample, (n,) degrees/s, 0 where they are too far."""
    turn, apart = angles.difference(angle_deg[2:], angle_deg[:-2]), time_s[2:] - time_s[:-2]
    result = np.zeros(len(time_s))
    result[1:-1] = np.where(apart <= 2.0 * NEIGHBOUR_S, turn / apart, 0.0)
    return result


def battery_count(voltage: Floats) -> Floats:
    """Count the batteries replaced since the first, (n,): each makes the voltage rise and stay."""
    window = min(24, len(voltage) // 8)
    if window == 0:
        return np.zeros(len(voltage))
    smooth = np.median(np.lib.stride_tricks.sliding_window_view(voltage, window), axis=1)
    rise = smooth[window:] - smooth[:-window]
    least = BATTERY_JUMP * np.ptp(voltage)
    number, last = np.zeros(len(voltage)), -len(voltage)
    padded = np.pad(rise, window, constant_values=-np.inf)
    highest = np.lib.stride_tricks.sliding_window_view(padded, 2 * window + 1).max(axis=1)
    for at in np.flatnonzero((rise > least) & (rise >= highest)):
        if at - last > window:  # whole counts rise alike from several neighbours: one battery all the same
            number[at + window :] += 1.0
        last = int(at)
    return number


def _flow_departures(pairs: Pairs, deviation_deg: Floats) -> dict[str, Floats]:
    """Predict the flow's direction from the hours around, and compute the turn of the mooring's excursion.

    The noise of either instrument's direction is in the residual too. In the middle between them what shears over hours
    cancels, in their mean weighted by what each one's own noise is what changes from sample to sample; and the noise of
    the hours around is hardly in what the residual's filter leaves. The prediction is smaller than what the
    water does: it is scaled by how the direction follows it, as the first of two stages of least squares, so that a
    veer by direction keeps its size.
    """
    upper = _complex(*angles.turn(pairs.upper_east, pairs.upper_north, deviation_deg))
    lower = _complex(pairs.lower_east, pairs.lower_north)
    # Weight the upper direction so that the mean's noise is independent of the difference: the lower's noise share.
    a, b = np.diff(upper, 2), np.diff(lower, 2)
    common = float(np.real(np.mean(a * np.conj(b))))
    noise = [max(float(np.mean(np.abs(x) ** 2)) - common, 0.0) for x in (a, b)]
    share = noise[1] / max(sum(noise), 1e-12)
    apart = upper - lower
    reach = min(len(apart), 2 * SHEAR_REACH + 1)
    nearby = np.ones(reach)
    smooth = np.convolve(apart, nearby, "same") / np.convolve(np.ones(len(apart)), nearby, "same")
    both = (upper + lower) / 2.0 + (share - 0.5) * (apart - smooth)
    around = _predict_from_neighbours(both, pairs.time_s)
    angle = np.clip(np.angle(upper * np.conj(lower)), -CLIPPED_RAD, CLIPPED_RAD)
    angle = angle - angle.mean()
    memory = float(np.clip(angle[1:] @ angle[:-1] / max(float(angle @ angle), 1e-12), 0.0, 1.0))
    predicted = _scale_prediction(_harmonics(both), _harmonics(around), memory)
    lean = np.abs(upper) * upper
    moved = np.zeros(len(pairs), dtype=complex)
    span_s = pairs.time_s[2:] - pairs.time_s[:-2]
    moved[1:-1] = np.where(span_s <= 2.0 * NEIGHBOUR_S, (lean[2:] - lean[:-2]) / span_s, 0.0)
    across = -np.imag(moved * np.conj(upper)) / np.maximum(np.abs(upper), 0.02) ** 2 / angles.DEGREE
    # The flow's rate of turn by a straight line through five samples, degrees/h, 0 at gaps.
    five = np.lib.stride_tricks.sliding_window_view(both, 5)
    hours = np.lib.stride_tricks.sliding_window_view(pairs.time_s, 5) / HOUR_S
    away = hours - hours.mean(axis=1, keepdims=True)
    trend, middle = np.sum(away * five, axis=1) / np.sum(away**2, axis=1), five.mean(axis=1)
    turn = -np.imag(trend * np.conj(middle)) / np.maximum(np.abs(middle), 0.02) ** 2 / angles.DEGREE
    flow_turn = np.zeros(len(both))
    flow_turn[2:-2] = np.where(np.ptp(hours, axis=1) <= 4.5, turn, 0.0)
    result = {"excursion_turn": across, "flow_turn": flow_turn}
    if np.any(predicted):
        result |= dict(zip(FLOW_NAMES, predicted.T, strict=True))
    return result


def _body_frame_flow(
    heading_deg: Floats, speed: Floats, of_flow: Mapping[str, Floats], whose: str
) -> dict[str, Floats]:
    """Compute sine and cosine of the flow's angle in an instrument's body over its speed, and the sine of twice it.

    Args:
        heading_deg: to true north, (n,).
        speed: as that instrument measured it, mean of some hours, (n,) m/s.
        of_flow: the flow's direction as the hours around tell it.
        whose: what the names begin with.
    """
    (sine, cosine), (sine2, cosine2) = (angles.sin_cos(k * heading_deg) for k in (1.0, 2.0))
    east, north, flow_sine2, flow_cosine2 = (of_flow[name] for name in FLOW_NAMES)
    slow = np.maximum(speed, SLOWEST_M_S)
    return {
        f"{whose}_flow_sine": (east * cosine - north * sine) / slow,
        f"{whose}_flow_cosine": (north * cosine + east * sine) / slow,
        f"{whose}_flow_sine2": flow_sine2 * cosine2 - flow_cosine2 * sine2,
    }


def _harmonics(flow: NDArray[np.complex128]) -> Floats:
    """Compute sine and cosine of the flow's direction and of its double, (n, 4); 0 where it does not flow."""
    size = np.abs(flow)
    unit = np.where(size > 0.0, flow / np.where(size > 0.0, size, 1.0), 0.0)
    return np.column_stack([unit.real, unit.imag, (unit**2).imag, -(unit**2).real])


def _scale_prediction(harmonics: Floats, around: Floats, memory: float) -> Floats:
    """Scale the predicted harmonics by how the observed ones follow them, lag-one memory filtered out, (n, k)."""
    x, z = (series[1:] - memory * series[:-1] for series in (harmonics, around))
    known = np.any(around[1:], axis=1) & np.any(around[:-1], axis=1)
    if not known.any():
        return around
    x, z = (series[known] - series[known].mean(axis=0) for series in (x, z))
    shares, *_ = np.linalg.lstsq(z, x, rcond=FAINTEST)
    scaled = around @ shares
    return np.asarray(scaled + (np.mean(harmonics, axis=0) - np.mean(scaled, axis=0)))


def _predict_from_neighbours(flow: NDArray[np.complex128], time_s: Floats) -> NDArray[np.complex128]:
    """Predict the flow from samples some hours before and after, by least squares; 0 where they are missing."""
    result, most = np.zeros(len(flow), dtype=complex), NEIGHBOURS[-1]
    inside = np.arange(most, len(flow) - most)
    inside = inside[time_s[inside + most] - time_s[inside - most] <= (2 * most + 0.5) * HOUR_S]
    if len(inside) > FEWEST_PREDICTED:
        others = [flow[inside + side * apart] for apart in NEIGHBOURS for side in (-1, 1)]
        columns = np.column_stack([*others, np.ones(len(inside))])
        weights, *_ = np.linalg.lstsq(columns, flow[inside], rcond=None)
        result[inside] = columns @ weights
    return result


def _complex(east: Floats, north: Floats) -> NDArray[np.complex128]:
    return np.asarray(east + 1j * north)


def hat_columns(x: Floats, count: int) -> Floats:
    """Build hat functions on knots at even quantiles, (n, k)."""
    knots = np.unique(np.quantile(x, np.linspace(0.0, 1.0, count)))
    if len(knots) < 2:
        return np.zeros((len(x), 0))
    eye = np.eye(len(knots))
    return np.column_stack([np.interp(x, knots, row) for row in eye])


def standardize(x: Floats) -> Floats:
    """Standardize a series and clip far outliers, (n,)."""
    return np.clip((x - np.mean(x)) / np.std(x), -4.0, 4.0)
