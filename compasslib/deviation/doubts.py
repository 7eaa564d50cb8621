"""Stretches of a record whose corrected headings may be wrong by more than the fit's own uncertainty.

Part of a record may be repeated, stuck, taken out of the water, or measured by another compass. The observed heading
minus the corrected one is described window by window: its mean, its dependence on the corrected heading, its scatter,
and how often the compass cannot have recorded what it did. A window that lies far outside the other windows is
doubtful, whatever the fit to the whole record says. So is a record of which every k-th sample, or one hour of the day,
differs from the others: two recordings were put together, or samples have another sample's time.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.deviation.model import DeviationFit, heading_residual, observed_heading, pair_speeds
from compasslib.records import Pairs, iso_time
from compasslib.statistics.resampling import adjacent
from compasslib.types import DAY_S, HOUR_S, Bools, Floats


@dataclass(frozen=True)
class Doubt:
    """A stretch of time whose headings are flagged doubtful."""

    from_s: float  # first and last instant, UTC seconds; -inf and inf: the whole record
    to_s: float
    sigma_deg: float  # standard deviation of the error that is suspected
    why: str

    def to_json(self) -> dict[str, Any]:
        """Compose it for deviation.json; the ends of a whole record are null."""
        ends = {"from": self.from_s, "to": self.to_s}
        return {name: iso_time(when) if np.isfinite(when) else None for name, when in ends.items()} | {
            "sigma_deg": self.sigma_deg,
            "why": self.why,
        }


def doubt_whole_record(sigma_deg: float, why: str) -> Doubt:
    """Doubt every heading of a record."""
    return Doubt(-np.inf, np.inf, sigma_deg, why)


def doubts_from_json(content: Sequence[Mapping[str, Any]]) -> tuple[Doubt, ...]:
    """Read the doubts that a deviation.json lists."""

    def instant(text: str | None, absent: float) -> float:
        return absent if text is None else datetime.fromisoformat(text).timestamp()

    return tuple(
        Doubt(instant(item["from"], -np.inf), instant(item["to"], np.inf), item["sigma_deg"], item["why"])
        for item in content
    )


def evaluate_doubts(doubts: Sequence[Doubt], time_s: Floats) -> tuple[Bools, Floats]:
    """Find the samples that are doubted, and the standard deviation that the doubts add, (n,) degrees."""
    doubted, variance = np.zeros(time_s.shape, dtype=bool), np.zeros(time_s.shape)
    for doubt in doubts:
        inside = (time_s >= doubt.from_s) & (time_s <= doubt.to_s)
        doubted |= inside
        variance[inside] += doubt.sigma_deg**2
    return doubted, np.minimum(np.sqrt(variance), angles.UNIFORM_SIGMA_DEG)


WINDOW_S, MIN_WINDOW_PAIRS = 5 * DAY_S, 40  # of a window: several days of water, and enough pairs for four numbers
MIN_WINDOWS = 6  # from which the others tell what is usual
# Robust standard deviations beyond which a window is far off the others: turn, log scatter, share lost; of the heading
# dependence, medians of what it makes. Real water between two depths turned for five days by 28° (eh2): 6 of them.
FAR_SIGMAS = np.array([8.0, 6.0, 3.0, 6.0])
GROWS = 0.5  # of these, for a window beside one that is far off
# Least spread between windows: mean turn and what the heading dependence makes in degrees, log scatter, share lost.
LEAST_SPREAD = np.array([5.0, 3.0, 0.2, 0.03])
# Least departure that matters, in the same units.
LEAST_DEPARTURE = np.array([20.0, 20.0, 0.5, 0.25])
# Turn and heading dependence together in each of two windows in a row, degrees, and over the median window's: sound
# moorings, real water included, have at most 13 degrees and 3.7 times.
IN_A_ROW_DEG, IN_A_ROW_TIMES, LEAST_USUAL_DEG = 15.0, 4.5, 2.0
# Share of the pairs in far-off windows above which the fit may describe these as well as the others: chosen, not
# measured.
LARGE_SHARE = 0.25
LEAST_DOUBT_DEG = 10.0  # standard deviation of the error that a doubt suspects
# Period and remainder of the index of samples that are compared with the others.
INDICES = [(period, k) for period in (2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 24) for k in range(period)]
# Least turn and log scatter of one index against the others, and excess of its rms; sound moorings 5°, 0.26.
INDEX_TURN_DEG, INDEX_TURN_SIGMAS, INDEX_LOG_SCATTER, INDEX_RMS_DEG = 12.0, 6.0, 0.5, 15.0
CLEARER = 1.5  # times more of a departure before a longer period is taken
CLIP = 4.0  # widths beyond which a residual counts no more: slow water may point anywhere


@dataclass(frozen=True)
class Windows:
    """What each of k windows shows."""

    first: NDArray[np.intp]  # (k,) index of the first pair
    last: NDArray[np.intp]  # (k,) index of the last pair
    features: Floats  # (k, 5) mean turn, sine and cosine of the corrected heading (degrees), log scatter, share lost
    spread: Floats  # (k, 2, 2) covariance of sine and cosine of the corrected heading
    rms_deg: Floats  # (k,) of the residual


@dataclass(frozen=True)
class Residuals:
    """Observed minus corrected headings of n pairs."""

    residual_deg: Floats  # (n,) NaN where the compass cannot have recorded what it did
    width_deg: Floats  # (n,) that is expected of each
    heading_deg: Floats  # (n,) corrected

    @property
    def lost(self) -> Bools:
        """(n,) where the compass cannot have recorded what it did."""
        return np.isnan(self.residual_deg)

    def rms_deg(self, selected: NDArray[np.intp] | Bools) -> float:
        """Compute the rms of some residuals; the lost ones count as directions that may be anything."""
        return angles.rms(np.where(self.lost[selected], angles.UNIFORM_SIGMA_DEG, self.residual_deg[selected]))


def find_doubtful_windows(pairs: Pairs, fit: DeviationFit) -> tuple[Doubt, ...]:
    """Find the windows of a record, and the samples of one index, that disagree with the rest of it.

    Where the windows hold a large share of the pairs the whole record is doubted: the fit may be to the wrong part.

    Args:
        pairs: overlapping measurements as the compass of the fit would have recorded them.
    """
    if not fit.fitted or fit.method == "von_appen" or len(pairs) < MIN_WINDOWS * MIN_WINDOW_PAIRS:
        return ()
    residual = heading_residual(fit, pairs)
    heading = observed_heading(pairs) - np.nan_to_num(residual)
    residuals = Residuals(residual, fit.noise.width_deg(*pair_speeds(pairs)), heading)
    parts = _cut(pairs.time_s)
    first, last = (np.array([selected[k] for selected in parts]) for k in (0, -1))
    features, spread = (np.array(x) for x in zip(*(_features(selected, residuals) for selected in parts), strict=True))
    windows = Windows(first, last, features, spread, np.array([residuals.rms_deg(selected) for selected in parts]))
    far = _far_windows(windows)
    usual = float(np.median(windows.rms_deg[~far])) if (~far).any() else 0.0
    stretches = tuple(_doubts(pairs, windows, far, usual))
    count = windows.last - windows.first + 1
    if count[far].sum() > LARGE_SHARE * count.sum():
        why = (
            f"{count[far].sum() / count.sum():.0%} of the pairs with the reference disagree with the others, and the "
            "record cannot tell which of the two parts is correct"
        )
        turns = (angles.argument(np.sum(angles.phasor(windows.features[part, 0]))) for part in (far, ~far))
        apart = abs(float(angles.difference(*turns)))
        stretches = (*stretches, doubt_whole_record(max(apart, *(doubt.sigma_deg for doubt in stretches)), why))
    return (*_by_index(pairs.time_s, residuals), *stretches)


def _by_index(time_s: Floats, residuals: Residuals) -> tuple[Doubt, ...]:
    """Doubt a record of which every k-th sample, or one hour of the day, differs most from the others."""
    step_s = float(np.median(np.diff(time_s)))
    index = np.rint(time_s / step_s).astype(int)
    worst, why = 0.0, ""
    for period, k in INDICES:
        selected = index % period == k
        if min(selected.sum(), (~selected).sum()) < MIN_WINDOW_PAIRS:
            continue
        (turn, error, scatter), (others, _, usual) = (
            _turn_and_scatter(part, residuals) for part in (selected, ~selected)
        )
        turn = abs(float(angles.difference(turn, others)))
        rms, usual_rms = (residuals.rms_deg(part) for part in (selected, ~selected))
        excess = float(np.sqrt(max(rms**2 - usual_rms**2, 0.0)))
        turned = turn > max(INDEX_TURN_DEG, INDEX_TURN_SIGMAS * error)
        scattered = scatter - usual > INDEX_LOG_SCATTER and excess > INDEX_RMS_DEG
        if (turned or scattered) and max(turn, excess) > CLEARER * worst:  # a longer period holds the shorter one
            worst = max(turn, excess)
            day = f"those of {k * step_s / HOUR_S:02.0f}:00 UTC" if abs(period * step_s - DAY_S) < 1.0 else ""
            why = (
                f"of the hours paired with the reference, {day or f'one in {period}'} differ by {rms:.0f}° rms and the "
                f"others by {usual_rms:.0f}°: two recordings may have been put together in one instrument's file, or "
                "some samples have the time of others"
            )
    return (doubt_whole_record(min(worst, angles.UNIFORM_SIGMA_DEG), why),) if why else ()


def _turn_and_scatter(selected: Bools, residuals: Residuals) -> tuple[float, float, float]:
    """Compute the mean residual of some pairs, its standard error (degrees) and the log of its scatter in widths."""
    known = selected & ~residuals.lost
    if known.sum() < MIN_WINDOW_PAIRS:
        return np.nan, np.nan, np.nan
    residual, width = residuals.residual_deg[known], residuals.width_deg[known]
    turn = float(angles.argument(np.sum(angles.phasor(residual) / width**2)))
    scatter = np.clip(angles.difference(residual, turn) / width, -CLIP, CLIP)
    size = float(np.sqrt(np.mean(scatter**2) + 1e-6))
    return turn, size / float(np.sqrt(np.sum(1.0 / width**2))), float(np.log(size))


def _cut(time_s: Floats) -> list[NDArray[np.intp]]:
    """Cut the pairs into windows: as many windows of WINDOW_S as hold enough pairs on the average."""
    span = float(np.ptp(time_s))
    length = max(WINDOW_S, span * MIN_WINDOW_PAIRS / len(time_s))
    number = np.floor((time_s - time_s[0]) / length).astype(int)
    cut = [np.flatnonzero(number == k) for k in range(number[-1] + 1)]
    return [selected for selected in cut if len(selected) >= MIN_WINDOW_PAIRS // 2]


def _features(selected: NDArray[np.intp], residuals: Residuals) -> tuple[list[float], Floats]:
    """Describe the residuals of a window, see ``Windows``; the mean turn is that at its mean heading."""
    residual, lost, width, heading = residuals.residual_deg, residuals.lost, residuals.width_deg, residuals.heading_deg
    known = selected[~lost[selected]]
    if len(known) < MIN_WINDOW_PAIRS // 4:
        return [0.0, 0.0, 0.0, 0.0, float(lost[selected].mean())], np.zeros((2, 2))
    weight = 1.0 / width[known] ** 2
    turn = float(angles.argument(np.sum(weight * angles.phasor(residual[known]))))
    left = angles.difference(residual[known], turn)
    columns = np.column_stack(angles.sin_cos(heading[known]))
    # About their mean: where a window has few headings, a turn and a dependence would else stand for each other.
    design = np.column_stack([np.ones(len(known)), columns - np.average(columns, axis=0, weights=weight)])
    # The prior keeps a window of one heading from telling a turn as a dependence on heading.
    normal = (design.T * weight) @ design + np.diag([0.0, 1.0, 1.0]) / 30.0**2
    bounded = np.clip(left, -CLIP * width[known], CLIP * width[known])
    fitted = np.linalg.solve(normal, (design.T * weight) @ bounded)
    scatter = np.clip((left - design @ fitted) / width[known], -CLIP, CLIP)
    turn = float(angles.wrap180(turn + fitted[0]))
    log_scatter = 0.5 * float(np.log(np.mean(scatter**2) + 1e-6))
    return [turn, fitted[1], fitted[2], log_scatter, float(lost[selected].mean())], np.cov(design[:, 1:].T)


def _far_windows(windows: Windows) -> Bools:
    """Find the windows that lie far outside the others and differ by an amount that matters, (k,)."""
    features = windows.features
    if len(features) < MIN_WINDOWS:
        return np.zeros(len(features), dtype=bool)
    off = features - np.median(features, axis=0)
    dependence = np.sqrt(np.einsum("ki,kij,kj->k", off[:, 1:3], windows.spread, off[:, 1:3]))
    off = np.column_stack([np.abs(angles.wrap180(off[:, 0])), dependence, off[:, 3], off[:, 4]])
    spread = np.maximum(np.median(np.abs(off), axis=0) * [1.4826, 1.0, 1.4826, 1.4826], LEAST_SPREAD)
    matters, departure = off > LEAST_DEPARTURE, off / spread / FAR_SIGMAS
    far, near = (np.asarray((matters & (departure > least)).any(axis=1)) for least in (1.0, GROWS))
    size = np.hypot(off[:, 0], off[:, 1])
    large = size > max(IN_A_ROW_DEG, IN_A_ROW_TIMES * max(float(np.median(size)), LEAST_USUAL_DEG))
    far = far | (large & adjacent(large))
    for _ in range(len(far)):  # a stretch begins in a window: those beside it that are nearly far off belong to it
        far = far | (near & adjacent(far))
    return far


def _doubts(pairs: Pairs, windows: Windows, far: Bools, usual_deg: float) -> Iterator[Doubt]:
    """Give a doubt for each run of neighbouring windows that are far off."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], far.astype(int), [0]])))
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        n = len(far)
        from_s = pairs.time_s[windows.first[begin]] if begin else -np.inf
        to_s = pairs.time_s[windows.last[end - 1]] if end < n else np.inf
        rms = float(np.sqrt(np.mean(windows.rms_deg[begin:end] ** 2)))
        sigma = float(min(np.sqrt(max(rms**2 - usual_deg**2, LEAST_DOUBT_DEG**2)), angles.UNIFORM_SIGMA_DEG))
        shown = [iso_time(float(pairs.time_s[k])) for k in (windows.first[begin], windows.last[end - 1])]
        why = (
            f"from {shown[0]} to {shown[1]} directions differ from the reference by {rms:.0f}° rms and by "
            f"{usual_deg:.0f}° in the rest of the record: the compass, the record or the reference was another then"
        )
        yield Doubt(float(from_s), float(to_s), sigma, why)
