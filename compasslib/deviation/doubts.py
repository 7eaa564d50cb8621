"""Periods of a record whose corrected headings may be wrong by more than the fit's own uncertainty.

Part of a record may be repeated, stuck, recorded out of the water, or measured by another compass. Windows of the
record are compared by the velocity that their residual, observed minus corrected heading, moves across the flow: slack
water may have any direction and does not count, and a difference of water between two depths is limited in cm/s.
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
from compasslib.statistics.resampling import adjacent, blocks_by_span
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


WINDOW_S, MIN_WINDOW_PAIRS = 5 * DAY_S, 40  # of a window: several days, and enough pairs for three parameters
MIN_WINDOWS = 6  # needed for a median
LEAST_DOUBT_DEG = 10.0  # lower bound of the standard deviation of a suspected error


def find_doubtful_windows(pairs: Pairs, fit: DeviationFit) -> tuple[Doubt, ...]:
    """Find the windows of a record that disagree with the rest, or doubt it all if they hold a quarter of the pairs."""
    if not fit.fitted or fit.method == "von_appen" or len(pairs) < MIN_WINDOWS * MIN_WINDOW_PAIRS:
        return ()
    # Windows of WINDOW_S, or longer ones if these have too few pairs on average.
    number = blocks_by_span(pairs.time_s, max(WINDOW_S, float(np.ptp(pairs.time_s)) * MIN_WINDOW_PAIRS / len(pairs)))
    windows = [np.flatnonzero(number == k) for k in range(number[-1] + 1)]
    windows = [rows for rows in windows if len(rows) >= MIN_WINDOW_PAIRS // 2]
    if len(windows) < MIN_WINDOWS:
        return ()
    residual, speed = heading_residual(fit, pairs), np.minimum(*pair_speeds(pairs))
    heading = observed_heading(pairs) - residual
    described = [_describe(residual[rows], speed[rows], heading[rows]) for rows in windows]
    flow, rms, turn, spread = (np.array(column) for column in zip(*described, strict=True))
    off = turn - np.median(turn, axis=0)
    systematic = np.sqrt(off[:, 0] ** 2 + np.einsum("ki,kij,kj->k", off[:, 1:], spread, off[:, 1:]))
    far = _far_windows(flow, rms, systematic)
    usual = float(np.median(rms[~far])) if (~far).any() else 0.0
    doubts = tuple(_doubts(pairs.time_s, windows, rms, far, usual))
    count = np.array([len(rows) for rows in windows])
    share = count[far].sum() / count.sum()
    if share > 0.25:
        why = (
            f"{share:.0%} of the pairs with the reference disagree with the others, and the record cannot tell which "
            "of the two parts is correct"
        )
        apart = float(np.hypot(rms[far].max(), rms[~far].max(initial=0.0)))
        doubts = (*doubts, doubt_whole_record(min(apart, angles.UNIFORM_SIGMA_DEG), why))
    return doubts


def _describe(residual_deg: Floats, speed: Floats, heading_deg: Floats) -> tuple[float, float, Floats, Floats]:
    """Describe the residuals of a window, NaN where no heading was possible, weighted by the slower speed squared.

    Returns rms speed, rms residual, mean with its dependence on sine and cosine of the heading, (3,), and the
    covariance of these, (2, 2).
    """
    known, flow = np.isfinite(residual_deg), float(np.sqrt(np.mean(speed**2)))
    if known.sum() < MIN_WINDOW_PAIRS // 4:
        return flow, angles.UNIFORM_SIGMA_DEG, np.zeros(3), np.zeros((2, 2))
    weight = speed[known] ** 2 / np.sum(speed[known] ** 2)
    rms = float(np.sqrt(weight @ (2.0 - 2.0 * angles.sin_cos(residual_deg[known])[1]))) / angles.DEGREE  # of the chord
    mean = angles.wrap180(angles.argument(weight @ angles.phasor(residual_deg[known])))
    across = angles.sin_cos(angles.difference(residual_deg[known], mean))[0] / angles.DEGREE
    columns = np.column_stack(angles.sin_cos(heading_deg[known]))
    columns = columns - weight @ columns  # so that mean and dependence are not confounded in a narrow range of headings
    root = np.sqrt(weight)[:, None]
    slope = np.linalg.lstsq(root * columns, root[:, 0] * across, rcond=None)[0]
    return flow, rms, np.append(mean, slope), (columns.T * weight) @ columns


def _far_windows(flow: Floats, rms_deg: Floats, systematic_deg: Floats) -> Bools:
    """Find the windows that are far outside the others and differ by a relevant angle, (k,).

    Without a fault, with iron of 0.05 to 1.3 H: beyond 30 degrees the velocity is at most 1.8 times the median on papa
    (bins 40 and 80 m apart), 1.5 on eh2 and aqd. The systematic part in two consecutive windows: on papa, where the
    water at two depths turns by 25 degrees for a month, 3.9 times, 23 degrees, 3.3 times the median angle; on eh2 1.7
    times.
    """
    beyond = np.sqrt(np.maximum(rms_deg**2 - np.median(rms_deg) ** 2, 0.0))
    times, turned = (flow * angle / max(float(np.median(flow * angle)), 1e-12) for angle in (rms_deg, systematic_deg))
    outlying = np.minimum(times / 2.2, beyond / 30.0)
    large = np.minimum(turned / 3.0, systematic_deg / max(15.0, 4.5 * float(np.median(systematic_deg))))
    far = (outlying > 1.0) | ((large > 1.0) & adjacent(large > 1.0))
    for _ in range(len(far)):  # a period may begin within a window: add adjacent windows that are half outlying
        far = far | ((np.maximum(outlying, large) > 0.5) & adjacent(far))
    return np.asarray(far)


def _doubts(
    time_s: Floats, windows: Sequence[NDArray[np.intp]], rms_deg: Floats, far: Bools, usual_deg: float
) -> Iterator[Doubt]:
    """Yield a doubt for each run of outlying windows."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], far.astype(int), [0]])))
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        ends = time_s[windows[begin][0]], time_s[windows[end - 1][-1]]
        rms = float(np.sqrt(np.mean(rms_deg[begin:end] ** 2)))
        sigma = float(min(np.sqrt(max(rms**2 - usual_deg**2, LEAST_DOUBT_DEG**2)), angles.UNIFORM_SIGMA_DEG))
        why = (
            f"from {iso_time(float(ends[0]))} to {iso_time(float(ends[1]))} directions differ from the reference by "
            f"{rms:.0f}° rms and by {usual_deg:.0f}° in the rest of the record: the compass, the record or the "
            "reference was another then"
        )
        yield Doubt(float(ends[0]) if begin else -np.inf, float(ends[1]) if end < len(far) else np.inf, sigma, why)
