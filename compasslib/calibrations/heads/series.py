"""The difference of two compasses as a series in b's recorded heading: as many terms as the headings carry.

The terms are Smith's (von Appen 2015, eq. 1; Moncunill Marimón et al. 2023, eq. 1): constant, semicircular, quadrantal.
The covariance is a jackknife over stretches of the record, because the errors of a cast follow each other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.calibrations.heads.motion import independent
from compasslib.calibrations.result import DeviationTable
from compasslib.deviation import von_appen
from compasslib.statistics import autocorrelation, blocks, robust
from compasslib.types import Floats

SETS = {5: "A, B, C, D, E", 3: "A, B, C", 1: "A"}  # terms of the series by their number
# A coefficient's variance over what full coverage would give it. With 10, three terms need about 160 degrees and five
# about 230.
MOST_INFLATION = 10.0
SECTOR_DEG, SECTORS = 10.0, 36
LEAST_IN_SECTOR = 5
CLIP_SIGMAS = 5.0  # beyond which a difference is a spike
# Assumed standard deviations of B, C, D, E where they are refused: what a difference of two compasses without strong
# iron may hold. A refused term is not zero: it leaks into those that are fitted.
ALLOWANCE_DEG = np.array([5.0, 5.0, 2.0, 2.0])
REACH_DEG = 10.0  # a table of fewer than five terms goes this far beyond the headings that were covered


@dataclass(frozen=True)
class HeadingDifference:
    """A fitted difference: what is to be added to b's recorded heading to get a's, turned."""

    terms: int  # 5, 3 or 1
    coefficients: Floats  # (terms,) degrees
    covariance: Floats  # (terms, terms), what refused terms may leak included
    sampling: Floats  # (terms, terms), without that
    leak: Floats  # (terms, 5 - terms) of each refused term into the fitted ones
    residual_deg: Floats  # (n,) of all differences
    kept: NDArray[np.bool_]  # (n,) not spikes
    structure_deg: float  # rms by sector of what the series leaves, beyond noise
    n_effective: float
    stretches: int
    covered: NDArray[np.bool_]  # (36,) sectors of b's recorded heading
    inflation: dict[int, Floats]  # terms -> variance of each over what the full circle would give
    refused: str  # which terms were refused and why; empty where none


def fit(time_s: Floats, recorded_deg: Floats, difference_deg: Floats, rate_sigma_deg: Floats) -> HeadingDifference:
    """Return the largest series that the covered headings carry, with its covariance.

    Args:
        time_s: increasing, (n,).
        recorded_deg: b's recorded heading, (n,).
        difference_deg: a's heading, turned, minus b's, in [-180, 180) about a small mean, (n,).
        rate_sigma_deg: what one standard deviation of the clocks does to each difference, (n,).
    """
    covered = covered_sectors(recorded_deg)
    inflation = {k: inflations(covered, k) for k in SETS}
    terms = next((k for k in SETS if inflation[k].max() <= MOST_INFLATION), 1)
    columns, others = np.split(von_appen.design(recorded_deg), [terms], axis=1)
    coefficients, kept = _robust(columns, difference_deg)
    residual = difference_deg - columns @ coefficients
    effective = autocorrelation.effective_number(residual[kept], time_s[kept])
    count, widened = independent(effective)
    rows, pulls = columns[kept], columns[kept] * residual[kept][:, None]
    covariance = blocks.jackknife(rows, pulls, blocks.in_time(time_s, count)[kept], rows.T @ rows) * widened
    solver = np.linalg.pinv(columns[kept])
    by_clock, leak = solver @ rate_sigma_deg[kept], solver @ others[kept]
    sampling = covariance + np.outer(by_clock, by_clock)
    return HeadingDifference(
        terms=terms,
        coefficients=coefficients,
        covariance=sampling + leak @ np.diag(ALLOWANCE_DEG[terms - 1 :] ** 2) @ leak.T,
        sampling=sampling,
        leak=leak,
        residual_deg=residual,
        kept=kept,
        structure_deg=_structure(recorded_deg[kept], residual[kept], effective),
        n_effective=effective,
        stretches=count,
        covered=covered,
        inflation=inflation,
        refused=_refused(terms, covered, inflation),
    )


def covered_sectors(recorded_deg: Floats) -> NDArray[np.bool_]:
    """Return which sectors of 10 degrees hold enough samples, (36,).

    Args:
        recorded_deg: recorded headings, (n,).
    """
    count = np.bincount((angles.wrap360(recorded_deg) / SECTOR_DEG).astype(int), minlength=SECTORS)[:SECTORS]
    return np.asarray(count >= max(LEAST_IN_SECTOR, 0.001 * len(recorded_deg)))


def inflations(covered: NDArray[np.bool_], terms: int) -> Floats:
    """Return the variance of each coefficient over what a coefficient alone would have, from the information matrix.

    Each covered sector counts alike: that a frame lingered at one heading does not help.

    Args:
        covered: sectors, (36,).
    """
    if covered.sum() < terms:
        return np.full(terms, np.inf)
    columns = von_appen.design(SECTOR_DEG * (np.flatnonzero(covered) + 0.5))[:, :terms]
    information = columns.T @ columns
    return np.asarray(np.diag(information) * np.diag(np.linalg.pinv(information, rcond=1e-12)))


def table(series: HeadingDifference) -> DeviationTable:
    """Return the deviation every 10 degrees without its constant; NaN far from what was covered by a short series."""
    return curve(series, np.arange(0.0, 360.0, 10.0))


def curve(series: HeadingDifference, heading_deg: Floats) -> DeviationTable:
    """Return the deviation at some headings, as ``table`` does.

    Args:
        heading_deg: recorded, (m,).
    """
    columns, others = np.split(von_appen.design(heading_deg), [series.terms], axis=1)
    # Where headings were covered the fitted terms have taken up the refused ones; beyond, these go their own way.
    unseen = (others - columns @ series.leak) * ALLOWANCE_DEG[series.terms - 1 :]
    # What the series leaves by sectors is the refused terms' own trace: the larger of the two, not both.
    left = np.maximum(np.sum(unseen**2, axis=1), series.structure_deg**2)
    sigma = np.sqrt(np.einsum("ni,ij,nj->n", columns, series.sampling, columns) + left)
    deviation = columns[:, 1:] @ series.coefficients[1:]
    known = near_covered(series, heading_deg)
    return DeviationTable(heading_deg, np.where(known, deviation, np.nan), np.where(known, sigma, np.nan))


def near_covered(series: HeadingDifference, heading_deg: Floats) -> NDArray[np.bool_]:
    """Tell at which headings the series may be used: everywhere if it has all terms, else beside covered sectors.

    Args:
        heading_deg: recorded, (m,).
    """
    if series.terms == max(SETS):
        return np.full(heading_deg.shape, True)
    centres = SECTOR_DEG * (np.flatnonzero(series.covered) + 0.5)
    away = np.abs(angles.difference(heading_deg[:, None], centres))
    return np.asarray((away <= SECTOR_DEG / 2.0 + REACH_DEG).any(axis=1))


def stretches_deg(covered: NDArray[np.bool_]) -> str:
    """Return the covered headings in words, such as ``270° to 360°``.

    Args:
        covered: sectors, (36,).
    """
    if covered.all():
        return "the full circle"
    begins = np.flatnonzero(covered & ~np.roll(covered, 1))
    ends = [next(k for k in range(b, b + SECTORS + 1) if not covered[k - SECTORS * (k >= SECTORS)]) for b in begins]
    return ", ".join(f"{10 * b}° to {10 * (e - SECTORS * (e > SECTORS))}°" for b, e in zip(begins, ends, strict=True))


def _robust(columns: Floats, difference: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Return least squares without spikes, and what is not a spike."""
    kept = np.ones(len(difference), dtype=bool)
    for _ in range(5):
        coefficients = np.linalg.lstsq(columns[kept], difference[kept], rcond=None)[0]
        residual = np.abs(difference - columns @ coefficients)
        now = residual <= CLIP_SIGMAS * max(robust.width(residual), 0.01)
        if (now == kept).all():
            break
        kept = now
    return coefficients, kept


def _structure(recorded: Floats, residual: Floats, effective: float) -> float:
    """Return the rms over sectors of the mean residual, less what noise alone would leave."""
    sector = (angles.wrap360(recorded) / SECTOR_DEG).astype(int)
    count = np.bincount(sector, minlength=SECTORS)
    there = count >= LEAST_IN_SECTOR
    mean = np.bincount(sector, residual, SECTORS)[there] / count[there]
    noise = float(np.var(residual)) * len(residual) / max(effective, 1.0) * float(np.mean(1.0 / count[there]))
    return float(np.sqrt(max(float(np.mean(mean**2)) - noise, 0.0)))


def _refused(terms: int, covered: NDArray[np.bool_], inflation: dict[int, Floats]) -> str:
    if terms == max(SETS):
        return ""
    worst = {k: float(inflation[k].max()) for k in SETS}
    times = {k: f"{w:.0f} times" if w < 1e4 else "more than 10,000 times" for k, w in worst.items()}
    where = f"the headings cover {int(covered.sum())} of {SECTORS} sectors ({stretches_deg(covered)})"
    five = f"a fit of {SETS[5]} would make a coefficient's variance {times[5]} that of the full circle"
    limit = f"{MOST_INFLATION:.0f} times is allowed"
    if terms == 3:
        return f"D and E are refused: {where}; {five}, {limit}"
    three = f"one of {SETS[3]} {times[3]}"
    return f"B, C, D and E are refused: {where}; {five} and {three}, {limit}"
