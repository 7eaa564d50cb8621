"""Diagnose a bench against the five-term series: large deviation, higher harmonics, changes during the readings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib import angles, compass
from compasslib.calibrations import curves, platform
from compasslib.calibrations.curves import EXACT, SMITH, FittedCurve
from compasslib.deviation.model import nearest_root
from compasslib.deviation.series import series_design
from compasslib.effects.composed import ComposedEffect
from compasslib.effects.effect import Effect, Scene
from compasslib.effects.forward import COMPASS_STEPS, ForwardModel, invert_heading, invert_readout, recorded_heading
from compasslib.effects.iron import HardIronStep, HardIronTrend
from compasslib.effects.readout import CompassTrend, HeadingSlip, LargeDeviation, Octantal, Sextantal
from compasslib.inference import comparison, diagnosis, short_search
from compasslib.inference.comparison import Options
from compasslib.inference.diagnosis import Diagnosis
from compasslib.inference.evidence import Option, block_of
from compasslib.inference.finding import Finding
from compasslib.inference.short_model import FittedHypothesis, ShortComparison, fit_hypothesis, weigh
from compasslib.inference.short_search import ShortInference
from compasslib.statistics.noise import effective_sample_size
from compasslib.types import Floats

# Nominal horizontal field where the place is unknown; iron is then given in percent of it.
PLACELESS_NT, PERCENT = 20000.0, (100.0 / 20000.0, "% of the horizontal field")
MOST_SAMPLES = 2500  # of a recording; limits the run time of a search
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
    """Diagnose readings in the order in which they were taken; ``field`` is None where the place is unknown."""
    turned = float(angles.wrap180(angles.mean(angles.difference(correct_deg, recorded_deg))))
    if abs(turned) > 90.0:  # beyond what a constant of the exact compass can express
        return diagnosis.insufficient(
            f"the readings are turned by {turned:.0f} degrees on average: the instrument stood back to front, or the "
            "reference does; correct the columns first",
            UNTESTED,
        )
    shared = decorrelation_length(recorded_deg, correct_deg)
    if shared > 1:
        return diagnosis.insufficient(
            f"about {shared} readings in a row share their errors, which look like changes of the compass; log the "
            "times of a swing, every 10 s or more often, or give one mean reading a heading",
            UNTESTED,
        )
    headings = len(np.unique(platform.BenchReadings(correct_deg, recorded_deg).heading_slots))
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
    scene, unit = recording_scene(number, field)
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
    outcome = short_search.build_outcome(searched, options.min_effect_deg)
    return diagnosis.combine_outcomes([outcome], options, extra=first, not_testable=UNTESTED)


def decorrelation_length(recorded_deg: Floats, correct_deg: Floats) -> int:
    """Compute how many readings of a log share their errors, beyond six harmonics and the mean of each tenth of it."""
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
    """Search beyond a curve, the exact compass unless the series fits clearly better: effects, large deviation.

    Args:
        exact: comparison with the exact compass; None where it does not fit.
        more: effects that are tested in addition to those of reading and field.
    """
    by_series = fit_hypothesis(series, ())
    by_exact = None if exact is None else fit_hypothesis(exact, ())
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
    series = fit_hypothesis(series_alone.comparison, exact.terms, near=series_alone)
    apart = series.residual_deg - exact.residual_deg
    if angles.rms(apart) < options.min_effect_deg or exact.square >= series.square:
        return []
    option = (Option(LargeDeviation(), block_of(LargeDeviation), apart[:, None], np.ones(1)),)
    evidence = weigh(series.comparison, series.columns, option, series.evident[:, None])(1.0)
    if not short_search.detect(series, exact, evidence, 1.0, options.surrogates).significant:
        return []
    proof = short_search.held_out_gain(series, exact, exact.terms, _heading_error)
    return [] if proof.refuted else [comparison.large_deviation(series.comparison, angles.rms(apart), proof)]


def _heading_error(fitted: FittedHypothesis) -> Floats:
    """Compute the error of the corrected headings: the residual of the exact compass is that of the recorded ones."""
    residual = fitted.comparison.residual
    if isinstance(residual, CurveResidual) and residual.exact:
        return residual.heading_error(fitted.base, fitted.terms)
    return fitted.residual_deg


def thin_indices(length: int) -> NDArray[np.intp]:
    """Select evenly spaced samples of a record, at most ``MOST_SAMPLES``."""
    return np.arange(0, length, max(1, -(-length // MOST_SAMPLES)))


@dataclass(frozen=True)
class CurveResidual:
    """Residual of a deviation curve in the recorded heading: Smith's five-term series, or the exact compass."""

    correct_deg: Floats  # (n,)
    recorded_deg: Floats  # (n,)
    scene: Scene
    exact: bool

    def _simulation(self, base: Floats, terms: tuple[Effect, ...]) -> ForwardModel:
        return ForwardModel(base, float(np.mean(self.scene.horizontal_nT)), terms)

    def __call__(self, base: Floats, terms: tuple[Effect, ...]) -> Floats:
        """Compute the error of the simulated correct heading, (n,) degrees; for the exact compass of the reading."""
        if self.exact:
            recorded = recorded_heading(self._simulation(base, terms), self.scene, self.correct_deg)
            return angles.difference(recorded, self.recorded_deg)
        reading = invert_readout(self._simulation(np.zeros(5), terms), self.scene, self.recorded_deg)
        return angles.difference(self.correct_deg, reading + series_design(reading) @ base)

    def heading_error(self, base: Floats, terms: tuple[Effect, ...]) -> Floats:
        """Compute correct headings minus those of an exact compass, (n,) degrees; beyond a fold, minus the fold's."""
        roots = invert_heading(self._simulation(base, terms), self.scene, self.recorded_deg)
        root, turn = nearest_root(roots, self.correct_deg), np.arange(0.0, 360.0, 0.5)
        off = angles.difference(compass.recorded_heading(base, turn), self.recorded_deg[:, None])
        fold = turn[np.argmin(np.abs(off), axis=1)]
        return angles.difference(self.correct_deg, np.where(np.isfinite(root), root, fold))


def recording_scene(
    time_s: Floats,
    field: Mapping[str, float] | None,
    *,
    tilt_deg: tuple[Floats, Floats] | None = None,
    departures: Mapping[str, Floats] | None = None,
) -> tuple[Scene, tuple[float, str]]:
    """Build the scene of a recording, without a field where its place is unknown, and factor and unit of iron."""
    unit_field, zero = np.ones(len(time_s)), np.zeros(len(time_s))
    h, z = (PLACELESS_NT, 0.0) if field is None else (field["horizontal_nT"], field["vertical_nT"])
    pitch, roll = tilt_deg or (zero, zero)
    unit = PERCENT if field is None else (1.0, "nT")
    return Scene(time_s, h * unit_field, z * unit_field, pitch, roll, float(time_s[0]), departures or {}), unit
