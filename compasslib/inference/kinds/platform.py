"""Diagnose a bench against the five-term series: large deviation, higher harmonics, changes during the readings.

At fewer than twelve headings the third and fourth harmonics cannot be tested: with them nine coefficients are fitted,
and the noise needs degrees of freedom as well. The residual and the headings to swing are then reported.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import angles, compass
from compasslib.calibrations import curves, platform
from compasslib.calibrations.curves import EXACT, SMITH, FittedCurve, Points
from compasslib.deviation.series import series_design
from compasslib.effects.composed import ComposedEffect
from compasslib.effects.effect import Effect
from compasslib.effects.forward import COMPASS_STEPS
from compasslib.effects.iron import HardIronStep, HardIronTrend
from compasslib.effects.readout import CompassTrend, HeadingSlip, LargeDeviation, Octantal, Sextantal
from compasslib.inference import comparison, diagnosis, short_findings, short_fit, short_search
from compasslib.inference.blocks import Option, block_of
from compasslib.inference.comparison import Options
from compasslib.inference.diagnosis import Diagnosis
from compasslib.inference.finding import Finding
from compasslib.inference.short_fit import FittedHypothesis, ShortComparison
from compasslib.inference.short_search import ShortPlace
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
    chosen = series = short_fit.fit_hypothesis(_compare(correct_deg, recorded_deg, field, None), ())
    first: list[Finding] = []
    if isinstance(exact, FittedCurve):
        by_exact = short_fit.fit_hypothesis(_compare(correct_deg, recorded_deg, field, exact), ())
        first = too_large(series, by_exact, options)
        chosen = series if not folds and not first and series_fits_better(series, by_exact) else by_exact
    searched = short_search.search_effects(chosen.comparison, options)
    outcome = short_findings.build_outcome(searched, options.min_effect_deg)
    return diagnosis.combine_outcomes([outcome], options, extra=first, not_testable=_untested())


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


def _compare(
    correct_deg: Floats, recorded_deg: Floats, field: Mapping[str, float] | None, exact: FittedCurve | None
) -> ShortComparison:
    number = np.arange(1.0, len(correct_deg) + 1.0)
    scene, unit = short_fit.recording_scene(number, field)
    form = short_fit.SeriesResidual if exact is None else short_fit.CompassResidual
    return ShortComparison(
        what="the fitted curve against the bench",
        residual=form(correct_deg, recorded_deg, scene),
        start=np.zeros(5) if exact is None else exact.coefficients,
        steps=np.ones(5) if exact is None else COMPASS_STEPS,
        time_s=number,
        clocked=False,
        terms=READOUT if exact is None else TERMS,
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


CLEARLY = 6.0  # twice the log-likelihood difference from which the series is preferred to the exact compass


def series_fits_better(series: FittedHypothesis, exact: FittedHypothesis) -> bool:
    """Return whether the series fits clearly better than the exact compass."""
    return bool(short_fit.effective_samples(series) * np.log(exact.square / series.square) > CLEARLY)


def too_large(series_alone: FittedHypothesis, exact: FittedHypothesis, options: Options) -> list[Finding]:
    """Test whether the deviation is too large for the series: the exact compass with the same terms must fit better."""
    needs_it = any(term.acts_on == "field" for term in exact.terms)
    correct = np.arange(0.0, 360.0, 5.0)
    recorded = compass.recorded_heading(exact.base, correct)
    columns, deviation = series_design(recorded), angles.difference(correct, recorded)
    beyond_deg = angles.rms(deviation - columns @ np.linalg.lstsq(columns, deviation, rcond=None)[0])
    if needs_it or beyond_deg < options.min_effect_deg:
        return []
    series = short_fit.fit_hypothesis(series_alone.comparison, exact.terms, near=series_alone)
    apart = series.residual_deg - exact.residual_deg
    if angles.rms(apart) < options.min_effect_deg or exact.square >= series.square:
        return []
    option = (Option(LargeDeviation(), block_of(LargeDeviation), apart[:, None], np.ones(1)),)
    evidence = short_search.weigh(series, option, series.evident[:, None])
    if not short_search.detect(ShortPlace(series, option, evidence, exact), options.surrogates).significant:
        return []
    proof = short_findings.held_out_gain(series, exact, exact.terms, _heading_error)
    return [] if proof.refuted else [comparison.large_deviation(series.comparison, angles.rms(apart), proof)]


def _heading_error(fitted: FittedHypothesis) -> Floats:
    """Compute the error of the corrected headings: the residual of the exact compass is that of the recorded ones."""
    of_compass, listed = fitted.comparison.residual, tuple(x for x in fitted.terms if not isinstance(x, ComposedEffect))
    if isinstance(of_compass, short_fit.CompassResidual) and len(listed) == len(fitted.terms):
        return of_compass.heading_error(fitted.base, listed)
    return fitted.residual_deg
