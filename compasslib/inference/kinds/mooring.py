"""Diagnose a mooring's overlap: compare and correct the clocks, then search for unmodelled effects.

The clocks are compared by the speeds of both instruments, which are independent of the compass, in about sixteen
windows. If the small-angle series is configured, the exact compass is compared with it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from compasslib import angles, compass
from compasslib.deviation import fit_deviation
from compasslib.deviation.exact import held_out_scores
from compasslib.deviation.likelihood import EXACT, SERIES
from compasslib.deviation.model import DeviationFit, nearest_root, observed_heading, pair_speeds
from compasslib.deviation.series import invert_series
from compasslib.effects.effect import DAY_S, HOUR_S, YEAR_S
from compasslib.effects.readout import LargeDeviation
from compasslib.effects.reference import ClockDrift, ClockOffset, VeerWithDirection
from compasslib.inference import comparison, diagnosis, finding, long_record
from compasslib.inference import product as products
from compasslib.inference.comparison import FEWEST_PAIRS, SHORTEST_DAYS, Comparison, Options
from compasslib.inference.diagnosis import Diagnosis
from compasslib.inference.finding import Finding, Parameter
from compasslib.preparation.clocks import speed_delays
from compasslib.records import EarthField, Pairs, take
from compasslib.statistics import single_threaded
from compasslib.statistics.least_squares import robust_width
from compasslib.statistics.resampling import blocks_by_span
from compasslib.statistics.whitening import robust_widths
from compasslib.types import Floats

LEAST_CLOCK_H = 0.3  # least clock error that is named; delays by real water are smaller
FEWEST_WINDOWS = 5  # in which the speeds are clearly correlated
NEARLY_AS_GOOD = 10.0  # difference of chi squared below which an offset and a drift are not distinguished
# Delays that are not clock errors: water arriving later at one depth, time stamps at the start, middle or end of an
# average. They are 0.2 h between depths of one real record (eh2), 0.3 h in years simulated from that record.
DELAY_SIGMA_H = 0.15  # standard deviation for a whole record, besides the delay within its own profile

MOST_PAIRS = 20_000  # two years of hourly pairs; longer records are subsampled to limit memory
COMPARED_PAIRS = 1000  # pairs, evenly spaced, for comparing the exact compass with the series
LARGE_DEVIATION_P = 0.01  # p-value up to which the exact compass is preferred to the series
MOST_ROOTLESS = 0.02  # share of headings without a root above which the series is tested


@dataclass(frozen=True)
class ClockError:
    """Error of the affected clock against the reference, positive if ahead: offset at the start, and drift."""

    offset_h: float = 0.0
    drift_h_year: float = 0.0
    offset_sigma_h: float = np.inf
    drift_sigma_h_year: float = np.inf
    offset_named: bool = False
    drift_named: bool = False
    ambiguous: bool = False  # whether the other of offset and drift fits nearly as well

    @property
    def named(self) -> bool:
        """Whether a clock error is significant and larger than delays by the water."""
        return self.offset_named or self.drift_named

    def ahead_s(self, time_s: Floats) -> Floats:
        """Compute the named clock error along time, seconds, (n,)."""
        years = (time_s - time_s[0]) / YEAR_S
        hours = self.offset_named * self.offset_h + self.drift_named * self.drift_h_year * years
        return np.asarray(HOUR_S * hours)


def estimate_clock_error(pairs: Pairs, sigmas: float = finding.NAMED_SIGMAS) -> ClockError:
    """Estimate the clock error from the current speeds; none is named below a normal score of ``sigmas``."""
    separation_h = pairs.separation_minutes / 60.0 - pairs.speed_late_h
    years, ahead, span_years = speed_delays(pairs.time_s, *pair_speeds(pairs), separation_h)
    if len(years) < FEWEST_WINDOWS:
        return ClockError()
    return _select_clock(years, ahead, span_years, float(np.hypot(DELAY_SIGMA_H, pairs.delay_h)), sigmas)


def _select_clock(
    years: Floats, ahead_h: Floats, span_years: float, delay_h: float, sigmas: float = finding.NAMED_SIGMAS
) -> ClockError:
    """Select the simplest clock error that fits the windows, given a delay by the water: offset, drift, or both."""
    ones = np.ones(len(years))
    scatter = float(np.std(ahead_h - np.polynomial.Polynomial.fit(years, ahead_h, 1)(years), ddof=2))
    fit = partial(_fit, ahead_h=ahead_h, scatter_h=scatter, delay_h=delay_h, sigmas=sigmas)
    (offset, slope), least = fit(np.column_stack([ones, years]))
    (mean,), without_drift = fit(ones[:, None])
    (rate,), without_offset = fit(years[:, None])

    def proven(estimate: _Estimate, years: float = 1.0) -> bool:
        return estimate.is_significant and abs(estimate.value) * years >= LEAST_CLOCK_H

    both = proven(offset) and proven(slope, span_years)
    if both and min(without_drift, without_offset) - least > finding.NAMED_SIGMAS**2:
        return ClockError(offset.value, slope.value, offset.sigma, slope.sigma, True, True)
    ambiguous = abs(without_drift - without_offset) < NEARLY_AS_GOOD
    if without_offset < without_drift:
        return ClockError(0.0, rate.value, offset.sigma, rate.sigma, False, proven(rate, span_years), ambiguous)
    return ClockError(mean.value, 0.0, mean.sigma, slope.sigma, proven(mean), False, ambiguous)


class _Estimate(NamedTuple):
    value: float
    sigma: float
    is_significant: bool  # by Student's t distribution


def _fit(
    design: Floats, ahead_h: Floats, scatter_h: float, delay_h: float, sigmas: float
) -> tuple[list[_Estimate], float]:
    """Fit the windows, of a common delay by the water and ``scatter_h`` each: coefficients, and chi squared.

    The scatter is estimated, the delay's variance given: degrees of freedom by Welch and Satterthwaite.
    """
    from scipy.special import ndtr, stdtr

    variance = max(scatter_h, 0.01) ** 2
    whitener = np.linalg.inv(np.linalg.cholesky(np.eye(len(ahead_h)) * variance + delay_h**2))
    estimator = np.linalg.pinv(whitener @ design) @ whitener
    values = estimator @ ahead_h
    of_windows = variance * np.sum(estimator**2, axis=1)
    total = of_windows + delay_h**2 * estimator.sum(axis=1) ** 2
    freedom, sigma = (len(ahead_h) - 2) * (total / of_windows) ** 2, np.sqrt(total)
    significant = stdtr(freedom, -np.abs(values) / np.maximum(sigma, 1e-6)) < ndtr(-sigmas)
    chi2 = float(np.sum((whitener @ (ahead_h - design @ values)) ** 2))
    each = zip(values.tolist(), sigma.tolist(), significant.tolist(), strict=True)
    return [_Estimate(*row) for row in each], chi2


def repair_pairs(pairs: Pairs, clock: ClockError) -> Pairs:
    """Interpolate the reference to the true times of the affected instrument, whose stamps are late if it is ahead."""
    wanted = pairs.time_s - clock.ahead_s(pairs.time_s)
    stamped, first_index = np.unique(pairs.time_s + 60.0 * pairs.separation_minutes, return_index=True)
    after = np.clip(np.searchsorted(stamped, wanted, side="right"), 1, len(stamped) - 1)
    step = float(np.median(np.diff(pairs.time_s)))
    inside = (wanted >= stamped[0]) & (wanted <= stamped[-1]) & (stamped[after] - stamped[after - 1] <= 1.5 * step)
    moved = {
        name: np.interp(wanted, stamped, getattr(pairs, name)[first_index])
        for name in ("lower_east", "lower_north", "lower_depth_m")
    }
    moved["separation_minutes"] = np.zeros(len(pairs))
    return take(replace(pairs, **moved), inside)


@single_threaded()
def diagnose(
    pairs: Pairs,
    logged: Mapping[str, Floats],
    fit: DeviationFit,
    field: EarthField,
    options: Options | None = None,
    *,
    wide: Pairs | None = None,
    units: Mapping[str, str] | None = None,
    shared: comparison.SharedInformation | None = None,
) -> Diagnosis:
    """Diagnose a mooring's overlap against its fitted compass.

    Args:
        logged: other series at the times of the pairs, such as ``temperature`` and ``supply_voltage``, (n,) each.
        fit: the configured fit, whose simulation is diagnosed.
        wide: pairs with a wider depth limit, for comparing the clocks; default ``pairs``.
        units: units of logged series that this package does not define.
        shared: information of other records of the same compass on its effects; ``fit`` contains that on coefficients.
    """
    options = options or Options()
    wide = pairs if wide is None else wide
    searched = slice(None, None, 1 + len(pairs) // MOST_PAIRS)
    pairs, logged = take(pairs, searched), {name: series[searched] for name, series in logged.items()}
    if not fit.fitted:
        return diagnosis.insufficient(f"no compass was fitted: {fit.why}")
    days = float(np.ptp(pairs.time_s)) / DAY_S if len(pairs) else 0.0
    if len(pairs) < FEWEST_PAIRS or days < SHORTEST_DAYS:
        return diagnosis.insufficient(
            f"{len(pairs)} overlapping pairs over {days:.1f} days; at least {FEWEST_PAIRS} over {SHORTEST_DAYS:.0f} "
            "days are needed to separate unmodelled effects from the water"
        )
    is_series = fit.method == "von_appen"
    exact = fit_deviation("exact", pairs) if is_series else fit
    first = exact_compass_findings(pairs, exact, fit, options.min_effect_deg) if is_series else []
    repaired, exact, of_clock, doubted = _repair_clock(pairs, exact, estimate_clock_error(wide, options.clock_sigmas))
    if of_clock:
        remain = np.isin(pairs.time_s, repaired.time_s)
        logged = {name: column[remain] for name, column in logged.items()}
        pairs, first = repaired, [*first, *of_clock]
    case = comparison.compare_pairs(
        pairs, logged, exact, field, reference_magnetic=options.reference_magnetic, units=units
    )
    terms, missing = case.terms, case.not_testable
    if of_clock:  # interpolated directions share their noise with the flow direction, on which this term depends
        terms = tuple(kind for kind in terms if kind is not VeerWithDirection)
        why = "directions read between two samples, after the clocks, share their noise with the direction of the flow"
        missing = (*missing, (VeerWithDirection.name, why))
    if is_series:  # it was tested above
        missing = tuple(item for item in missing if item[0] != LargeDeviation.name)
    case = replace(case, shared=shared or {}, terms=terms, not_testable=missing)
    diagnosed = replace(diagnosis.prepend_findings(first, long_record.diagnose(case, options, exact)), warnings=doubted)
    if not options.apply:
        unapplied = tuple(replace(item, applied=False) for item in diagnosed.findings)
        return replace(diagnosed, applied=(), findings=unapplied)
    if is_series and not any(item.applied for item in diagnosed.findings):
        return replace(diagnosed, applied=())
    if diagnosed.covariance is not None and not exact.known_beforehand:  # uncertainty of the coefficients by slow water
        exact = products.inflate_covariance(exact, diagnosed.covariance)
    applied = tuple(products.with_priors(item, exact) for item in diagnosed.applied)
    return replace(diagnosed, fit=exact, applied=applied)


def _repair_clock(
    pairs: Pairs, fit: DeviationFit, clock: ClockError
) -> tuple[Pairs, DeviationFit, list[Finding], tuple[str, ...]]:
    """Correct the pairs for a clock error and fit the compass again, or warn why the correction is rejected."""
    if not clock.named:
        return pairs, fit, [], ()
    again = repair_pairs(pairs, clock)
    if not (short := len(again) < FEWEST_PAIRS):
        start = fit if fit.known_beforehand or fit.prior is not None else None  # else the fit contains the clock error
        freed = fit_deviation(fit.method, again, start)
        found = clock_findings(pairs, again, (fit, freed), clock)
        if freed.fitted and not any(each.held_out.refuted for each in found):
            return again, freed, found, ()
    why = "too few pairs are left once corrected" if short else "held-out directions then agree less"
    hours = clock.ahead_s(pairs.time_s)[[0, -1]] / HOUR_S
    warning = (
        f"by the speeds the two clocks differ by {hours[0]:+.1f} h at the start and {hours[1]:+.1f} h at the end, but "
        f"{why}: nothing was corrected; check clocks, time zones and dates of both"
    )
    return pairs, fit, [], (warning,)


def clock_findings(
    before: Pairs, after: Pairs, fits: tuple[DeviationFit, DeviationFit], clock: ClockError
) -> list[Finding]:
    """Build the clock findings, scored by held-out residuals of fits to the pairs before and after correction."""
    same = np.isin(before.time_s, after.time_s)
    moved = angles.difference(observed_heading(after), observed_heading(before)[same])
    left = [held_out_residual(pairs, fit) for pairs, fit in zip((before, after), fits, strict=True)]
    left[0] = left[0][same]
    width = robust_widths(left[1], np.zeros(len(after)))
    proof = finding.compare_residuals(left[0], left[1], width, blocks_by_span(after.time_s, finding.HELD_OUT_BLOCK_S))
    size = robust_width(moved)  # robust: directions of slow water are arbitrary
    compared = Comparison(time_s=after.time_s, terms=(), covariates={"time": after.time_s})
    offset, drift, result = ClockOffset(), ClockDrift(), []
    for is_named, term, other, value, sigma in (
        (clock.offset_named, offset, drift, clock.offset_h, clock.offset_sigma_h),
        (clock.drift_named, drift, offset, clock.drift_h_year, clock.drift_sigma_h_year),
    ):
        if is_named:
            chances = comparison.equal_chances(term.name, *[other.name] * clock.ambiguous)
            parameters = {term.fitted()[0]: Parameter(value, sigma, term.units()[0])}
            described = partial(comparison.build_finding, compared, term, chances, parameters)
            result.append(described(size_deg=size, proof=proof, place=compared.where("time", compared.span_s)))
    return result


def exact_compass_findings(
    pairs: Pairs, fit: DeviationFit, series: DeviationFit, min_effect_deg: float
) -> list[Finding]:
    """Test whether the exact compass, which has as many parameters, fits where the small-angle series does not."""
    observed = observed_heading(pairs)
    by_exact, by_series = (_heading_by(each, pairs, observed) for each in (fit, series))
    size, lost = angles.rms(angles.difference(by_exact, by_series)), float(np.mean(~np.isfinite(by_series)))
    if not (size >= min_effect_deg or lost > MOST_ROOTLESS):
        return []
    # Score the exact compass against the best series on held-out blocks.
    compared = take(pairs, np.arange(0, len(pairs), max(1, len(pairs) // COMPARED_PAIRS)))
    block = blocks_by_span(compared.time_s, finding.HELD_OUT_BLOCK_S)
    scores = [held_out_scores(form, compared, block % 2, near) for form, near in ((SERIES, None), (EXACT, fit))]
    left = [held_out_residual(compared, near) for near in (series, fit)]
    proof = finding.bootstrap_gain(scores[1] - scores[0], block, (angles.rms(left[0]), angles.rms(left[1])))
    if proof.p_value > LARGE_DEVIATION_P or proof.refuted:
        return []
    of_pairs = Comparison(time_s=pairs.time_s, terms=(), covariates={"heading": pairs.heading_deg})
    return [replace(comparison.large_deviation(of_pairs, size, proof), applied=True)]


def held_out_residual(pairs: Pairs, fit: DeviationFit) -> Floats:
    """Compute the observed heading minus that of a fit to the other half of the blocks, (n,) degrees."""
    block = blocks_by_span(pairs.time_s, finding.HELD_OUT_BLOCK_S)
    observed, left = observed_heading(pairs), np.full(len(pairs), finding.NO_ROOT_DEG)
    for out in (block % 2 == 0, block % 2 == 1):
        again = fit_deviation(fit.method, take(pairs, ~out), fit)
        if again.fitted:
            left[out] = angles.difference(observed, _heading_by(again, pairs, observed))[out]
    return np.where(np.isfinite(left), left, finding.NO_ROOT_DEG)


def _heading_by(fit: DeviationFit, pairs: Pairs, observed_deg: Floats) -> Floats:
    """Compute the headings corrected by a fit, (n,) degrees, of two the one nearest to that observed; NaN without."""
    if fit.method == "von_appen":
        return invert_series(fit.coefficients, pairs.heading_deg)
    return nearest_root(compass.inverse(fit.coefficients, pairs.heading_deg), observed_deg)
