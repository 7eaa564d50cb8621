"""Diagnose a bench against the five-term series: large deviation, higher harmonics, changes during the readings.

At fewer than twelve headings the third and fourth harmonics cannot be tested: with them nine coefficients are fitted,
and the noise needs degrees of freedom as well.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import angles, compass
from compasslib.calibrations import curves, platform
from compasslib.calibrations.curves import EXACT, SMITH, FittedCurve
from compasslib.deviation.series import series_design
from compasslib.effects.composed import ComposedEffect
from compasslib.effects.effect import Effect
from compasslib.effects.forward import COMPASS_STEPS
from compasslib.effects.iron import HardIronStep, HardIronTrend
from compasslib.effects.readout import CompassTrend, HeadingSlip, LargeDeviation, Octantal, Sextantal
from compasslib.inference import comparison, diagnosis, short_findings, short_fit, short_search
from compasslib.inference.comparison import Options
from compasslib.inference.diagnosis import Diagnosis
from compasslib.inference.evidence import Option, block_of
from compasslib.inference.finding import Finding
from compasslib.inference.short_fit import CurveResidual, FittedHypothesis, ShortComparison
from compasslib.inference.short_search import ShortInference
from compasslib.statistics.noise import effective_sample_size
from compasslib.types import Floats

FEWEST_OF_LOG = 120  # readings; a table written by hand has fewer, which are independent
FEWEST_HEADINGS = 12  # nine coefficients up to the fourth harmonic, and three degrees of freedom
CLEARLY = 6.0  # twice the log-likelihood difference from which the series is preferred to the exact compass
READOUT: tuple[type[Effect], ...] = (Sextantal, Octantal, HeadingSlip, CompassTrend)
FIELD: tuple[type[Effect], ...] = (HardIronStep, HardIronTrend)
UNTESTED = tuple(
    (effect, "the readings carry no temperature, voltage or tilt")
    for effect in ("temperature", "supply_voltage", "heeling")
)


def diagnose(files: Sequence[str | Path], settings: Mapping[str, Any], options: Options) -> Diagnosis:
    """Diagnose a bench against its fitted five-term series."""
    made = platform.calibrate(files, settings)
    if made.why:
        return diagnosis.insufficient(made.why, UNTESTED)
    correct, recorded = made.points["reference_deg"], made.points["recorded_deg"]
    return diagnose_readings(correct, recorded, field=settings.get("field"), options=options)


def diagnose_readings(
    correct_deg: Floats, recorded_deg: Floats, *, field: Mapping[str, float] | None, options: Options
) -> Diagnosis:
    """Diagnose readings in the order in which they were taken; ``field`` is None where the place is unknown.

    A log with correlated errors of neighbouring readings is refused: they look like changes with time.
    """
    shared = decorrelation_length(recorded_deg, correct_deg)
    if shared > 1:
        return diagnosis.insufficient(
            f"about {shared} readings in a row share their errors, which look like changes of the compass; log the "
            "times of a swing, every 10 s or more often, or give one mean reading a heading",
            UNTESTED,
        )
    headings = len(np.unique(np.round(angles.wrap360(correct_deg) / platform.SAME_HEADING_DEG)))
    if headings < FEWEST_HEADINGS:
        return diagnosis.insufficient(
            f"{headings} headings determine at most {headings} coefficients and five are the curve's: the third and "
            "fourth harmonics, sextantal and octantal, cannot be tested; swing 16 to 24 headings all round the circle",
            UNTESTED,
        )
    exact = curves.fit_curve(EXACT, points := curves.deviation_points(recorded_deg, correct_deg))
    if not isinstance(exact, FittedCurve) and isinstance(smith := curves.fit_curve(SMITH, points), str):
        return diagnosis.insufficient(f"no curve passes near the readings ({smith})", UNTESTED)
    number = np.arange(1.0, len(correct_deg) + 1.0)
    scene, unit = short_fit.recording_scene(number, field)
    series = ShortComparison(
        what="the fitted curve against the bench",
        residual=CurveResidual(correct_deg, recorded_deg, scene, exact=False),
        start=np.zeros(5),
        steps=np.ones(5),
        time_s=number,
        clocked=False,
        terms=(),
        covariates={"heading": recorded_deg, "reading": number},
        field_unit=unit,
        independent=True,
    )
    by_exact = None
    if isinstance(exact, FittedCurve):
        residual = CurveResidual(correct_deg, recorded_deg, scene, exact=True)
        by_exact = replace(series, residual=residual, start=exact.coefficients, steps=COMPASS_STEPS)
    searched, first = search_curve(series, by_exact, options)
    outcome = short_findings.build_outcome(searched, options.min_effect_deg)
    return diagnosis.combine_outcomes([outcome], options, extra=first, not_testable=UNTESTED)


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


def search_curve(
    series: ShortComparison, exact: ShortComparison | None, options: Options, more: tuple[type[Effect], ...] = ()
) -> tuple[ShortInference, list[Finding]]:
    """Search beyond a deviation curve, the exact compass unless the series fits clearly better.

    Args:
        exact: comparison with the exact compass; None where it does not fit.
        more: effects that are tested in addition to those of reading and field.

    Returns:
        The effects, and the finding that the deviation is too large for the series.
    """
    by_series = short_fit.fit_hypothesis(series, ())
    by_exact = None if exact is None else short_fit.fit_hypothesis(exact, ())
    clearly = by_series.effective_samples
    if exact is None or by_exact is None or clearly * np.log(by_exact.square / by_series.square) > CLEARLY:
        return short_search.search_effects(replace(series, terms=READOUT + more), options), []
    found = short_search.search_effects(replace(exact, terms=READOUT + FIELD + more), options)
    # What no listed effect explains is not credited to the exact compass.
    listed = by_exact if any(isinstance(term, ComposedEffect) for term in found.fitted.terms) else found.fitted
    return found, _too_large(by_series, listed, options)


def _too_large(series_alone: FittedHypothesis, exact: FittedHypothesis, options: Options) -> list[Finding]:
    """Test whether the deviation is too large for the series: the exact compass with the same terms must fit better."""
    correct = np.arange(0.0, 360.0, 5.0)
    recorded = compass.recorded_heading(exact.base, correct)
    columns, deviation = series_design(recorded), angles.difference(correct, recorded)
    beyond_deg = angles.rms(deviation - columns @ np.linalg.lstsq(columns, deviation, rcond=None)[0])
    if any(term.acts_on == "field" for term in exact.terms) or beyond_deg < options.min_effect_deg:
        return []
    series = short_fit.fit_hypothesis(series_alone.comparison, exact.terms, near=series_alone)
    apart = series.residual_deg - exact.residual_deg
    if angles.rms(apart) < options.min_effect_deg or exact.square >= series.square:
        return []
    option = (Option(LargeDeviation(), block_of(LargeDeviation), apart[:, None], np.ones(1)),)
    evidence = short_search.weigh(series, option, series.evident[:, None])(1.0)
    if not short_search.detect(series, exact, evidence, 1.0, options.surrogates).significant:
        return []
    proof = short_findings.held_out_gain(series, exact, exact.terms, _heading_error)
    return [] if proof.refuted else [comparison.large_deviation(series.comparison, angles.rms(apart), proof)]


def _heading_error(fitted: FittedHypothesis) -> Floats:
    """Compute the error of the corrected headings: the residual of the exact compass is that of the recorded ones."""
    residual = fitted.comparison.residual
    if isinstance(residual, CurveResidual) and residual.exact:
        return residual.heading_error(fitted.base, fitted.terms)
    return fitted.residual_deg
