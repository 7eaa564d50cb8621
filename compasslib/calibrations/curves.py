"""From reference and recorded headings to a calibration: which curve they carry, how sure it is, what they cannot tell.

One heading carries nothing but its own deviation, six neighbouring sectors no curve, eight headings five coefficients
but no proof of a third harmonic. Each such case has its sentence.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from compasslib import angles, compass
from compasslib.calibrations import budget, series
from compasslib.calibrations.exact_curve import EXACT
from compasslib.calibrations.result import Calibration, DeviationTable, Source
from compasslib.calibrations.series import ONE_CYCLE, POLYNOMIAL, SMITH, FittedSeries, Points
from compasslib.types import Floats

FORMS = (SMITH, EXACT, POLYNOMIAL, ONE_CYCLE)
SAME_HEADING_DEG = 1.0  # readings at a reference as near as this repeat one setting of the bench
ENOUGH_HEADINGS = 16  # fewer leave the third and fourth harmonics too little room
WIDE_GAP_DEG = 90.0
MOST_HIDDEN = 0.5  # of a quadrantal deviation, in A, B or C where it is left out
OUTLYING, OUTLYING_DEG = 6.0, 1.0  # medians of the left-out residuals, and at least so far
SWING = "swing 16 to 24 headings all round the circle"


@dataclass(frozen=True)
class BenchReadings:
    """What was read, (n,) each, magnetic."""

    reference_deg: Floats
    recorded_deg: Floats

    def __len__(self) -> int:
        return len(self.reference_deg)


def calibration(
    kind: str, readings: BenchReadings, sources: Sequence[Source] = (), *, table_step_deg: float = 10.0
) -> Calibration:
    """Return the calibration that readings carry, perhaps none.

    Args:
        sources: rows of the uncertainty budget that may turn all headings alike.
    """
    settings = _settings(readings)
    seen = series.points(settings.recorded_deg, settings.reference_deg)
    fits = _fits(seen)
    curves = [curve for curve in fits.values() if isinstance(curve, FittedSeries)]
    found = Calibration(
        kind=kind,
        model="none",
        n=len(readings),
        coverage=series.coverage(readings.recorded_deg),
        sources=tuple(sources),
        points=_points(readings, None),
        details={"headings": len(settings)},
    )
    if not curves:
        return replace(found, why=_too_little(settings, fits))
    chosen = series.choose(curves)
    rows = (*sources, budget.residual(chosen.scatter_deg, chosen.dof))
    points = _points(readings, chosen)
    return replace(
        found,
        model=chosen.form.name,
        **_coefficients(fits, chosen),
        residual_rms_deg=angles.rms(points["residual_deg"]),
        sources=rows,
        table=_table(chosen, table_step_deg, budget.common(rows)),
        points=points,
        details={**found.details, **_details(fits, chosen, budget.common(rows))},
        warnings=_warnings(readings, settings, fits, chosen),
    )


def _fits(seen: Points) -> dict[str, FittedSeries | str]:
    """Return every form through the points, or why there is none."""
    fits = {form.name: series.fit(form, seen) for form in FORMS}
    reduced = isinstance(fits[SMITH.name], str) and isinstance(fits[ONE_CYCLE.name], FittedSeries)
    if reduced and series.hidden(seen) > MOST_HIDDEN:
        fits[ONE_CYCLE.name] = "a quadrantal deviation, which cannot be seen, would look like one cycle"
    return fits


def _settings(readings: BenchReadings) -> BenchReadings:
    """Return one reading a setting of the bench: repeats share the setting's own error and count once."""
    slots = np.round(angles.wrap360(readings.reference_deg) / SAME_HEADING_DEG)
    _, which = np.unique(slots, return_inverse=True)
    groups = [np.flatnonzero(which == k) for k in range(which.max(initial=-1) + 1)]
    means = [
        [float(angles.mean(x[group])) for group in groups] for x in (readings.reference_deg, readings.recorded_deg)
    ]
    return BenchReadings(*np.array(means, dtype=float).reshape(2, -1))


def _coefficients(fits: Mapping[str, FittedSeries | str], chosen: FittedSeries) -> dict[str, Any]:
    """Return the series in the recorded heading and the exact compass, as far as the headings determine them."""
    smith, exact = fits[SMITH.name], fits[EXACT.name]
    found: dict[str, Any] = {}
    if isinstance(smith, FittedSeries):
        found |= {"coefficients": smith.coefficients, "covariance": smith.covariance}
    elif chosen.form is ONE_CYCLE:
        unknown = np.full((5, 5), np.nan)
        unknown[:3, :3] = chosen.covariance
        found |= {"coefficients": np.append(chosen.coefficients, [np.nan, np.nan]), "covariance": unknown}
    if isinstance(exact, FittedSeries):
        found |= {"exact": exact.coefficients, "exact_covariance": exact.covariance}
    return found


def _table(chosen: FittedSeries, step_deg: float, common_deg: float) -> DeviationTable:
    heading = np.arange(0.0, 360.0, step_deg)
    deviation = chosen.deviation(heading)
    sigma = np.hypot(chosen.sigma(heading), common_deg)
    return DeviationTable(heading, deviation, np.where(np.isfinite(deviation), sigma, np.nan))


def _points(readings: BenchReadings, chosen: FittedSeries | None) -> dict[str, Floats]:
    seen = series.points(readings.recorded_deg, readings.reference_deg)
    columns = {"reference_deg": angles.wrap360(readings.reference_deg), "recorded_deg": seen.recorded_deg}
    columns |= {"deviation_deg": seen.deviation_deg}
    if chosen is None:
        return columns
    fitted = chosen.deviation(seen.recorded_deg)
    if chosen.form is EXACT:  # of two headings that read the same the nearer one
        roots = compass.inverse(chosen.coefficients, seen.recorded_deg)
        off = angles.difference(roots, (seen.recorded_deg + seen.deviation_deg)[:, None])
        nearer = np.argmin(np.where(np.isfinite(off), np.abs(off), np.inf), axis=1)
        fitted = seen.deviation_deg + off[np.arange(len(off)), nearer]
    return columns | {"fitted_deg": fitted, "residual_deg": angles.wrap180(seen.deviation_deg - fitted)}


def _details(fits: Mapping[str, FittedSeries | str], chosen: FittedSeries, common_deg: float) -> dict[str, Any]:
    models = {name: {"why": fit} if isinstance(fit, str) else series.described(fit) for name, fit in fits.items()}
    scores = [f"{name} {fit.score_deg:.2f}" for name, fit in fits.items() if isinstance(fit, FittedSeries)]
    chosen_by = f"{chosen.form.name}; degrees rms on headings left out one by one: {', '.join(scores)}"
    shift = {} if chosen.form is POLYNOMIAL else {"constant_shift": _shift(fits, chosen, common_deg)}
    return {"models": models, "chosen_by": chosen_by, **shift}


def _shift(fits: Mapping[str, FittedSeries | str], chosen: FittedSeries, common_deg: float) -> dict[str, Any]:
    """Return what the same turn of all headings would leave, as a compass's own calibration may (Le Menn, Fig. 18)."""
    series_fit = fits[SMITH.name] if isinstance(fits[SMITH.name], FittedSeries) else chosen
    assert isinstance(series_fit, FittedSeries)
    unit = 1.0 if series_fit.form is not EXACT else 1.0 / angles.DEGREE
    value = unit * float(series_fit.coefficients[0])
    sigma = float(np.hypot(unit * np.sqrt(series_fit.covariance[0, 0]), common_deg))
    proven = abs(value) > 2.0 * sigma
    judged = "is significant" if proven else "is not significant"
    text = (
        f"A constant shift of {value:+.2f} ± {2.0 * sigma:.2f} degrees (k = 2) {judged}; "
        "it may be of the compass, its mounting or the reference direction."
    )
    return {"value_deg": value, "sigma_deg": sigma, "differs_from_none": proven, "text": text}


def _too_little(settings: BenchReadings, fits: Mapping[str, FittedSeries | str]) -> str:
    if not len(settings):
        return f"no reading with both headings; {SWING}"
    if len(settings) == 1:
        off = float(angles.difference(settings.reference_deg[0], settings.recorded_deg[0]))
        return f"one heading only: the deviation there is {off:+.1f} degrees, elsewhere it is unknown; {SWING}"
    sectors = series.coverage(settings.recorded_deg)
    return (
        f"{len(settings)} headings in {sectors} of 36 sectors determine no curve (five terms: {fits[SMITH.name]}; "
        f"one cycle: {fits[ONE_CYCLE.name]}); {SWING}"
    )


def _warnings(
    readings: BenchReadings, settings: BenchReadings, fits: Mapping[str, FittedSeries | str], chosen: FittedSeries
) -> tuple[str, ...]:
    warnings = [*_few(readings, settings, chosen), *_gap(settings, chosen), *_outlying(settings, chosen)]
    if chosen.form is ONE_CYCLE and isinstance(fits[SMITH.name], str):
        warnings.append(f"reduced to one cycle, A, B and C: five terms: {fits[SMITH.name]}; D and E stay unknown")
    if chosen.form is POLYNOMIAL:
        low, high = (float(chosen.deviation(np.array([end]))[0]) for end in (0.0, 359.999))
        warnings.append(f"the polynomial is not periodic: it jumps by {low - high:+.1f} degrees where 360 meets 0")
    if not _turns(chosen):
        low, high = (float(angles.wrap360(x)) for x in compass.recorded_range(chosen.coefficients))
        warnings.append(
            f"the compass cannot turn full circle: it shows {low:.0f} to {high:.0f} degrees, each for two correct "
            "headings; no series represents it and the table is empty"
        )
    return tuple(warnings)


def _turns(chosen: FittedSeries) -> bool:
    return chosen.form is not EXACT or compass.turns_full_circle(chosen.coefficients)


def _few(readings: BenchReadings, settings: BenchReadings, chosen: FittedSeries) -> list[str]:
    warnings = []
    if len(settings) < len(readings):
        warnings.append(f"{len(readings)} readings at {len(settings)} headings: repeats are averaged and count once")
    if len(settings) < ENOUGH_HEADINGS:
        warnings.append(
            f"{len(settings)} headings leave {chosen.dof} degrees of freedom: the uncertainty is widened by Student's "
            f"t, and third and fourth harmonics cannot be tested; {SWING}"
        )
    return warnings


def _gap(settings: BenchReadings, chosen: FittedSeries) -> list[str]:
    recorded = np.sort(angles.wrap360(settings.recorded_deg))
    ahead = angles.wrap360(np.roll(recorded, -1) - recorded)
    widest = int(np.argmax(ahead))
    if ahead[widest] <= WIDE_GAP_DEG or not _turns(chosen):
        return []
    ends = f"{recorded[widest]:.0f} and {recorded[(widest + 1) % len(recorded)]:.0f}"
    return [f"no reading between recorded {ends} degrees: there the curve is only as good as its form"]


def _outlying(settings: BenchReadings, chosen: FittedSeries) -> list[str]:
    off = np.abs(chosen.left_out_deg)
    far = off > max(OUTLYING * float(np.median(off)), OUTLYING_DEG)
    places = ", ".join(
        f"{x:.0f} ({y:+.1f})" for x, y in zip(settings.recorded_deg[far], chosen.left_out_deg[far], strict=True)
    )
    return (
        [f"readings far from the curve through the others, at recorded degrees (off by): {places}"] if far.any() else []
    )
