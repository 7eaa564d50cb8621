"""The frame of two heads by their tilts alone, and the difference of their headings as a series.

What points down, seen in b's body, is a constant rotation of what points down in a's: v_b = R v_a. The rotation is
found by Procrustes' method (Kabsch, Acta Cryst. A32, 922, 1976), with noise in both heads alike. Its turn about the
vertical is the mounting angle, with no compass in it. Both orientations use the same body axes forward, starboard,
down (physics page, section 8), so that a head which looks up fits like any other; a mirrored fit betrays a roll that
was counted the other way. A lean is what points down in a head's body, forward + i starboard (``motion.lean``).

The difference of the headings is a series in b's recorded heading with as many terms as the headings carry: Smith's
(von Appen 2015, eq. 1; Moncunill Marimón et al. 2023, eq. 1), constant, semicircular, quadrantal. Its covariance is a
jackknife over stretches of the record, because the errors of a cast follow each other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compasslib import angles, compass
from compasslib.calibrations.result import DeviationTable
from compasslib.calibrations.two_heads.motion import down, independent, tilt_angles
from compasslib.deviation.series import series_design
from compasslib.statistics.least_squares import robust_width
from compasslib.statistics.noise import effective_sample_size
from compasslib.statistics.resampling import block_jackknife, blocks_by_count
from compasslib.types import Bools, Complexes, Floats

STRETCHES = 30  # in which the residual is looked at
RIGID_DEG = 0.5  # rms of the difference of two inclinometers by their makers' word
MAX_RMS_DEG = 1.5  # no two inclinometers of one frame differ so much
MIN_VARIATION_DEG = 0.3  # tilts that vary less than this tell nothing of a rotation
ITERATIONS = 3  # a lean turns the forward axis in the second order, taken back by iteration
MIN_CORRELATION = 0.5  # correlation of the tilts below which b does not follow a
TERM_NAMES = {5: "A, B, C, D, E", 3: "A, B, C", 1: "A"}  # terms of the series by their number
# A coefficient's variance over what full coverage would give it. With 10, three terms need about 160 degrees and five
# about 230.
MAX_INFLATION = 10.0
SECTOR_DEG, SECTORS = 10.0, 36
MIN_IN_SECTOR = 5
CLIP_SIGMAS = 5.0  # beyond which a difference is a spike
# Assumed standard deviations of B, C, D, E where they are refused: what a difference of two compasses without strong
# iron may hold. A refused term is not zero: it leaks into those that are fitted.
ALLOWANCE_DEG = np.array([5.0, 5.0, 2.0, 2.0])
REACH_DEG = 10.0  # a table of fewer than five terms goes this far beyond the headings that were covered


@dataclass(frozen=True)
class Frame:
    """How b is mounted against a."""

    rotation: Floats  # (3, 3) from a's body to b's
    residual_deg: Floats  # (n,) angle between what points down by b and by a, turned
    offset_deg: float  # of b's forward axis clockwise from a's, by the tilts
    offset_sigma_deg: float  # NaN where the tilts do not tell
    rms_deg: float
    variation_deg: float  # rms of a's tilt about its mean
    correlation: float  # of the tilts, mirrored or not
    mirrored: bool
    verdict: str  # rigid | doubtful | not rigid | mirrored | not testable
    text: str


def fit_frame(time_s: Floats, lean_a: Complexes, lean_b: Complexes) -> Frame:
    """Fit the constant rotation that best takes a's tilts to b's."""
    rotation = _rotation(down(lean_b).T @ down(lean_a))
    chord = np.linalg.norm(down(lean_a) @ rotation.T - down(lean_b), axis=1)
    residual = 2.0 * np.arcsin(np.minimum(chord / 2.0, 1.0)) / angles.DEGREE
    offset, sigma = twist(rotation), _twist_sigma(time_s, lean_a, lean_b, rotation)
    proper, mirrored, variation = _correlations(lean_a, lean_b)
    rms = float(np.sqrt(np.mean(residual**2)))
    verdict, text = _verdict(rms, variation, proper, mirrored, residual, blocks_by_count(time_s, STRETCHES))
    determined = variation >= MIN_VARIATION_DEG and verdict in ("rigid", "doubtful")
    return Frame(
        rotation=rotation,
        residual_deg=residual,
        offset_deg=offset,
        offset_sigma_deg=sigma if determined else float("nan"),
        rms_deg=rms,
        variation_deg=variation,
        correlation=max(proper, mirrored),
        mirrored=verdict == "mirrored",
        verdict=verdict,
        text=text,
    )


def twist(rotation: Floats) -> float:
    """Compute the turn of b's forward axis clockwise of a's on an upright frame, degrees, from the rotation (3, 3)."""
    return float(angles.wrap180(angles.direction(rotation[0, 1], rotation[0, 0])))


def upright(offset_deg: float, lean_a: Complexes, lean_b: Complexes) -> Floats:
    """Build the rotation from a's body to b's with a given turn about the vertical, the least lean added, (3, 3)."""
    turn, down_a, down_b = offset_deg, down(lean_a).mean(axis=0), down(lean_b).mean(axis=0)
    for _ in range(ITERATIONS):
        sine, cosine = (float(x) for x in angles.sin_cos(turn))
        turned = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        vertical_a, vertical_b = (x / np.linalg.norm(x) for x in (turned @ down_a, down_b))
        x, y, z = np.cross(vertical_a, vertical_b)
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        least = np.eye(3) + cross + cross @ cross / (1.0 + vertical_a @ vertical_b)  # Rodrigues
        rotation = np.asarray(least) @ turned
        turn += float(angles.difference(offset_deg, twist(rotation)))
    return rotation


def turned_heading(heading_a_deg: Floats, lean_a: Complexes, rotation: Floats) -> Floats:
    """Compute b's heading from a's heading and tilts and the rotation between them, (n,) in [0, 360).

    The forward axis of b, seen in a's body, is turned level by a's tilts and north by a's heading. Under tilt this
    differs from a constant offset in the second order: up to half a degree at ten.
    """
    level = compass.levelling(*tilt_angles(lean_a)) @ rotation[0]
    return angles.wrap360(heading_a_deg + angles.direction(level[:, 1], level[:, 0]))


def _twist_sigma(time_s: Floats, lean_a: Complexes, lean_b: Complexes, rotation: Floats) -> float:
    """Estimate the standard deviation of the turn about the vertical by a jackknife over stretches of the record."""
    a, b = down(lean_a), down(lean_b)
    back = (b @ rotation)[:, :2] @ np.array([1.0, 1.0j])
    aside = np.imag(np.conj(lean_a - lean_a.mean()) * (back - lean_a))
    count, widened = independent(effective_sample_size(aside - aside.mean(), time_s))
    stretch = blocks_by_count(time_s, count)
    parts = [b[stretch == k].T @ a[stretch == k] for k in np.unique(stretch)]
    whole = np.sum(parts, axis=0)
    away = angles.difference([twist(_rotation(whole - part)) for part in parts], twist(rotation))
    return float(np.sqrt(np.sum((away - away.mean()) ** 2) * (len(parts) - 1) / len(parts) * widened))


def _rotation(moment: Floats) -> Floats:
    left, _, right = np.linalg.svd(moment)
    sign = np.sign(np.linalg.det(left @ right))
    return np.asarray(left * [1.0, 1.0, sign] @ right)


def _correlations(lean_a: Complexes, lean_b: Complexes) -> tuple[float, float, float]:
    """Correlate b's tilts with a's turned, and with a's mirrored; and compute the variation of a's, degrees rms."""
    a, b = lean_a - lean_a.mean(), lean_b - lean_b.mean()
    scale = max(float(np.sqrt(np.sum(np.abs(a) ** 2) * np.sum(np.abs(b) ** 2))), 1e-300)
    variation = float(np.sqrt(np.mean(np.abs(a) ** 2))) / angles.DEGREE
    return float(abs(np.sum(np.conj(a) * b))) / scale, float(abs(np.sum(a * b))) / scale, variation


def _verdict(
    rms: float, variation: float, proper: float, mirrored: float, residual: Floats, stretch: NDArray[np.intp]
) -> tuple[str, str]:
    if variation < MIN_VARIATION_DEG:
        shown = f"The tilts vary by {variation:.2f}° rms only"
        return "not testable", f"{shown}, too little to test whether the frame is rigid."
    if mirrored >= MIN_CORRELATION and mirrored > proper + 0.2:
        return "mirrored", (
            "The tilts of b are those of a mirrored: one head counts its roll the other way, or its orientation (up or "
            "down) is wrong. No mounting angle is derived from them."
        )
    if proper < MIN_CORRELATION or rms > MAX_RMS_DEG:
        return "not rigid", (
            f"The tilts of b are not those of a by one rotation (residual {rms:.2f}° of {variation:.2f}° rms, "
            f"correlation {proper:.2f}): the heads are not on one rigid frame, or a tilt sensor is broken."
        )
    worst = max(float(np.sqrt(np.mean(residual[stretch == k] ** 2))) for k in np.unique(stretch))
    left = f"residual {rms:.2f}° of {variation:.2f}° rms (worst block {worst:.2f}°)"
    rotation = f"One rotation maps a's tilts to b's; {left}"
    if rms <= RIGID_DEG and worst <= MAX_RMS_DEG:
        return "rigid", rotation + ": the frame is rigid within the accuracy of inclinometers."
    return "doubtful", rotation + ": larger than the difference of two good inclinometers."


@dataclass(frozen=True)
class HeadingDifference:
    """A fitted difference: what is to be added to b's recorded heading to get a's, turned."""

    terms: int  # 5, 3 or 1
    coefficients: Floats  # (terms,) degrees
    covariance: Floats  # (terms, terms), what refused terms may leak included
    sampling: Floats  # (terms, terms), without that
    leak: Floats  # (terms, 5 - terms) of each refused term into the fitted ones
    residual_deg: Floats  # (n,) of all differences
    used: Bools  # (n,) not spikes
    structure_deg: float  # rms by sector of what the series leaves, beyond noise
    n_effective: float
    stretches: int
    covered: Bools  # (36,) sectors of b's recorded heading
    inflation: dict[int, Floats]  # terms -> variance of each over what the full circle would give
    refused: str  # which terms were refused and why; empty where none


def fit_difference(
    time_s: Floats, recorded_deg: Floats, difference_deg: Floats, rate_sigma_deg: Floats
) -> HeadingDifference:
    """Fit the largest series that the covered headings determine, with its covariance.

    Args:
        difference_deg: a's heading, turned, minus b's, in [-180, 180) about a small mean, (n,).
        rate_sigma_deg: what one standard deviation of the clocks does to each difference, (n,).
    """
    covered = covered_sectors(recorded_deg)
    inflation = {k: variance_inflation(covered, k) for k in TERM_NAMES}
    terms = next((k for k in TERM_NAMES if inflation[k].max() <= MAX_INFLATION), 1)
    columns, others = np.split(series_design(recorded_deg), [terms], axis=1)
    coefficients, used = _fit_without_spikes(columns, difference_deg)
    residual = difference_deg - columns @ coefficients
    effective = effective_sample_size(residual[used], time_s[used])
    count, widened = independent(effective)
    rows, pulls = columns[used], columns[used] * residual[used][:, None]
    covariance = block_jackknife(rows, pulls, blocks_by_count(time_s, count)[used], rows.T @ rows) * widened
    solver = np.linalg.pinv(columns[used])
    by_clock, leak = solver @ rate_sigma_deg[used], solver @ others[used]
    sampling = covariance + np.outer(by_clock, by_clock)
    # Structure: the rms over sectors of the mean residual, less what noise alone would leave.
    sector, left = (angles.wrap360(recorded_deg[used]) / SECTOR_DEG).astype(int), residual[used]
    in_sector = np.bincount(sector, minlength=SECTORS)
    there = in_sector >= MIN_IN_SECTOR
    mean = np.bincount(sector, left, SECTORS)[there] / in_sector[there]
    noise = float(np.var(left)) * len(left) / max(effective, 1.0) * float(np.mean(1.0 / in_sector[there]))
    return HeadingDifference(
        terms=terms,
        coefficients=coefficients,
        covariance=sampling + leak @ np.diag(ALLOWANCE_DEG[terms - 1 :] ** 2) @ leak.T,
        sampling=sampling,
        leak=leak,
        residual_deg=residual,
        used=used,
        structure_deg=float(np.sqrt(max(float(np.mean(mean**2)) - noise, 0.0))),
        n_effective=effective,
        stretches=count,
        covered=covered,
        inflation=inflation,
        refused=_describe_refusal(terms, covered, inflation),
    )


def covered_sectors(recorded_deg: Floats) -> Bools:
    """Flag the sectors of 10 degrees that hold enough samples, (36,)."""
    count = np.bincount((angles.wrap360(recorded_deg) / SECTOR_DEG).astype(int), minlength=SECTORS)[:SECTORS]
    return np.asarray(count >= max(MIN_IN_SECTOR, 0.001 * len(recorded_deg)))


def variance_inflation(covered: Bools, terms: int) -> Floats:
    """Compute the variance of each coefficient over what it would have alone, from the information matrix.

    Each covered sector counts alike: that a frame lingered at one heading does not help.
    """
    if covered.sum() < terms:
        return np.full(terms, np.inf)
    columns = series_design(SECTOR_DEG * (np.flatnonzero(covered) + 0.5))[:, :terms]
    information = columns.T @ columns
    return np.asarray(np.diag(information) * np.diag(np.linalg.pinv(information, rcond=1e-12)))


def deviation_table(series: HeadingDifference) -> DeviationTable:
    """Tabulate the deviation every 10 degrees without its constant; NaN far from what a short series covered."""
    return difference_curve(series, np.arange(0.0, 360.0, 10.0))


def difference_curve(series: HeadingDifference, heading_deg: Floats) -> DeviationTable:
    """Evaluate the deviation and its sigma at recorded headings, (m,), as ``deviation_table`` does."""
    columns, others = np.split(series_design(heading_deg), [series.terms], axis=1)
    # Where headings were covered the fitted terms have taken up the refused ones; beyond, these go their own way.
    unseen = (others - columns @ series.leak) * ALLOWANCE_DEG[series.terms - 1 :]
    # What the series leaves by sectors is the refused terms' own trace: the larger of the two, not both.
    left = np.maximum(np.sum(unseen**2, axis=1), series.structure_deg**2)
    sigma = np.sqrt(np.einsum("ni,ij,nj->n", columns, series.sampling, columns) + left)
    deviation = columns[:, 1:] @ series.coefficients[1:]
    known: Bools = np.full(heading_deg.shape, True)  # if it has all terms, else near sectors that were covered
    if series.terms != max(TERM_NAMES):
        centres = SECTOR_DEG * (np.flatnonzero(series.covered) + 0.5)
        away = np.abs(angles.difference(heading_deg[:, None], centres))
        known = np.asarray((away <= SECTOR_DEG / 2.0 + REACH_DEG).any(axis=1))
    return DeviationTable(heading_deg, np.where(known, deviation, np.nan), np.where(known, sigma, np.nan))


def stretches_deg(covered: Bools) -> str:
    """Describe the covered headings in words, such as ``270° to 360°``."""
    if covered.all():
        return "the full circle"
    begins = np.flatnonzero(covered & ~np.roll(covered, 1))
    ends = [next(k for k in range(b, b + SECTORS + 1) if not covered[k - SECTORS * (k >= SECTORS)]) for b in begins]
    return ", ".join(f"{10 * b}° to {10 * (e - SECTORS * (e > SECTORS))}°" for b, e in zip(begins, ends, strict=True))


def _fit_without_spikes(columns: Floats, difference: Floats) -> tuple[Floats, Bools]:
    """Fit least squares without spikes; return the coefficients and which are no spikes."""
    used = np.ones(len(difference), dtype=bool)
    for _ in range(5):
        coefficients = np.linalg.lstsq(columns[used], difference[used], rcond=None)[0]
        residual = np.abs(difference - columns @ coefficients)
        now = residual <= CLIP_SIGMAS * max(robust_width(residual), 0.01)
        if (now == used).all():
            break
        used = now
    return coefficients, used


def _describe_refusal(terms: int, covered: Bools, inflation: dict[int, Floats]) -> str:
    if terms == max(TERM_NAMES):
        return ""
    worst = {k: float(inflation[k].max()) for k in TERM_NAMES}
    times = {k: f"{w:.0f} times" if w < 1e4 else "more than 10,000 times" for k, w in worst.items()}
    where = f"the headings cover {int(covered.sum())} of {SECTORS} sectors ({stretches_deg(covered)})"
    five = f"a fit of {TERM_NAMES[5]} would make a coefficient's variance {times[5]} that of the full circle"
    limit = f"{MAX_INFLATION:.0f} times is allowed"
    if terms == 3:
        return f"D and E are refused: {where}; {five}, {limit}"
    three = f"one of {TERM_NAMES[3]} {times[3]}"
    return f"B, C, D and E are refused: {where}; {five} and {three}, {limit}"
