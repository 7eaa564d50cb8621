"""Two profilers on one rigid frame: the simulation is b's heading from a's, rigidly turned.

The clocks come first, then the frame (by tilts), then the headings. The difference of two compasses does not tell
which of them is wrong; its constant cannot be told from the mounting angle but by the tilts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.calibration import heads_clock, heads_frame, heads_series
from compasslib.calibration.heads_clock import Clock
from compasslib.calibration.heads_frame import Frame
from compasslib.calibration.heads_motion import Motion, motion, step, tilts
from compasslib.calibration.heads_series import Series
from compasslib.calibration.result import Calibration, Source
from compasslib.errors import InputError
from compasslib.readers import pd0
from compasslib.records import Record

Floats = NDArray[np.floating]

KIND = "two_heads"
FEWEST = 100  # samples of both heads at the same time
FARTHEST_CLOCK_S = 600.0
UNRELATED_DEG = 30.0  # rms of the difference beyond which two headings have nothing to do with each other
PAIR = 2
SIGMAS = 2.0
CANNOT_TELL = (
    "The difference of two compasses does not tell which of them is wrong: the coefficients are b's against a's and "
    "are b's own only as far as a's compass is right.",
    "A is 0 by definition: a constant error of either compass and the mounting angle look the same in the headings. "
    "offset_deg holds both.",
)


@dataclass(frozen=True)
class _Compared:
    """Both heads at b's instants, (n,) each."""

    time_s: Floats  # by b's clock
    recorded_a: Floats
    recorded_b: Floats
    lean_a: NDArray[np.complexfloating]
    lean_b: NDArray[np.complexfloating]
    rate_deg_s: Floats  # how fast a turns

    def __len__(self) -> int:
        return len(self.time_s)


def calibrate(files: Sequence[str | Path], settings: Mapping[str, Any]) -> Calibration:
    """Return the difference of the compasses of two profilers on one frame.

    Args:
        files: PD0 files of head a and of head b.
        settings: keys of the calibration's YAML: start_s, end_s (window by a's clock), orientation,
            declination_applied, heading_alignment (of a and b), max_clock_seconds, clock_offset_seconds (None: found).

    Raises:
        InputError: not two files, or one that cannot be read.
    """
    if len(files) != PAIR:
        raise InputError(
            "file", expected="two files, of head a and head b", found=f"{len(files)}", advice="write file: [a.000, b.000]"
        )
    records = [_record(path, settings, k) for k, path in enumerate(files)]
    return compare(*records, settings)


def compare(a: Record, b: Record, settings: Mapping[str, Any]) -> Calibration:
    """Return the difference of the compasses of two heads.

    Args:
        a: record of one head, by its own clock.
        b: record of the other.
        settings: as for ``calibrate``.
    """
    farthest = float(_given(settings, "max_clock_seconds", FARTHEST_CLOCK_S))
    start, end = settings.get("start_s"), settings.get("end_s")
    first = motion(a, start, end)
    second = motion(b, None if start is None else start - farthest, None if end is None else end + farthest)
    said = a.warnings + b.warnings
    if min(len(first.time_s), len(second.time_s)) < FEWEST or not _overlap(first, second, farthest):
        n = min(len(first.time_s), len(second.time_s))
        return _nothing(0, f"the two heads share no time with {FEWEST} usable samples of each ({n} usable)", said)
    fixed = settings.get("clock_offset_seconds")
    clock = heads_clock.find(first, second, farthest) if fixed is None else _told_clock(second, float(fixed))
    compared = _together(first, second, clock)
    if len(compared) < FEWEST:
        why = f"{len(compared)} samples of both heads at the same time, at least {FEWEST} are needed"
        return _nothing(len(compared), why, said + clock.warnings)
    return _assembled(compared, clock, said)


def _record(path: str | Path, settings: Mapping[str, Any], which: int) -> Record:
    def of(key: str) -> Any:
        value = settings.get(key)
        return value[which] if isinstance(value, list | tuple) else value

    return pd0.read(
        [Path(path)],
        orientation=of("orientation"),
        declination_applied=of("declination_applied"),
        heading_alignment=of("heading_alignment"),
    )


def _given(settings: Mapping[str, Any], key: str, default: float) -> Any:
    value = settings.get(key)
    return default if value is None else value


def _overlap(a: Motion, b: Motion, farthest: float) -> bool:
    return bool(max(a.time_s[0], b.time_s[0] - farthest) < min(a.time_s[-1], b.time_s[-1] + farthest))


def _told_clock(b: Motion, offset_s: float) -> Clock:
    middle = float(b.time_s[0] + b.time_s[-1]) / 2.0
    return Clock(offset_s=offset_s, sigma_s=heads_clock.RESOLUTION_S, middle_s=middle)


def _together(a: Motion, b: Motion, clock: Clock) -> _Compared:
    at = clock.by_a(b.time_s)
    heading, lean, rate = a.heading.at(at), a.leaning.at(at), a.heading.at(at, 1)
    known = np.isfinite(heading) & np.isfinite(lean)
    recorded = angles.wrap360(heading[known])
    return _Compared(b.time_s[known], recorded, b.recorded_deg[known], lean[known], b.lean[known], rate[known])


def _assembled(pairs: _Compared, clock: Clock, said: tuple[str, ...]) -> Calibration:
    frame = heads_frame.fit(pairs.time_s, pairs.lean_a, pairs.lean_b)
    offset, difference, series = _fitted(pairs, clock, frame)
    rms = angles.rms(series.residual_deg[series.kept])
    warnings = said + clock.warnings + _warnings(pairs, clock, frame, series, offset)
    details = _details(pairs, clock, frame, series, offset)
    points = _points(pairs, difference, offset, frame, series)
    coverage = int(series.covered.sum())
    if rms > UNRELATED_DEG:
        why = f"b's headings do not follow a's ({rms:.0f}° rms about any constant turn): these heads do not stand on one frame"
        return replace(_nothing(len(pairs), why, warnings), coverage=coverage, points=points, details=details)
    full = _full(series)
    return Calibration(
        kind=KIND,
        model=f"rigid turn, then series in b's recorded heading: {heads_series.SETS[series.terms]}",
        n=int(series.kept.sum()),
        coverage=coverage,
        coefficients=full[0] if series.terms > 1 else np.zeros(0),
        covariance=full[1] if series.terms > 1 else np.zeros(0),
        residual_rms_deg=rms,
        sources=_sources(pairs, clock, frame, series),
        table=heads_series.table(series),
        points=points,
        details=details,
        why="" if series.terms > 1 else series.refused,
        warnings=warnings,
    )


def _fitted(pairs: _Compared, clock: Clock, frame: Frame) -> tuple[float, Floats, Series]:
    """Return the offset, what b must add to agree with a turned by it, and the series through that.

    The offset is the series' constant; twice, because the turn enters the effect of tilt too.
    """
    offset = float(angles.mean(angles.difference(pairs.recorded_b, pairs.recorded_a)))
    sigma = heads_clock.heading_error_deg(clock, pairs.rate_deg_s)
    for _ in range(3):
        difference = angles.difference(_turned(pairs, offset, frame), pairs.recorded_b)
        series = heads_series.fit(pairs.time_s, pairs.recorded_b, difference, sigma)
        if abs(series.coefficients[0]) < 1e-4:
            break
        offset = float(angles.wrap180(offset - series.coefficients[0]))
    return offset, difference, series


def _turned(pairs: _Compared, offset_deg: float, frame: Frame) -> Floats:
    if frame.verdict in ("mirrored", "not rigid"):
        return angles.wrap360(pairs.recorded_a + offset_deg)
    rotation = heads_frame.upright(offset_deg, pairs.lean_a, pairs.lean_b)
    return heads_frame.turned_heading(pairs.recorded_a, pairs.lean_a, rotation)


def _full(series: Series) -> tuple[Floats, Floats]:
    """Return five coefficients and their covariance, NaN where a term was refused; A is 0, its variance the offset's."""
    coefficients, covariance = np.full(5, np.nan), np.full((5, 5), np.nan)
    coefficients[: series.terms] = series.coefficients
    coefficients[0] = 0.0
    covariance[: series.terms, : series.terms] = series.covariance
    return coefficients, covariance


def _details(pairs: _Compared, clock: Clock, frame: Frame, series: Series, offset: float) -> dict[str, Any]:
    constant = float(angles.difference(frame.offset_deg, offset))
    sigma = float(np.sqrt(series.covariance[0, 0]))
    told = bool(np.isfinite(frame.offset_sigma_deg))
    return {
        "offset_deg": offset,
        "offset_sigma_deg": sigma,
        "offset_from_tilts_deg": frame.offset_deg if told else None,
        "offset_from_tilts_sigma_deg": frame.offset_sigma_deg if told else None,
        "constant_difference_deg": constant if told else None,
        "constant_difference_sigma_deg": float(np.hypot(sigma, frame.offset_sigma_deg)) if told else None,
        "clock": {
            "offset_s": clock.offset_s,
            "sigma_s": clock.sigma_s,
            "drift_s_per_day": clock.drift_s_per_day,
            "drift_sigma_s_per_day": clock.drift_sigma_s_per_day,
            "drift_applied": clock.drift_applied,
            "found": clock.found,
            "from_tilts_s": list(clock.from_tilts_s),
            "from_headings_s": list(clock.from_headings_s),
            "correlation_of_tilt_rates": clock.tilt_correlation,
            "correlation_of_heading_rates": clock.heading_correlation,
        },
        "frame": {
            "verdict": frame.verdict,
            "text": frame.text,
            "residual_rms_deg": frame.rms_deg,
            "tilt_variation_deg": frame.variation_deg,
            "rotation": frame.rotation.tolist(),
        },
        "terms": series.terms,
        "refused": series.refused,
        "variance_inflation": {str(k): v.tolist() for k, v in series.inflation.items()},
        "covered": heads_series.stretches_deg(series.covered),
        "turns": float(np.ptp(np.cumsum(angles.difference(pairs.recorded_a[1:], pairs.recorded_a[:-1]))) / 360.0),
        "n_effective": series.n_effective,
        "stretches": series.stretches,
        "spikes": int(np.sum(~series.kept)),
        "cannot_tell": list(CANNOT_TELL),
    }


def _points(pairs: _Compared, difference: Floats, offset: float, frame: Frame, series: Series) -> dict[str, Floats]:
    pitch_a, roll_a = tilts(pairs.lean_a)
    pitch_b, roll_b = tilts(pairs.lean_b)
    return {
        "time_s": pairs.time_s,
        "recorded_a_deg": pairs.recorded_a,
        "recorded_b_deg": pairs.recorded_b,
        "simulated_b_deg": angles.wrap360(pairs.recorded_b + difference),
        "deviation_deg": difference,
        "offset_deg": offset - difference,
        "residual_deg": series.residual_deg,
        "kept": series.kept.astype(float),
        "pitch_a_deg": pitch_a,
        "roll_a_deg": roll_a,
        "pitch_b_deg": pitch_b,
        "roll_b_deg": roll_b,
        "tilt_residual_deg": frame.residual_deg,
        "turn_rate_deg_s": pairs.rate_deg_s,
    }


def _sources(pairs: _Compared, clock: Clock, frame: Frame, series: Series) -> tuple[Source, ...]:
    known = heads_series.table(series).sigma_deg
    fitted = float(np.sqrt(max(float(np.nanmean(known**2)) - series.structure_deg**2, 0.0)))
    by_clock = float(abs(np.mean(heads_clock.heading_error_deg(clock, pairs.rate_deg_s))))
    lever = float(np.sqrt(np.mean(np.abs(np.tan(np.abs(pairs.lean_a))) ** 2)))
    return (
        Source("fit", fitted, f"jackknife over {series.stretches} stretches, the clocks' part below included"),
        Source("structure", series.structure_deg, "rms by sectors of 10° of what the series leaves, beyond noise"),
        Source("one reading", angles.rms(series.residual_deg[series.kept]), "scatter of single differences, both compasses"),
        Source("clocks", by_clock, "standard uncertainty of the offset times the mean rate of turn"),
        Source("tilts", lever * frame.rms_deg, "what is left of the tilts, times the tangent of the tilt"),
        Source("resolution", 0.01 / np.sqrt(12.0), "PD0 headings count hundredths of a degree: uniform"),
    )


def _warnings(pairs: _Compared, clock: Clock, frame: Frame, series: Series, offset: float) -> tuple[str, ...]:
    said = list(CANNOT_TELL)
    if series.refused:
        said.append(series.refused)
    if series.terms == 1:
        where = heads_series.stretches_deg(series.covered)
        said.append(f"offset_deg is the mean difference over {where}; elsewhere the difference may be another")
    if frame.verdict != "rigid":
        said.append(frame.text)
    if np.isfinite(frame.offset_sigma_deg):
        apart = float(angles.difference(frame.offset_deg, offset))
        sigma = float(np.hypot(frame.offset_sigma_deg, np.sqrt(series.covariance[0, 0])))
        if abs(apart) > SIGMAS * sigma and abs(apart) > 1.0:
            said.append(
                f"the tilts turn b by {frame.offset_deg:.1f}° ± {frame.offset_sigma_deg:.1f}° against a, the headings by "
                f"{offset:.1f}°: the constants of the compasses differ by {apart:+.1f}° ± {sigma:.1f}°, or the tilt sensors are turned"
            )
    if clock.drift_applied:
        said.append(
            f"b's clock gains {clock.drift_s_per_day:+.2f} ± {clock.drift_sigma_s_per_day:.2f} s a day on a's; taken out"
        )
    if series.stretches == heads_series.LEAST_STRETCHES:
        said.append(
            f"the differences follow each other: {series.n_effective:.0f} of {len(pairs)} count, and the "
            f"uncertainty rests on {series.stretches} stretches"
        )
    spikes = int(np.sum(~series.kept))
    if spikes:
        said.append(f"{spikes} of {len(pairs)} differences are spikes and were left out")
    if step(pairs.time_s) > FARTHEST_CLOCK_S:
        said.append("the heads sample too rarely for a clock error of seconds to be seen")
    return tuple(said)


def _nothing(n: int, why: str, warnings: tuple[str, ...]) -> Calibration:
    return Calibration(kind=KIND, model="none", n=n, coverage=0, why=why, warnings=warnings)
