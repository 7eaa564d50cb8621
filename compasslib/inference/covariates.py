"""Covariates of the search: logged series, and quantities derived from them and the pairs.

No covariate is derived from the lower direction alone: it would share its noise with the residual and always alarm. The
heading of the reference follows that direction where the instrument points along the flow.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.ndimage import convolve1d

from compasslib import angles
from compasslib.deviation.model import pair_speeds
from compasslib.effects.effect import DAY_S, HOUR_S
from compasslib.preparation.pairs import mean_of_nearest_bins
from compasslib.records import MAGNETOMETER, Pairs, Record
from compasslib.types import Complexes, Floats

TILT_CORRECTIONS = ("lean_pitch", "lean_roll")  # true minus recorded tilt, degrees
NEAR_CELLS = 2  # nearest bins, whose mean is taken as the velocity at the instrument
SHORTEST_STUCK_S = 10 * 86400.0  # least duration of stuck tilts
FEWEST_FITTED = 100  # samples from which a regression is estimated
HIGHEST = 0.01  # quantile of the depth at which the instrument is taken as upright
LEAST_EXPLAINED = 0.25  # share of the variance of the tilts that the flow must explain to be used as their predictor

FEWEST_VALUES = 5  # distinct values that a covariate needs at least
OBSERVATORY = ("declination_observatory", "horizontal_observatory")
INDICES = ("ap", "kp")  # of magnetic storms: they give the size of a disturbance, not its sign, and cannot be drivers
NAMED_SERIES = (
    "temperature",
    "supply_voltage",
    "depth",
    "speed",
    *OBSERVATORY,
    *INDICES,
    *TILT_CORRECTIONS,
)  # any other name is an instrument-specific channel
ZERO_WHERE_MISSING = (*OBSERVATORY, *TILT_CORRECTIONS)  # missing values are set to 0
WITHOUT_REFERENCE = TILT_CORRECTIONS  # series with a meaningful zero, from which no mean is subtracted
FOLLOWS_FLOW = 0.8  # resultant length of heading minus flow: 0.89 with a fin (aqd9330), up to 0.25 without (eh2, papa)
SHEAR_REACH = 6  # samples to either side over which shear persists while instrument noise averages out
NEIGHBOURS = (2, 3, 4, 5, 6, 7)  # lags in samples, before and after; at lag 1 the residual's noise may be shared
FAINTEST = 0.03  # relative cutoff of singular values: flow from a narrow arc hardly separates the harmonics
CLIPPED_RAD = 0.6  # clip of the angle between both directions, for its autocorrelation: slow flow has any direction
FLOW_NAMES = ("flow_east", "flow_north", *(f"flow_{wave}{k}" for k in (2, 3, 4) for wave in ("sine", "cosine")))
# ap of every third of Kp, from 0 to 9 (Bartels 1957)
AP_OF_KP = np.array([
    0, 2, 3, 4, 5, 6, 7, 9, 12, 15, 18, 22, 27, 32, 39, 48, 56, 67, 80, 94, 111, 132, 154, 179, 207, 236, 300, 400.0
])  # fmt: skip
SPEED_SPAN_S, SLOWEST_M_S = 6 * 3600.0, 0.03  # averaging span, and least value, of a speed in a denominator
NEIGHBOUR_S = 1.5 * HOUR_S  # largest interval between neighbours from which a rate is computed


def tilt_corrections(record: Record) -> dict[str, Floats]:
    """Estimate true minus recorded pitch and roll while both are stuck, (n,) each, 0 elsewhere; empty if never stuck.

    A moored instrument leans with the drag of the flow and sinks with the square of the lean. Flow in the instrument's
    frame and depth need no compass: a regression of the tilt on both, fitted to the valid part of the record, predicts
    the tilt while the sensor is stuck. If they explain little of it, the mean tilt of the valid part is used.
    """
    if not np.isfinite(record.pitch_deg + record.roll_deg).any():
        return {}
    stretch = longest_constant_tilt(record)
    moving = np.isfinite(record.pitch_deg + record.roll_deg)
    moving[stretch] = False
    if stretch.stop == stretch.start or moving.sum() < FEWEST_FITTED:
        return {}
    # Flow along and across the instrument, linear and quadratic, and its direction times the lean derived from depth.
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
    if (moving & known).sum() < FEWEST_FITTED:
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
    """Find the longest period in which neither tilt changes, empty if none is long enough."""
    still = (np.diff(record.pitch_deg) == 0.0) & (np.diff(record.roll_deg) == 0.0)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(int), [0]])))
    if not len(edges):
        return slice(0, 0)
    begins, ends = edges[::2], edges[1::2]
    k = int(np.argmax(ends - begins))
    first, last = int(begins[k]), int(ends[k])
    long = record.time_s[last] - record.time_s[first] >= SHORTEST_STUCK_S and last - first >= FEWEST_FITTED
    return slice(first, last + 1) if long else slice(0, 0)


def logged_series(record: Record, observatory_files: Sequence[str], at: Pairs | None = None) -> dict[str, Floats]:
    """Collect the logged series other than heading and tilt that contain data, (n,) each.

    Args:
        record: of the affected instrument.
        observatory_files: IAGA-2002 files of one observatory, may be empty.
        at: pairs at whose times the series are returned; by default all samples of the record.

    Raises:
        InputError: an observatory file cannot be read.
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
        from compasslib.calibrations import observatory  # deferred: rarely needed

        series |= zip(OBSERVATORY, observatory.covariates(observatory_files, record.time_s), strict=True)
    where = slice(None) if at is None else np.searchsorted(record.time_s, at.time_s)
    return {name: column[where] for name, column in series.items() if np.isfinite(column).any()}


def pair_covariates(pairs: Pairs, logged: Mapping[str, Floats]) -> dict[str, Floats]:
    """Collect the covariates along which the residual is tested, (n,) each, without those that hardly vary.

    The heading of a reference that follows the flow tells no more than its directions, which are in the residual. The
    distance of the layers also changes where one of several references takes over, whose compass is another.
    """
    upper, _ = pair_speeds(pairs)
    series = {
        "heading": pairs.heading_deg,
        "time": pairs.time_s,
        "pitch": pairs.pitch_deg,
        "roll": pairs.roll_deg,
        "depth": pairs.upper_depth_m,
        "speed": upper,
        "hour_of_day": angles.wrap360(360.0 * (pairs.time_s / DAY_S)) / 15.0,
    } | {
        name: np.nan_to_num(column) if name in ZERO_WHERE_MISSING else smooth_supply(name, column, pairs.time_s)
        for name, column in logged.items()
    }
    if len(pairs.reference_names) < 2:
        series["separation"] = pairs.lower_depth_m - pairs.upper_depth_m
    heading, flow = pairs.lower_heading_deg, angles.direction(pairs.lower_east, pairs.lower_north)
    if heading is not None and angles.resultant_length(heading - flow) < FOLLOWS_FLOW:
        series["reference_heading"] = heading
    return {name: fill_gaps(column) for name, column in series.items() if name in TILT_CORRECTIONS or varies(column)}


def reference_values(columns: Mapping[str, Floats]) -> dict[str, float]:
    """Compute the reference of each covariate: its mean, or 0 if it is a departure already."""
    means = {name: 0.0 if name in WITHOUT_REFERENCE else float(np.mean(column)) for name, column in columns.items()}
    tilts = [columns[name] for name in ("pitch", "roll") if name in columns]
    return means | ({"tilt": float(np.mean(np.hypot.reduce(tilts)))} if tilts else {})


def smooth_supply(name: str, column: Floats, time_s: Floats) -> Floats:
    """Average a supply voltage over a day, (n,); other series are returned unchanged.

    A battery voltage changes over days; faster variations are mostly quantization, and would hide that a steadily
    falling voltage is collinear with time.
    """
    return running_mean(column, time_s, DAY_S) if name == "supply_voltage" and len(column) else column


def running_mean(column: Floats, time_s: Floats, span_s: float) -> Floats:
    """Average a series, (n,), NaN where missing, over a time span around each sample."""
    first, last = (np.searchsorted(time_s, time_s + half, "left") for half in (-span_s / 2.0, span_s / 2.0))
    total, count = (
        np.concatenate([[0.0], np.cumsum(x)]) for x in (np.nan_to_num(column), np.isfinite(column).astype(float))
    )
    known = count[last] - count[first]
    return np.asarray(np.where(known > 0.0, (total[last] - total[first]) / np.maximum(known, 1.0), np.nan))


def varies(column: Floats) -> bool:
    """Return whether a covariate is available at most samples and has more than a few distinct values."""
    known = column[np.isfinite(column)]
    return 2 * len(known) > len(column) and len(np.unique(known)) >= FEWEST_VALUES


def is_like_time(column: Floats, time_s: Floats) -> bool:
    """Return whether a series that varies follows time so closely that a smooth curve of it is one of time."""
    return bool(abs(np.corrcoef(column, time_s)[0, 1]) >= 0.9)  # 81 % of the variance


def fill_gaps(column: Floats) -> Floats:
    """Fill missing values with the median."""
    return np.where(np.isfinite(column), column, np.nanmedian(column))


def departures(
    pairs: Pairs, covariates: Mapping[str, Floats], references: Mapping[str, float], heading_deg: Floats
) -> dict[str, Floats]:
    """Compute the series that the terms need: covariates minus their references, and rates, (n,) each.

    Args:
        covariates: from ``pair_covariates``.
        references: value that is subtracted, by name; see ``reference_values``.
        heading_deg: magnetic headings corrected by the fit, (n,), degrees; NaN where there is none.
    """
    result = {name: column - references.get(name, 0.0) for name, column in covariates.items()}
    if np.any(rate := turn_rate(pairs.heading_deg, pairs.time_s)):
        result["turn_rate"] = rate
    turned = angles.turn(
        pairs.upper_east, pairs.upper_north, np.nan_to_num(angles.difference(heading_deg, pairs.heading_deg))
    )
    velocity = _complex(*turned), _complex(pairs.lower_east, pairs.lower_north)
    both = _mean_flow(*velocity)
    result |= _flow_departures(pairs, velocity, both)
    upper, lower = (running_mean(speed, pairs.time_s, SPEED_SPAN_S) for speed in pair_speeds(pairs))
    true_heading = np.where(np.isfinite(heading_deg), heading_deg, pairs.heading_deg) + pairs.declination_deg
    result |= _body_frame_flow(_waves(true_heading, 2), upper, result, "body")
    if "reference_heading" in covariates:
        waves = _waves(covariates["reference_heading"], 2)
        waves = _independent_waves(waves, velocity[1], both, _flow_waves(result))
        result |= _body_frame_flow(waves * _waves(pairs.declination_deg, 2), lower, result, "reference")
        wave = waves[:, 0] - waves[:, 0].mean()
        result |= {"reference_sine": wave.imag, "reference_cosine": wave.real}
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
    """Get the storm index ap, (n,), converted from Kp, in tenths where it exceeds 9; None if neither was logged."""
    if "ap" in covariates:
        return np.maximum(covariates["ap"], 0.0)
    if "kp" not in covariates:
        return None
    thirds = 3.0 * covariates["kp"]
    thirds = thirds / 10.0 if thirds.max() >= len(AP_OF_KP) else thirds
    return np.interp(thirds, np.arange(len(AP_OF_KP)), AP_OF_KP)


def turn_rate(angle_deg: Floats, time_s: Floats) -> Floats:
    """Compute the rate of an angle from the neighbours of each sample, (n,) degrees/s; 0 if they are too far apart."""
    turn, apart = angles.difference(angle_deg[2:], angle_deg[:-2]), time_s[2:] - time_s[:-2]
    result = np.zeros(len(time_s))
    result[1:-1] = np.where(apart <= 2.0 * NEIGHBOUR_S, turn / apart, 0.0)
    return result


def battery_count(voltage: Floats, least_rise: float = 0.3) -> Floats:
    """Count the batteries replaced so far, (n,), by lasting rises of at least a share of the voltage's range."""
    window = min(24, len(voltage) // 8)
    if window == 0:
        return np.zeros(len(voltage))
    smooth = np.median(np.lib.stride_tricks.sliding_window_view(voltage, window), axis=1)
    rise = smooth[window:] - smooth[:-window]
    number, last = np.zeros(len(voltage)), -len(voltage)
    padded = np.pad(rise, window, constant_values=-np.inf)
    highest = np.lib.stride_tricks.sliding_window_view(padded, 2 * window + 1).max(axis=1)
    for at in np.flatnonzero((rise > least_rise * np.ptp(voltage)) & (rise >= highest)):
        if at - last > window:  # quantized voltages have equal maxima at several neighbours: count one battery
            number[at + window :] += 1.0
        last = int(at)
    return number


def _mean_flow(upper: Complexes, lower: Complexes) -> Complexes:
    """Average two velocities, (n,) east + i north, so that their noise and their slow shear are not in the mean.

    The directional noise of both instruments is part of the residual too, and a regressor must not contain it. Slow
    shear cancels in the mean of the two velocities, sample-to-sample noise in their mean weighted by the noise of each.
    """
    # With the lower instrument's noise share as weight of the upper, the noise of mean and difference is uncorrelated.
    a, b = np.diff(upper, 2), np.diff(lower, 2)
    common = float(np.real(np.mean(a * np.conj(b))))
    noise = [max(float(np.mean(np.abs(x) ** 2)) - common, 0.0) for x in (a, b)]
    share = noise[1] / max(sum(noise), 1e-12)
    apart = upper - lower
    reach = min(len(apart), 2 * SHEAR_REACH + 1)
    nearby = np.ones(reach)
    smooth = np.convolve(apart, nearby, "same") / np.convolve(np.ones(len(apart)), nearby, "same")
    return np.asarray((upper + lower) / 2.0 + (share - 0.5) * (apart - smooth))


def _flow_departures(pairs: Pairs, velocity: tuple[Complexes, Complexes], both: Complexes) -> dict[str, Floats]:
    """Predict the direction of the flow from neighbouring hours, its rate of turn, and the turn by mooring motion.

    The noise of neighbouring hours is mostly removed by the residual's whitening filter. Since such a prediction is
    attenuated, it is scaled by a regression of the observed direction on it (first stage of two-stage least squares),
    which keeps the size of a veer with direction unbiased.

    Args:
        velocity: of both instruments, (n,) each, m/s east + i north.
        both: their mean.
    """
    upper, lower = velocity
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
    # Rate of turn of the flow from a straight line through five samples, degrees/h, 0 at gaps.
    five = np.lib.stride_tricks.sliding_window_view(both, 5)
    hours = np.lib.stride_tricks.sliding_window_view(pairs.time_s, 5) / HOUR_S
    away = hours - hours.mean(axis=1, keepdims=True)
    trend, middle = np.sum(away * five, axis=1) / np.sum(away**2, axis=1), five.mean(axis=1)
    turn = -np.imag(trend * np.conj(middle)) / np.maximum(np.abs(middle), 0.02) ** 2 / angles.DEGREE
    flow_turn = np.zeros(len(both))
    flow_turn[2:-2] = np.where(np.ptp(hours, axis=1) <= 4.5, turn, 0.0)
    parts = (part for wave in predicted.T for part in (wave.imag, wave.real))
    return {"excursion_turn": across, "flow_turn": flow_turn} | dict(zip(FLOW_NAMES, parts, strict=True))


def reference_turns(pairs: Pairs, residual_deg: Floats) -> tuple[Floats, Floats]:
    """Compare at dates, (k,) seconds, that the reference turned with that it did not, by its own directions.

    A step of the residual is one of the reference if the axis of its currents, before and after, turns by as much. By
    how much currents turn by themselves is the median of all dates; a t distribution allows for more.

    Returns:
        The dates, and the log likelihood ratios.
    """
    most_s, fewest, freedom, least_deg = 30.0 * DAY_S, 100, 4.0, 1.0
    begin_s, span_s = float(pairs.time_s[0]), float(np.ptp(pairs.time_s))
    dates_s, window_s = begin_s + np.linspace(0.05, 0.95, 61) * span_s, min(most_s, span_s / 4.0)
    axis = (pairs.lower_east + 1j * pairs.lower_north) ** 2
    turns, steps = np.zeros((2, len(dates_s)))  # 0 where a gap leaves too few pairs
    for k, date_s in enumerate(dates_s):
        at = np.searchsorted(pairs.time_s, [date_s - window_s, date_s, date_s + window_s])
        before, after = slice(at[0], at[1]), slice(at[1], at[2])
        if min(np.diff(at)) >= fewest:
            turns[k] = -angles.wrap180(angles.argument(axis[after].mean() * np.conj(axis[before].mean()))) / 2.0
            steps[k] = angles.difference(*(angles.mean(residual_deg[part]) for part in (after, before)))
    usual = max(1.48 * float(np.median(np.abs(turns[turns != 0.0]))), least_deg) if turns.any() else least_deg
    unlikely, likely = (np.log1p((x / usual) ** 2 / freedom) for x in (turns, turns - steps))
    return dates_s, (freedom + 1.0) / 2.0 * (unlikely - likely)


def _independent_waves(waves: Complexes, lower: Complexes, both: Complexes, flow: Complexes) -> Complexes:
    """Remove from the waves of the reference's heading, (n, k), what follows the water at that time and its own depth.

    A vane, or an instrument with a fin, points along its own water. Its heading then contains the shear between the two
    depths, which is in the residual too, so that any function of it would explain a part of the residual. Each wave is
    regressed on the predicted direction of the flow, on the departure of its own flow from the mean one, at the sample
    and on average over the samples around, and on what the prediction lacks; the part by the latter three is removed
    (control function: Wooldridge, J. Hum. Resour. 50, 420, 2015). It follows them by no more than its own flow as a
    whole, so that an instrument that turns independently keeps its waves.

    Args:
        lower: velocity at the reference, (n,) east + i north.
        both: mean of both velocities, (n,).
        flow: waves of the predicted direction, (n, 4).
    """
    own, mean, window = _harmonics(lower), _harmonics(both), np.ones(2 * SHEAR_REACH + 1) / (2 * SHEAR_REACH + 1)
    others, result = np.column_stack([flow, np.ones(len(flow))]), np.empty_like(waves)
    for k, wave in enumerate(waves.T):
        apart, alignment = own[:, k] - mean[:, k], np.mean(wave * np.conj(own[:, k]))
        around = convolve1d(apart, window, mode="nearest")
        departures = alignment * np.column_stack([apart, around, mean[:, k] - flow[:, k]])
        columns = np.column_stack([departures, wave])
        by_flow, *_ = np.linalg.lstsq(others, columns, rcond=None)
        left = np.ascontiguousarray((columns - others @ by_flow).T).view(float)
        shares, *_ = np.linalg.lstsq(left[:-1].T, left[-1], rcond=None)
        result[:, k] = wave - departures @ np.clip(shares, 0.0, 1.0)
    return result


def _body_frame_flow(waves: Complexes, speed: Floats, of_flow: Mapping[str, Floats], whose: str) -> dict[str, Floats]:
    """Compute sine and cosine of the flow's angle in the body frame divided by speed, and the sine of twice the angle.

    The waves, (n, 2), are of headings relative to true north, the speed is averaged over some hours.
    """
    body = _flow_waves(of_flow)[:, :2] * np.conj(waves)
    scaled = body[:, 0] / np.maximum(speed, SLOWEST_M_S)
    return {
        f"{whose}_flow_sine": scaled.imag,
        f"{whose}_flow_cosine": scaled.real,
        f"{whose}_flow_sine2": body[:, 1].imag,
    }


def _flow_waves(of_flow: Mapping[str, Floats]) -> Complexes:
    """Get the waves of the predicted direction of the flow, (n, 4)."""
    sines, cosines = ([of_flow[name] for name in FLOW_NAMES[k::2]] for k in (0, 1))
    return _complex(np.array(cosines), np.array(sines)).T


def _waves(angle_deg: Floats, count: int) -> Complexes:
    """Compute cosine + i sine of an angle and of its multiples, (n, count)."""
    return angles.phasor(np.multiply.outer(angle_deg, np.arange(1, count + 1)))


def _harmonics(flow: Complexes) -> Complexes:
    """Compute the waves of the flow's direction, (n, 4); 0 without velocity."""
    return np.where(np.abs(flow)[:, None] > 0.0, _waves(angles.direction(flow.real, flow.imag), 4), 0.0)


def _scale_prediction(waves: Complexes, around: Complexes, memory: float) -> Complexes:
    """Scale predicted waves by regressing the observed ones on them, lag-one autocorrelation removed, (n, k)."""
    observed, predicted = (each.view(float) for each in (waves, around))
    x, z = (series[1:] - memory * series[:-1] for series in (observed, predicted))
    known = np.any(around[1:], axis=1) & np.any(around[:-1], axis=1)
    if not known.any():
        return around
    x, z = (series[known] - series[known].mean(axis=0) for series in (x, z))
    shares, *_ = np.linalg.lstsq(z, x, rcond=FAINTEST)
    scaled = predicted @ shares
    return np.asarray(scaled + (np.mean(observed, axis=0) - np.mean(scaled, axis=0))).view(complex)


def _predict_from_neighbours(flow: Complexes, time_s: Floats) -> Complexes:
    """Predict the flow by least squares from samples some hours before and after; 0 where these are missing.

    A record whose samples are further apart, as of a profiler, is returned as it is.
    """
    most = NEIGHBOURS[-1]
    inside = np.arange(most, len(flow) - most)
    inside = inside[time_s[inside + most] - time_s[inside - most] <= (2 * most + 0.5) * HOUR_S]
    if len(inside) <= FEWEST_FITTED:
        return flow
    others = [flow[inside + side * apart] for apart in NEIGHBOURS for side in (-1, 1)]
    columns, result = np.column_stack([*others, np.ones(len(inside))]), np.zeros(len(flow), dtype=complex)
    weights, *_ = np.linalg.lstsq(columns, flow[inside], rcond=None)
    result[inside] = columns @ weights
    return result


def _complex(east: Floats, north: Floats) -> Complexes:
    return np.asarray(east + 1j * north)


def hat_columns(x: Floats, count: int) -> Floats:
    """Build piecewise linear hat functions on knots at equally spaced quantiles, (n, k)."""
    knots = np.unique(np.quantile(x, np.linspace(0.0, 1.0, count)))
    if len(knots) < 2:
        return np.zeros((len(x), 0))
    eye = np.eye(len(knots))
    return np.column_stack([np.interp(x, knots, row) for row in eye])


def standardize(x: Floats) -> Floats:
    """Standardize a series and clip it at 4 standard deviations, (n,)."""
    return np.clip((x - np.mean(x)) / np.std(x), -4.0, 4.0)
