"""Two profilers on one rigid frame: compares b's recorded heading with that simulated from a's by a rigid rotation.

The frame is fitted to the downward vectors by Procrustes' method (Kabsch, Acta Cryst. A32, 922, 1976), the difference
of the headings is a series in b's heading with as many of Smith's terms as the headings determine.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import angles, compass
from compasslib.angles import SECTOR_DEG, SECTORS
from compasslib.calibrations.result import Calibration, DeviationTable, Source
from compasslib.calibrations.two_heads import motion
from compasslib.calibrations.two_heads.motion import STRETCHES, ClockDifference, PairedHeads, down
from compasslib.deviation.series import series_design
from compasslib.errors import InputError, applicable
from compasslib.readers import pd0
from compasslib.records import Record
from compasslib.statistics.least_squares import robust_width
from compasslib.statistics.noise import effective_sample_size
from compasslib.statistics.resampling import block_jackknife, blocks_by_count, student_factor
from compasslib.types import Bools, Complexes, Floats

KIND = "two_heads"
MIN_SAMPLES = 100  # simultaneous samples of both heads
MAX_CLOCK_OFFSET_S = 600.0
UNRELATED_DEG = 30.0  # rms of the difference beyond which two headings are unrelated
MIN_STRETCHES = 5  # blocks of a record, from whose scatter uncertainties follow
TERM_NAMES = {5: "A, B, C, D, E", 3: "A, B, C", 1: "A"}  # terms of the series by their number
# Largest variance inflation of a coefficient, which is 1 at full coverage. With 10, three terms need about 160 degrees
# and five about 230.
MAX_INFLATION = 10.0
MIN_IN_SECTOR = 5
# Assumed standard deviations of refused B, C, D, E, typical of the difference of two compasses without strong iron. A
# refused term is not zero: it leaks into those that are fitted.
ALLOWANCE_DEG = np.array([5.0, 5.0, 2.0, 2.0])
AMBIGUITY = (
    "The difference of two compasses does not show which of them is wrong: the coefficients are those of b relative to "
    "a, and of b alone only as far as a's compass is correct.",
    "A is 0 by definition: the headings cannot separate a constant error of either compass from the mounting angle. "
    "offset_deg includes both.",
)


def calibrate(files: Sequence[str | Path], settings: Mapping[str, Any]) -> Calibration:
    """Estimate the difference of the compasses of two profilers on one frame from the PD0 files of heads a and b."""
    a, b = read_heads(files, settings)
    warnings = (*a.warnings, *b.warnings)
    max_offset_s = float(setting(settings, "max_clock_seconds", MAX_CLOCK_OFFSET_S))
    start, end = (float(setting(settings, key, edge)) for key, edge in (("start_s", -np.inf), ("end_s", np.inf)))
    first = motion.extract_motion(a, start, end)
    second = motion.extract_motion(b, start - max_offset_s, end + max_offset_s)
    n = min(len(first.time_s), len(second.time_s))
    if n < MIN_SAMPLES or not motion.overlap_in_time(first, second, max_offset_s):
        why = f"the two heads share no time with {MIN_SAMPLES} usable samples of each ({n} usable)"
        return Calibration(KIND, "none", 0, 0, why=why, warnings=warnings)
    fixed = settings.get("clock_offset_seconds")
    if fixed is None:
        clock = motion.estimate_clock_offset(first, second, max_offset_s)
    else:
        clock = ClockDifference(float(fixed), motion.RESOLUTION_S, middle_s=second.middle_s)
    pairs = motion.pair_samples(first, second, clock)
    return calibrate_pairs(pairs, clock, warnings + clock.warnings)


def calibrate_pairs(pairs: PairedHeads, clock: ClockDifference, warnings: tuple[str, ...] = ()) -> Calibration:
    """Estimate the rotation between two heads and the difference of their headings from paired samples."""
    made = Calibration(KIND, "none", len(pairs), 0, warnings=warnings)
    if len(pairs) < MIN_SAMPLES:
        why = f"{len(pairs)} samples of both heads at the same time, at least {MIN_SAMPLES} are needed"
        return replace(made, why=why)
    if not covered_sectors(pairs.recorded_b).any():
        return replace(made, why=f"no sector of 10° of headings holds {MIN_IN_SECTOR} samples of both heads")
    # Fit the rotation as the constant of the series, iteratively, because it enters the effect of tilt too.
    frame, by_clock = fit_frame(pairs.time_s, pairs.lean_a, pairs.lean_b), clock.heading_error_deg(pairs.rate_deg_s)
    offset = float(angles.mean(angles.difference(pairs.recorded_b, pairs.recorded_a)))
    for _ in range(3):
        difference = angles.difference(simulated_heading(pairs, offset, frame), pairs.recorded_b)
        series = fit_difference(pairs.time_s, pairs.recorded_b, difference, by_clock)
        if abs(series.coefficients[0]) < 1e-4:
            break
        offset = float(angles.wrap180(offset - series.coefficients[0]))
    used, rms = series.used, angles.rms(series.residual_deg[series.used])
    made = replace(
        made,
        coverage=int(series.covered.sum()),
        points={
            "time_s": pairs.time_s,
            "recorded_a_deg": pairs.recorded_a,
            "recorded_deg": pairs.recorded_b,
            "deviation_deg": difference,
            "residual_deg": series.residual_deg,
            "kept": used.astype(float),
        },
        warnings=(*warnings, *AMBIGUITY, *_warnings(pairs, clock, frame, series)),
    )
    if rms > UNRELATED_DEG:
        why = (
            f"b's headings do not follow a's ({rms:.0f}° rms about any constant turn): these heads do not stand on one "
            "frame, or their clocks are farther apart than max_clock_seconds"
        )
        return replace(made, why=why)
    # Refused terms are NaN; A is 0 by definition.
    coefficients, covariance = np.full(5, np.nan), np.full((5, 5), np.nan)
    coefficients[: series.terms] = series.coefficients
    coefficients[0] = 0.0
    covariance[: series.terms, : series.terms] = series.covariance
    return replace(
        made,
        model=f"rigid turn, then series in b's recorded heading: {TERM_NAMES[series.terms]}",
        n=int(used.sum()),
        coefficients=coefficients if series.terms > 1 else np.zeros(0),
        covariance=covariance if series.terms > 1 else np.zeros(0),
        residual_rms_deg=rms,
        sources=_sources(pairs, clock, frame, series, rms),
        table=deviation_table(series, np.arange(0.0, 360.0, 10.0)),
        details={
            "offset_deg": offset,
            "offset_sigma_deg": float(np.sqrt(series.covariance[0, 0])),
            "clock": clock.to_json(),
            "frame": vars(frame) | {"rotation": frame.rotation.tolist()},
            **{name: getattr(series, name) for name in ("terms", "refused", "n_effective", "stretches")},
            "covered": stretches_deg(series.covered),
            "spikes": int(np.sum(~used)),
            "cannot_tell": list(AMBIGUITY),
        },
        why="" if series.terms > 1 else series.refused,
    )


def read_heads(files: Sequence[str | Path], settings: Mapping[str, Any]) -> list[Record]:
    """Read the records of head a and head b.

    Raises:
        InputError: there are not two files, or one cannot be read.
    """
    if len(files) != 2:
        expected, advice = "two files, of head a and head b", "write file: [a.000, b.000]"
        raise InputError("file", expected=expected, found=f"{len(files)}", advice=advice)
    given = {key: settings.get(key) for key in ("orientation", "declination_applied", "heading_alignment")}
    by_head = [{key: x[k] if isinstance(x, list | tuple) else x for key, x in given.items()} for k in (0, 1)]
    return [pd0.read([Path(path)], **keys) for path, keys in zip(files, by_head, strict=True)]


def setting(settings: Mapping[str, Any], key: str, default: float) -> Any:
    """Look up a key of the settings, with a default if it is absent or null."""
    value = settings.get(key)
    return default if value is None else value


def _sources(
    pairs: PairedHeads, clock: ClockDifference, frame: Frame, series: HeadingDifference, scatter_deg: float
) -> tuple[Source, ...]:
    table_sigma = deviation_table(series, pairs.recorded_b).sigma_deg
    sampling = float(np.sqrt(max(float(np.nanmean(table_sigma**2)) - series.structure_deg**2, 0.0)))
    by_clock = float(abs(np.mean(clock.heading_error_deg(pairs.rate_deg_s))))
    lever = float(np.sqrt(np.mean(np.abs(np.tan(np.abs(pairs.lean_a))) ** 2)))
    how = f"jackknife over {series.stretches} stretches, the clocks' part below included"
    if series.refused:
        how += f"; refused terms assumed {ALLOWANCE_DEG.tolist()}° (B, C, D, E)"
    return (
        Source("fit", sampling, how),
        Source("structure", series.structure_deg, "rms by sectors of 10° of what the series leaves, beyond noise"),
        Source("one reading", scatter_deg, "scatter of single differences, both compasses"),
        Source("clocks", by_clock, "standard uncertainty of the offset times the mean rate of turn"),
        Source("tilts", lever * frame.residual_rms_deg, "what is left of the tilts, times the tangent of the tilt"),
        Source("resolution", 0.01 / np.sqrt(12.0), "PD0 headings count hundredths of a degree: uniform"),
    )


def _warnings(pairs: PairedHeads, clock: ClockDifference, frame: Frame, series: HeadingDifference) -> list[str]:
    gain = f"{clock.drift_s_per_day:+.2f} ± {clock.drift_sigma_s_per_day:.2f} s a day"
    where, spikes = stretches_deg(series.covered), int(np.sum(~series.used))
    return applicable(
        {
            series.refused: series.refused,
            "a refused term is not zero: its possible leakage into the fitted terms and into offset_deg is included in "
            "their uncertainty, with assumed standard deviations of 5° (B, C) and 2° (D, E)": series.refused,
            f"offset_deg is the mean difference over {where}; elsewhere the difference may differ": series.terms == 1,
            frame.text: frame.verdict != "rigid",
            f"b's clock gains {gain} on a's; this is corrected": clock.drift_applied,
            f"the differences are autocorrelated: effective sample size {series.n_effective:.0f} of {len(pairs)}; the "
            f"uncertainty rests on {series.stretches} blocks": series.stretches == MIN_STRETCHES,
            f"{spikes} of {len(pairs)} differences are spikes and excluded": spikes > 0,
            "the heads sample too rarely to resolve a clock error of seconds": motion.step(pairs.time_s) > 600.0,
        }
    )


@dataclass(frozen=True)
class Frame:
    """Mounting of b relative to a."""

    rotation: Floats  # (3, 3) from a's body to b's
    residual_rms_deg: float  # of the angle between the downward vectors of b and of a after the rotation
    verdict: str  # rigid | doubtful | not rigid | not testable
    text: str


def fit_frame(time_s: Floats, lean_a: Complexes, lean_b: Complexes) -> Frame:
    """Fit the constant rotation that best maps a's tilts to b's, and test whether both are on one rigid frame."""
    left, _, right = np.linalg.svd(down(lean_b).T @ down(lean_a))
    rotation = np.asarray(left * [1.0, 1.0, np.sign(np.linalg.det(left @ right))] @ right)
    chord = np.linalg.norm(down(lean_a) @ rotation.T - down(lean_b), axis=1)
    residual = 2.0 * np.arcsin(np.minimum(chord / 2.0, 1.0)) / angles.DEGREE
    a, b = lean_a - lean_a.mean(), lean_b - lean_b.mean()
    scale = max(float(np.sqrt(np.sum(np.abs(a) ** 2) * np.sum(np.abs(b) ** 2))), 1e-300)
    correlation = float(abs(np.sum(np.conj(a) * b))) / scale  # up to a rotation
    variation, rms = float(np.sqrt(np.mean(np.abs(a) ** 2))) / angles.DEGREE, angles.rms(residual)
    stretch = blocks_by_count(time_s, STRETCHES)
    worst = max(angles.rms(residual[stretch == k]) for k in np.unique(stretch))
    mapped = (
        f"One rotation maps a's tilts to b's; residual {rms:.2f}° of {variation:.2f}° rms (worst block {worst:.2f}°)"
    )
    if variation < 0.3:
        verdict = "not testable"
        text = f"The tilts vary by {variation:.2f}° rms only, too little to test whether the frame is rigid."
    elif correlation < 0.5 or rms > 1.5:
        verdict = "not rigid"
        text = (
            f"The tilts of b are not those of a by one rotation (residual {rms:.2f}° of {variation:.2f}° rms, "
            f"correlation {correlation:.2f}): the heads are not on one rigid frame, a tilt sensor is broken, or the "
            "orientation (up or down) of one head is wrong."
        )
    elif rms <= 0.5 and worst <= 1.5:
        verdict, text = "rigid", f"{mapped}: the frame is rigid within the accuracy of inclinometers."
    else:
        verdict, text = "doubtful", f"{mapped}: larger than the difference of two good inclinometers."
    return Frame(rotation, rms, verdict, text)


def simulated_heading(pairs: PairedHeads, offset_deg: float, frame: Frame) -> Floats:
    """Simulate b's heading, (n,) degrees, from a's by a rigid rotation with b's forward axis clockwise by an offset."""
    if frame.verdict == "not rigid":
        return angles.wrap360(pairs.recorded_a + offset_deg)
    rotation = upright(offset_deg, pairs.lean_a, pairs.lean_b)
    return turned_heading(pairs.recorded_a, pairs.lean_a, rotation)


def upright(offset_deg: float, lean_a: Complexes, lean_b: Complexes) -> Floats:
    """Build the rotation (3, 3) from a's body to b's with a given angle about the vertical and the least tilt."""
    turn, down_a, down_b = offset_deg, down(lean_a).mean(axis=0), down(lean_b).mean(axis=0)
    for _ in range(3):  # removes the second-order rotation of the forward axis by a lean
        sine, cosine = (float(x) for x in angles.sin_cos(turn))
        turned = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        vertical_a, vertical_b = (x / np.linalg.norm(x) for x in (turned @ down_a, down_b))
        x, y, z = np.cross(vertical_a, vertical_b)
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        least = np.eye(3) + cross + cross @ cross / (1.0 + vertical_a @ vertical_b)  # Rodrigues
        rotation = np.asarray(least) @ turned
        reached = angles.wrap180(angles.direction(rotation[0, 1], rotation[0, 0]))
        turn += float(angles.difference(offset_deg, reached))
    return rotation


def turned_heading(heading_a_deg: Floats, lean_a: Complexes, rotation: Floats) -> Floats:
    """Compute b's heading, (n,), from a's heading and tilts: b's forward axis levelled, and referred to north by a."""
    level = compass.levelling(*motion.tilt_angles(lean_a)) @ rotation[0]
    return angles.wrap360(heading_a_deg + angles.direction(level[:, 1], level[:, 0]))


@dataclass(frozen=True)
class HeadingDifference:
    """Fitted difference, to be added to b's recorded heading to obtain the heading simulated from a's."""

    terms: int  # 5, 3 or 1
    coefficients: Floats  # (terms,) degrees
    covariance: Floats  # (terms, terms), including leakage of refused terms
    sampling: Floats  # (terms, terms), excluding leakage
    leak: Floats  # (terms, 5 - terms) leakage of each refused term into the fitted ones
    residual_deg: Floats  # (n,) of all differences
    used: Bools  # (n,) False for spikes
    structure_deg: float  # rms of the mean residuals by sector, in excess of noise
    n_effective: float
    stretches: int
    covered: Bools  # (36,) sectors of b's recorded heading
    refused: str  # which terms were refused and why; empty if none


def fit_difference(
    time_s: Floats,
    recorded_deg: Floats,
    difference_deg: Floats,
    rate_sigma_deg: Floats,  # change of each difference by one standard deviation of the clock offset, (n,)
) -> HeadingDifference:
    """Fit the largest series that the covered headings determine, without spikes, with its covariance."""
    covered = covered_sectors(recorded_deg)
    inflation = {k: variance_inflation(covered, k) for k in TERM_NAMES}
    terms = next((k for k in TERM_NAMES if inflation[k] <= MAX_INFLATION), 1)
    columns, others = np.split(series_design(recorded_deg), [terms], axis=1)
    used = np.ones(len(difference_deg), dtype=bool)
    for _ in range(5):
        coefficients = np.linalg.lstsq(columns[used], difference_deg[used], rcond=None)[0]
        residual = difference_deg - columns @ coefficients
        now = np.abs(residual) <= 5.0 * max(robust_width(residual), 0.01)
        if (now == used).all():
            break
        used = now
    effective = effective_sample_size(residual[used], time_s[used])
    # Neighbouring blocks are correlated across their border: blocks of m independent samples show 1 - 1/(2m) of the
    # variance of long ones (first-order autoregression). Few blocks require Student's t instead of a normal
    # distribution.
    count = int(np.clip(effective / 40.0, MIN_STRETCHES, 16))
    widened = student_factor(count - 1) ** 2 / (1.0 - 0.5 / max(effective / count, 1.0))
    rows, pulls = columns[used], columns[used] * residual[used][:, None]
    covariance = block_jackknife(rows, pulls, blocks_by_count(time_s, count)[used], rows.T @ rows) * widened
    solver = np.linalg.pinv(columns[used])
    by_clock, leak = solver @ rate_sigma_deg[used], solver @ others[used]
    sampling = covariance + np.outer(by_clock, by_clock)
    # Structure: rms over sectors of the mean residual, minus the contribution of noise.
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
        refused="" if terms == max(TERM_NAMES) else _describe_refusal(terms, covered, inflation),
    )


def covered_sectors(recorded_deg: Floats) -> Bools:
    """Flag the sectors of 10 degrees that contain enough samples, (36,)."""
    count = np.bincount((angles.wrap360(recorded_deg) / SECTOR_DEG).astype(int), minlength=SECTORS)[:SECTORS]
    return np.asarray(count >= max(MIN_IN_SECTOR, 0.001 * len(recorded_deg)))


def variance_inflation(covered: Bools, terms: int) -> float:
    """Compute the largest variance inflation of a coefficient relative to a fit of it alone."""
    if covered.sum() < terms:
        return float("inf")
    columns = series_design(SECTOR_DEG * (np.flatnonzero(covered) + 0.5))[:, :terms]
    information = columns.T @ columns
    return float(np.max(np.diag(information) * np.diag(np.linalg.pinv(information, rcond=1e-12))))


def _describe_refusal(terms: int, covered: Bools, inflation: dict[int, float]) -> str:
    times = {k: f"{w:.0f} times" if w < 1e4 else "more than 10,000 times" for k, w in inflation.items()}
    where = f"the headings cover {int(covered.sum())} of {SECTORS} sectors ({stretches_deg(covered)})"
    five = f"a fit of {TERM_NAMES[5]} would make a coefficient's variance {times[5]} that of the full circle"
    limit = f"{MAX_INFLATION:.0f} times is allowed"
    if terms == 3:
        return f"D and E are refused: {where}; {five}, {limit}"
    return f"B, C, D and E are refused: {where}; {five} and one of {TERM_NAMES[3]} {times[3]}, {limit}"


def deviation_table(series: HeadingDifference, heading_deg: Floats) -> DeviationTable:
    """Tabulate the deviation without constant at recorded headings; NaN far from covered ones if terms are refused."""
    columns, others = np.split(series_design(heading_deg), [series.terms], axis=1)
    # At covered headings the fitted terms have absorbed the refused ones; elsewhere, these add an error of their own.
    unseen = (others - columns @ series.leak) * ALLOWANCE_DEG[series.terms - 1 :]
    # Residual structure is caused by the refused terms: take the larger of the two, not their sum.
    left = np.maximum(np.sum(unseen**2, axis=1), series.structure_deg**2)
    sigma = np.sqrt(np.einsum("ni,ij,nj->n", columns, series.sampling, columns) + left)
    deviation = columns[:, 1:] @ series.coefficients[1:]
    if series.terms == max(TERM_NAMES):
        return DeviationTable(heading_deg, deviation, sigma)
    centres = SECTOR_DEG * (np.flatnonzero(series.covered) + 0.5)
    away = np.abs(angles.difference(heading_deg[:, None], centres))
    known = (away <= 1.5 * SECTOR_DEG).any(axis=1)  # one sector beyond the covered ones
    return DeviationTable(heading_deg, np.where(known, deviation, np.nan), np.where(known, sigma, np.nan))


def stretches_deg(covered: Bools) -> str:
    """Describe the covered headings in words, such as ``270° to 360°``."""
    if covered.all():
        return "the full circle"
    begins = np.flatnonzero(covered & ~np.roll(covered, 1))
    ends = np.flatnonzero(covered & ~np.roll(covered, -1)) + 1
    if covered[0] and covered[-1]:  # the first end is that of the last stretch
        ends = np.roll(ends, -1)
    return ", ".join(f"{10 * b}° to {10 * e}°" for b, e in zip(begins, ends, strict=True))
