"""Deviation curves: the published series and the exact compass, each with fit, inverse and uncertainty.

Two hundred hours of currents measured by both instruments, the upper one with a compass of B = 0.3:

>>> import numpy as np
>>> from compasslib import angles, compass
>>> from compasslib.deviation import fit_deviation
>>> from compasslib.records import Pairs
>>> rng, n = np.random.default_rng(1), 200
>>> correct, flow = rng.uniform(0.0, 360.0, n), rng.uniform(0.0, 360.0, n)
>>> recorded = compass.recorded_heading(np.array([0.0, 0.3, 0.0, 0.0, 0.0]), correct)
>>> upper = angles.sin_cos(flow + recorded - correct + rng.normal(0.0, 5.0, n))  # east and north, m/s
>>> level, metres = np.zeros(n), np.full(n, 100.0)
>>> hours = 3600.0 * np.arange(n)
>>> pairs = Pairs(hours, recorded, level, level, *upper, *angles.sin_cos(flow), metres, metres + 8.0, level, level)
>>> fit = fit_deviation("exact", pairs)
>>> round(float(fit.coefficients[1]), 2), fit.folded
(0.3, False)
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from compasslib import compass
from compasslib.deviation.exact import correct_roots, fit_exact
from compasslib.deviation.model import DeviationFit
from compasslib.deviation.series import fit_series
from compasslib.records import BAD, Pairs, Record
from compasslib.statistics import single_threaded

__all__ = ["METHODS", "DeviationFit", "describe_fit", "deviation_json", "find_implausibility", "fit_deviation"]


METHODS: dict[str, Callable[[Pairs, DeviationFit | None], DeviationFit]] = {
    "exact": fit_exact,
    "von_appen": fit_series,
}


@single_threaded()
def fit_deviation(method: str, pairs: Pairs, near: DeviationFit | None = None) -> DeviationFit:
    """Fit a deviation model to pairs.

    Args:
        method: ``exact`` or ``von_appen``.
        near: a fit of the same method to similar pairs, to start from; returned if it was known beforehand.
    """
    if near is not None and (near.fixed or near.known_beforehand):
        return near
    return METHODS[method](pairs, near)


def correctable_fraction(fit: DeviationFit, record: Record) -> float:
    """Compute the share of the recorded headings that are possible under the model, 0 to 1."""
    usable = np.isfinite(record.heading_deg) & (record.heading_quality < BAD)
    recorded = record.heading_deg[usable]
    if not (fit.fitted and recorded.size):
        return 0.0
    return float(np.isfinite(correct_roots(fit, recorded)).any(axis=1).mean())


def find_implausibility(fit: DeviationFit, record: Record) -> str:
    """Explain why a fitted model is implausible for the instrument; empty if it is plausible.

    If components of the reference were exchanged or wrongly signed, the fit has excessive soft iron, or cannot have
    recorded a quarter of the headings within five noises of the compass; outliers are fewer.
    """
    if fit.mistake:
        return f"{fit.mistake}; all headings are flagged doubtful until the file or the configuration is corrected"
    if fit.has_implausible_iron:
        return (
            f"the fit needs soft iron of {np.hypot(*fit.coefficients[3:5]):.0%} of the earth's field, more than any "
            "instrument has, so that all headings are flagged doubtful; check columns, signs and directions of both "
            "instruments"
        )
    usable = np.isfinite(record.heading_deg) & (record.heading_quality < BAD)
    recorded = record.heading_deg[usable]
    if not (fit.fitted and recorded.size) or fit.method == "von_appen":
        return ""
    near = [recorded + share * 5.0 * fit.noise.compass_deg for share in (0.0, -0.5, 0.5, -1.0, 1.0)]
    possible = np.any([np.isfinite(compass.inverse(fit.coefficients, x)).any(axis=1) for x in near], axis=0)
    if possible.mean() > 0.75:
        return ""
    return (
        f"the fitted compass cannot have recorded {1.0 - possible.mean():.0%} of the headings in the file, so that "
        "all are flagged doubtful; check columns, signs and units of both instruments, or the calibration"
    )


def deviation_json(fit: DeviationFit, record: Record) -> dict[str, Any]:
    """Compose the content of deviation.json."""
    said = dict.fromkeys(sentence for sentence in (*fit.warnings, find_implausibility(fit, record)) if sentence)
    return fit.to_json() | {"correctable_fraction": correctable_fraction(fit, record), "warnings": tuple(said)}


def describe_fit(name: str, fit: DeviationFit) -> str:
    """Describe the fit in a log line, with its warnings."""
    if not fit.fitted:
        return f"{name}: no deviation fitted: {fit.why}"
    unit = " degrees" if fit.method == "von_appen" else ""
    letters = ", ".join(f"{k} {x:+.3f}" for k, x in zip("ABCDE", fit.coefficients, strict=True))
    kind = "two-valued" if fit.folded else "full circle"
    residual = f", residual {fit.residual_rms_deg:.1f}° rms" if np.isfinite(fit.residual_rms_deg) else ""
    first = f"{name}: {fit.method} {letters}{unit}; {kind}{residual}"
    return "\n".join([first, *(f"{name}: warning: {warning}" for warning in fit.warnings)])
