"""Periods of a record whose corrected headings may be wrong by more than the fit's own uncertainty.

Part of a record may be repeated, stuck, recorded out of the water, or measured by another compass. The residual,
observed minus corrected heading, is described in windows: its mean, its dependence on the corrected heading, its
scatter, and the share of headings that the fitted compass cannot have recorded. A window that is far outside the other
windows is doubtful, even if the whole record fits well.
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
from compasslib.types import DAY_S, Bools, Floats


@dataclass(frozen=True)
class Doubt:
    """A period whose headings are flagged as doubtful."""

    from_s: float  # begin and end, UTC seconds; -inf and inf: the whole record
    to_s: float
    sigma_deg: float  # standard deviation of the suspected error
    why: str

    def to_json(self) -> dict[str, Any]:
        """Convert to the content of deviation.json; infinite ends become null."""
        ends = {"from": self.from_s, "to": self.to_s}
        return {name: iso_time(when) if np.isfinite(when) else None for name, when in ends.items()} | {
            "sigma_deg": self.sigma_deg,
            "why": self.why,
        }


def doubt_whole_record(sigma_deg: float, why: str) -> Doubt:
    """Make a doubt about every heading of a record."""
    return Doubt(-np.inf, np.inf, sigma_deg, why)


def doubts_from_json(content: Sequence[Mapping[str, Any]]) -> tuple[Doubt, ...]:
    """Build the doubts from the content of deviation.json."""

    def instant(text: str | None, absent: float) -> float:
        return absent if text is None else datetime.fromisoformat(text).timestamp()

    return tuple(
        Doubt(instant(item["from"], -np.inf), instant(item["to"], np.inf), item["sigma_deg"], item["why"])
        for item in content
    )


def evaluate_doubts(doubts: Sequence[Doubt], time_s: Floats) -> tuple[Bools, Floats]:
    """Find the doubtful samples, (n,), and the standard deviation added by the doubts, (n,) degrees."""
    doubted, variance = np.zeros(time_s.shape, dtype=bool), np.zeros(time_s.shape)
    for doubt in doubts:
        inside = (time_s >= doubt.from_s) & (time_s <= doubt.to_s)
        doubted |= inside
        variance[inside] += doubt.sigma_deg**2
    return doubted, np.minimum(np.sqrt(variance), angles.UNIFORM_SIGMA_DEG)


WINDOW_S, MIN_WINDOW_PAIRS = 5 * DAY_S, 40  # of a window: several days, and enough pairs for four parameters
MIN_WINDOWS = 6  # needed to estimate the usual spread
# Outlier limits of a window: mean, log scatter and share lost in robust standard deviations, heading dependence (the
# second) in medians. Real water between two depths veered for five days by 28° (eh2): 6 standard deviations.
FAR_SIGMAS = np.array([8.0, 6.0, 3.0, 6.0])
GROWS = 0.5  # factor on these limits for a window adjacent to an outlying one
# Lower bounds of the spread between windows: mean and heading dependence in degrees, log scatter, share lost.
LEAST_SPREAD = np.array([5.0, 3.0, 0.2, 0.03])
# Smallest relevant departure, in the same units.
LEAST_DEPARTURE = np.array([20.0, 20.0, 0.5, 0.25])
# Mean and heading dependence combined in each of two consecutive windows, degrees, and ratio to the median window's:
# sound moorings, real water included, have at most 13 degrees and 3.7.
IN_A_ROW_DEG, IN_A_ROW_TIMES, LEAST_USUAL_DEG = 15.0, 4.5, 2.0
# Share of the pairs in outlying windows above which the fit may be to the wrong part of the record: chosen, not
# measured.
LARGE_SHARE = 0.25
LEAST_DOUBT_DEG = 10.0  # lower bound of the standard deviation of a suspected error
CLIP = 4.0  # bound of residuals in widths: slow water may have any direction


@dataclass(frozen=True)
class Windows:
    """Statistics of the residuals in k windows."""

    first: NDArray[np.intp]  # (k,) index of the first pair
    last: NDArray[np.intp]  # (k,) index of the last pair
    features: Floats  # (k, 5) mean, coefficients of sine and cosine of heading (degrees), log scatter, share lost
    spread: Floats  # (k, 2, 2) covariance of sine and cosine of the corrected heading
    rms_deg: Floats  # (k,) of the residual


@dataclass(frozen=True)
class Residuals:
    """Observed minus corrected headings of n pairs."""

    residual_deg: Floats  # (n,) NaN where the fitted compass cannot have recorded the heading
    width_deg: Floats  # (n,) expected scatter
    heading_deg: Floats  # (n,) corrected

    @property
    def lost(self) -> Bools:
        """Mask of headings that the fitted compass cannot have recorded, (n,)."""
        return np.isnan(self.residual_deg)

    def rms_deg(self, selected: NDArray[np.intp] | Bools) -> float:
        """Compute the rms of selected residuals; lost ones count as uniformly distributed directions."""
        return angles.rms(np.where(self.lost[selected], angles.UNIFORM_SIGMA_DEG, self.residual_deg[selected]))


def find_doubtful_windows(pairs: Pairs, fit: DeviationFit) -> tuple[Doubt, ...]:
    """Find the windows of a record that disagree with the rest of it.

    If the windows contain a large share of the pairs, the whole record is doubtful: the fit may be to the wrong part.

    Args:
        pairs: overlapping measurements as the compass of the fit alone would have recorded them.
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
    return stretches


def _cut(time_s: Floats) -> list[NDArray[np.intp]]:
    """Divide the pairs into windows of WINDOW_S, or longer ones if these have too few pairs on average."""
    span = float(np.ptp(time_s))
    length = max(WINDOW_S, span * MIN_WINDOW_PAIRS / len(time_s))
    number = np.floor((time_s - time_s[0]) / length).astype(int)
    cut = [np.flatnonzero(number == k) for k in range(number[-1] + 1)]
    return [selected for selected in cut if len(selected) >= MIN_WINDOW_PAIRS // 2]


def _features(selected: NDArray[np.intp], residuals: Residuals) -> tuple[list[float], Floats]:
    """Compute features and spread of a window, see ``Windows``; the mean residual is that at its mean heading."""
    residual, lost, width, heading = residuals.residual_deg, residuals.lost, residuals.width_deg, residuals.heading_deg
    known = selected[~lost[selected]]
    if len(known) < MIN_WINDOW_PAIRS // 4:
        return [0.0, 0.0, 0.0, 0.0, float(lost[selected].mean())], np.zeros((2, 2))
    weight = 1.0 / width[known] ** 2
    turn = float(angles.argument(np.sum(weight * angles.phasor(residual[known]))))
    left = angles.difference(residual[known], turn)
    columns = np.column_stack(angles.sin_cos(heading[known]))
    # Centred columns, so that mean and heading dependence are not confounded in a narrow range of headings.
    design = np.column_stack([np.ones(len(known)), columns - np.average(columns, axis=0, weights=weight)])
    # The prior keeps the heading dependence small in a window with nearly constant heading.
    normal = (design.T * weight) @ design + np.diag([0.0, 1.0, 1.0]) / 30.0**2
    bounded = np.clip(left, -CLIP * width[known], CLIP * width[known])
    fitted = np.linalg.solve(normal, (design.T * weight) @ bounded)
    scatter = np.clip((left - design @ fitted) / width[known], -CLIP, CLIP)
    turn = float(angles.wrap180(turn + fitted[0]))
    log_scatter = 0.5 * float(np.log(np.mean(scatter**2) + 1e-6))
    return [turn, fitted[1], fitted[2], log_scatter, float(lost[selected].mean())], np.cov(design[:, 1:].T)


def _far_windows(windows: Windows) -> Bools:
    """Find the windows that are far outside the others and differ by a relevant amount, (k,)."""
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
    for _ in range(len(far)):  # a period may begin within a window: add adjacent windows that are nearly outlying
        far = far | (near & adjacent(far))
    return far


def _doubts(pairs: Pairs, windows: Windows, far: Bools, usual_deg: float) -> Iterator[Doubt]:
    """Yield a doubt for each run of outlying windows."""
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
