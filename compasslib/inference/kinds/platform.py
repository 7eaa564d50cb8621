"""Diagnose a bench against the five-term series: large deviation, higher harmonics, changes during the readings.

At fewer than twelve headings the third and fourth harmonics cannot be tested: with them nine coefficients are fitted,
and the noise needs degrees of freedom as well. The residual and the headings to swing are then reported.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib import angles, compass
from compasslib.calibrations import curves, platform
from compasslib.calibrations.curves import EXACT, SMITH, FittedCurve, Points
from compasslib.deviation.series import series_design
from compasslib.effects.effect import Effect
from compasslib.effects.forward import COMPASS_STEPS
from compasslib.effects.iron import HardIronStep, HardIronTrend
from compasslib.effects.readout import CompassTrend, HeadingSlip, Octantal, Sextantal
from compasslib.inference import comparison, diagnosis, finding, short_fit, short_search
from compasslib.inference.comparison import Options
from compasslib.inference.diagnosis import Diagnosis
from compasslib.inference.finding import Finding, HeldOut
from compasslib.inference.short_fit import ShortComparison
from compasslib.statistics.noise import effective_sample_size
from compasslib.types import Floats

FEWEST_OF_LOG = 120  # readings; a table written by hand has fewer, which are independent
FEWEST_HEADINGS = 12  # nine coefficients up to the fourth harmonic, and three degrees of freedom
READOUT: tuple[type[Effect], ...] = (Sextantal, Octantal, HeadingSlip, CompassTrend)
TERMS: tuple[type[Effect], ...] = (*READOUT, HardIronStep, HardIronTrend)
SWING = "swing 16 to 24 headings all round the circle"
NO_CLOCK = "the readings carry no temperature, voltage or tilt"


def diagnose(files: Sequence[str | Path], settings: Mapping[str, Any], options: Options) -> Diagnosis:
    """Diagnose a bench against its fitted five-term series."""
    made = platform.calibrate(files, settings)
    if not len(made.points["recorded_deg"]):
        return diagnosis.insufficient(made.why)
    correct, recorded = made.points["reference_deg"], made.points["recorded_deg"]
    return diagnose_readings(correct, recorded, field=settings.get("field"), options=options, why=made.why)


def diagnose_readings(
    correct_deg: Floats, recorded_deg: Floats, *, field: Mapping[str, float] | None, options: Options, why: str = ""
) -> Diagnosis:
    """Diagnose readings in the order in which they were taken.

    A log with correlated errors of neighbouring readings is refused: they look like changes with time.

    Args:
        correct_deg: directions of the bench, magnetic, (n,).
        recorded_deg: recorded headings, (n,).
        field: the earth's field there, None where the place is unknown.
        why: why no curve could be fitted, empty where one could.
    """
    shared = decorrelation_length(recorded_deg, correct_deg)
    if shared > 1:
        return diagnosis.insufficient(
            f"about {shared} readings in a row share their errors, which look like changes of the compass; log the "
            "times of a swing, every 10 s or more often, or give one mean reading a heading",
            _untested(),
        )
    headings = len(np.unique(np.round(angles.wrap360(correct_deg) / platform.SAME_HEADING_DEG)))
    points = curves.deviation_points(recorded_deg, correct_deg)
    if headings < FEWEST_HEADINGS:
        return diagnosis.insufficient(too_few(headings, points, why), _untested())
    smith, exact = (curves.fit_curve(form, points) for form in (SMITH, EXACT))
    folds = isinstance(exact, FittedCurve) and isinstance(smith, str)
    if not isinstance(exact, FittedCurve) and not isinstance(smith, FittedCurve):
        return diagnosis.insufficient(why or f"no curve passes near the readings ({smith})", _untested())
    first = too_large(points, options.min_effect_deg, options.alarm) if isinstance(exact, FittedCurve) else []
    by_series = not folds and not first and series_fits_better(points)
    channel = _channel(correct_deg, recorded_deg, field, exact if not by_series else None)
    searched = short_search.build_outcome(short_search.search_effects(channel, options))
    return diagnosis.combine_outcomes([searched], options, extra=first, not_testable=_untested())


def decorrelation_length(recorded_deg: Floats, correct_deg: Floats) -> int:
    """Compute the decorrelation length of the errors of a log, in readings; 1 if they are independent.

    Six harmonics of the heading, and the mean of each tenth of the log, are removed first.
    """
    n = len(recorded_deg)
    if n < FEWEST_OF_LOG:
        return 1
    order = np.arange(n)
    waves = (wave for k in range(1, 7) for wave in angles.sin_cos(k * recorded_deg))
    tenths = order * 10 // n == np.arange(10)[:, None]
    design = np.column_stack([*tenths.astype(float), *waves])
    off = angles.difference(correct_deg, recorded_deg)
    left = off - design @ np.linalg.lstsq(design, off, rcond=None)[0]
    return round(n / effective_sample_size(left, order.astype(float), longest_s=n / 10))


def _channel(
    correct_deg: Floats, recorded_deg: Floats, field: Mapping[str, float] | None, exact: FittedCurve | str | None
) -> ShortComparison:
    number = np.arange(1.0, len(correct_deg) + 1.0)
    scene, unit = short_fit.recording_scene(number, field)
    form: short_fit.CompassResidual | short_fit.SeriesResidual
    if isinstance(exact, FittedCurve):
        form, start, steps, terms = (
            short_fit.CompassResidual(correct_deg, recorded_deg, scene),
            exact.coefficients,
            COMPASS_STEPS,
            TERMS,
        )
    else:
        form, start, steps = short_fit.SeriesResidual(correct_deg, recorded_deg, scene), np.zeros(5), np.ones(5)
        terms = READOUT
    return ShortComparison(
        what="the fitted curve against the bench",
        residual=form,
        start=start,
        steps=steps,
        time_s=number,
        clocked=False,
        terms=terms,
        covariates={"heading": recorded_deg, "reading": number},
        field_unit=unit,
        independent=True,
    )


def too_few(headings: int, points: Points, why: str = "") -> str:
    """Explain why readings at few headings are insufficient, and which headings to swing."""
    if headings <= 5 or why:
        return f"{why or f'{headings} headings determine no curve with anything to spare'}; {SWING}".replace(
            f"{SWING}; {SWING}", SWING
        )
    design = series_design(points.recorded_deg)
    series = design @ np.linalg.lstsq(design, points.deviation_deg, rcond=None)[0]
    left = angles.wrap180(points.deviation_deg - series)
    sizes = {}
    for k in (3, 4):  # rms removed by one harmonic, fitted jointly with the five terms
        columns = np.column_stack([design, *angles.sin_cos(k * points.recorded_deg)])
        after = left - columns @ np.linalg.lstsq(columns, left, rcond=1e-6)[0]
        sizes[k] = float(np.sqrt(max(angles.rms(left) ** 2 - angles.rms(after) ** 2, 0.0)))
    return (
        f"{headings} headings determine at most {headings} coefficients and five are the curve's: what those leave "
        f"({angles.rms(left):.1f}° rms) is in the third ({sizes[3]:.1f}) and fourth harmonics "
        f"({sizes[4]:.1f}° rms, each fitted alone), sextantal and octantal; neither can be tested; {SWING}"
    )


def _untested() -> tuple[tuple[str, str], ...]:
    return tuple((effect, NO_CLOCK) for effect in ("temperature", "supply_voltage", "heeling"))


# Test of whether a deviation is too large for the five-term series, against the exact compass (five as well).

LEAST_SQUARES = 1e-12  # lower bound of a sum of squares, squared degrees: of two perfect fits neither is preferred
CLEARLY = 6.0  # twice the log-likelihood difference from which the series is preferred to the exact compass


def too_large(points: Points, min_effect_deg: float, alarm: float) -> list[Finding]:
    """Test whether the exact compass fits where the series does not.

    The likelihood ratio is compared with those of benches simulated from the series.

    Args:
        min_effect_deg: size below which the difference is negligible, rms.
        alarm: probability of a false finding if the series is correct.
    """
    left = _residuals(points)
    if left is None:
        return []
    size = angles.rms(left[0] - left[1])
    if size < min_effect_deg or _probability(points, _ratio(points, left)) > alarm:
        return []
    proof = _held_out(points, max(angles.rms(left[1]), 1e-3))
    return [] if proof.refuted else [comparison.large_deviation_finding(size, proof, what="the five-term series")]


def _held_out(points: Points, scale_deg: float) -> HeldOut:
    """Score the exact compass against the series on held-out readings."""
    fold, left = np.arange(len(points)) % finding.FOLDS, np.full((2, len(points)), np.nan)
    for k in range(finding.FOLDS):
        both = _residuals(points, fold != k)
        if both is not None:
            left[:, fold == k] = np.stack(both)[:, fold == k]
    known = np.isfinite(left).all(axis=0)
    left = left[:, known]
    squares = np.minimum(left**2, (10.0 * scale_deg) ** 2)
    gains = (squares[0] - squares[1]) / (2.0 * scale_deg**2)
    return finding.bootstrap_gain(gains, np.flatnonzero(known), (angles.rms(left[0]), angles.rms(left[1])))


def series_fits_better(points: Points) -> bool:
    """Return whether the series fits clearly better than the exact compass."""
    left = _residuals(points)
    return left is None or _ratio(points, left) < -CLEARLY


def _residuals(points: Points, fitted: NDArray[np.bool_] | None = None) -> tuple[Floats, Floats] | None:
    """Compute the residuals of the best series and the best exact compass, fitted to some readings, (n,) each."""
    fitted_points = (
        points
        if fitted is None
        else Points(points.recorded_deg[fitted], points.deviation_deg[fitted], points.weight[fitted])
    )
    solved, five = curves.fit_exact_compass(fitted_points), SMITH.solve(fitted_points)
    if solved is None or five is None:
        return None
    by_series = angles.wrap180(points.deviation_deg - series_design(points.recorded_deg) @ five.coefficients)
    roots = compass.inverse(solved.coefficients, points.recorded_deg)
    off = angles.difference((points.recorded_deg + points.deviation_deg)[:, None], roots)
    nearest = np.argmin(np.where(np.isfinite(off), np.abs(off), np.inf), axis=1)
    by_exact = off[np.arange(len(off)), nearest]
    slope = -1.0 / curves.recorded_slope(solved.coefficients, points)
    lost = slope * solved.residual_deg if fitted is None else np.full(len(points), finding.NO_ROOT_DEG)
    return by_series, np.where(np.isfinite(by_exact), by_exact, lost)


def _ratio(points: Points, left: tuple[Floats, Floats]) -> float:
    by_series, by_exact = (max(float(np.sum(each**2)), LEAST_SQUARES) for each in left)
    return len(points) * float(np.log(by_series / by_exact))


def _probability(points: Points, ratio: float) -> float:
    """Estimate the probability of as large a ratio for a bench that follows the series."""
    solution, rng = SMITH.solve(points), np.random.default_rng(7)
    if solution is None:
        return 1.0
    scatter = float(np.sqrt(np.sum(solution.residual_deg**2) / (len(points) - 5)))
    exceeded = 0
    for _ in range(short_search.NOISE_DRAWS):
        deviation = series_design(points.recorded_deg) @ solution.coefficients
        again = Points(points.recorded_deg, deviation + rng.normal(0.0, scatter, len(points)), points.weight)
        left = _residuals(again)
        exceeded += left is not None and _ratio(again, left) >= ratio
    return (exceeded + 1) / (short_search.NOISE_DRAWS + 1)
