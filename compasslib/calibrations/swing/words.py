"""What a swing can bear, and what must be said of it: refusals and warnings, each a sentence with its remedy."""

from __future__ import annotations

import numpy as np

from compasslib import angles
from compasslib.calibrations.platform import ALIKE_DEG, DECLINATION_DEG
from compasslib.calibrations.swing import model
from compasslib.calibrations.swing.data import headings_of
from compasslib.calibrations.swing.fit import SwingFit
from compasslib.calibrations.swing.model import COURSE, DRIFT, EAST, LAG, LOG, NORTH, SERIES, Swing, drift_of
from compasslib.deviation import von_appen
from compasslib.types import Floats

TERMS = 5
SECTOR_DEG = 10.0
REFUSED_GAP_DEG, WIDE_GAP_DEG = 180.0, 100.0
FEW_HEADINGS = 16
STRUCTURE_DEG = 2.0  # residuals of a steady swing beyond it are not reading errors
SEPARATED = 0.5  # drift is told from B and C where the swing halves its prior
SERIES_LIMIT_DEG = 20.0  # Smith's series (Le Menn et al. 2023)
REMEDY = "swing 16 to 24 headings round the full circle"
KNOT = "kn"


def refusal(swing: Swing) -> str:
    """Return why the five-term series cannot be fitted, or nothing."""
    seen = swing.seen
    if not len(seen):
        lost = "; ".join(f"{n} {why}" for why, n in seen.left_out.items())
        return f"no usable observations{f': {lost}' if lost else ''}"
    distinct = distinct_headings(seen.recorded_deg)
    if distinct < TERMS:
        count = "one heading" if distinct == 1 else f"{distinct} headings"
        return f"{count} cannot carry the five coefficients: {REMEDY}"
    if len(seen) + len(swing.marks) <= TERMS:
        return f"{len(seen)} observations leave nothing to tell the uncertainty from: {REMEDY}"
    gap = widest_gap(seen.recorded_deg)
    if gap > REFUSED_GAP_DEG:
        sectors = coverage(seen.recorded_deg)
        return (
            f"the headings cover {sectors} of 36 sectors and leave {gap:.0f}° without any: a circle's five "
            f"coefficients cannot be told from so narrow an arc; {REMEDY}"
        )
    return ""


def warnings(swing: Swing, series: SwingFit, exact: SwingFit) -> tuple[str, ...]:
    """Return what must be said of a fitted swing."""
    seen = swing.seen
    left_out = [f"left out: {n} {why}" for why, n in seen.left_out.items()]
    warnings = [
        *_of_constant(swing, series),
        *left_out,
        *seen.warnings,
        *_of_headings(swing, series),
        *_of_water(swing, series),
        *_of_time(swing, series),
    ]
    warnings += _of_declination(swing) + _of_size(series, exact)
    return tuple(warnings)


def coverage(recorded_deg: Floats) -> int:
    """Return the number of occupied sectors of 10 degrees.

    Args:
        recorded_deg: recorded headings, (n,).
    """
    return len(np.unique(np.floor(recorded_deg / SECTOR_DEG)))


def distinct_headings(recorded_deg: Floats) -> int:
    """Return how many headings were steered, repeated ones counted once.

    Args:
        recorded_deg: recorded headings, (n,).
    """
    return len(np.unique(headings_of(recorded_deg))) if len(recorded_deg) < 100 else coverage(recorded_deg)


def widest_gap(recorded_deg: Floats) -> float:
    """Return the widest arc without a heading, degrees.

    Args:
        recorded_deg: recorded headings, (n,).
    """
    ordered = np.sort(recorded_deg)
    return float(np.max(np.append(np.diff(ordered), ordered[0] + 360.0 - ordered[-1])))


def separation(swing: Swing, series: SwingFit) -> dict[str, object]:
    """Return set and drift of the water, how well they are told from B and C, and what stays confounded."""
    set_deg, drift = drift_of(series.parameters)
    covariance, prior = series.covariance, model.prior_widths(swing)
    sigma = np.sqrt(np.diag(covariance))
    along = np.array(angles.components(1.0, set_deg))
    across = np.array(angles.components(1.0, set_deg + 90.0))
    water = covariance[np.ix_(DRIFT, DRIFT)]
    left = float(np.max(sigma[DRIFT] / prior[DRIFT]))
    unit = KNOT if swing.has_speed else "of the ship's speed"
    side = float(np.sqrt(max(float(across @ water @ across), 0.0)))
    return {
        "set_deg": set_deg,
        "drift_kn": drift if swing.has_speed else None,
        "drift_ratio": drift / float(np.median(swing.speed_kn)),
        "sigma_drift_kn": float(np.sqrt(max(float(along @ water @ along), 0.0))) if swing.has_speed else None,
        "sigma_set_deg": float(angles.direction(side, drift)) if drift else 90.0,
        "east": float(series.parameters[EAST]),
        "north": float(series.parameters[NORTH]),
        "covariance": water.tolist(),
        "correlation": _with_b_and_c(covariance),
        "left_of_belief": left,
        "largest_alike": _alike(series),
        "log_scale": float(series.parameters[LOG]) if np.isfinite(prior[LOG]) and prior[LOG] > 1e-6 else None,
        "separable": left < SEPARATED,
        "text": _sentence(swing, (set_deg, drift, unit), left, sigma),
    }


def _sentence(swing: Swing, water: tuple[float, float, str], left: float, sigma: Floats) -> str:
    set_deg, drift, unit = water
    speed = swing.seen.speed_kn
    ratio = f"speeds from {speed.min():.1f} to {speed.max():.1f} kn" if swing.has_speed else "no speeds"
    if left < SEPARATED:
        return (
            f"With {ratio} the water is told from the compass: set {set_deg:.0f}°, drift {drift:.2f} {unit} "
            f"(± {np.max(sigma[DRIFT]):.2f}). A steady leeway by wind would look the same."
        )
    return (
        f"With {ratio} set and drift cannot be separated from B and C: to first order they are one function of the "
        f"heading. B and C carry ± {sigma[1]:.1f}° and ± {sigma[2]:.1f}°; A, D and E do not suffer. A visual mark, the "
        "sun, a log of the speed through the water, or each heading at two speeds would separate them."
    )


def _with_b_and_c(covariance: Floats) -> dict[str, float]:
    sigma = np.sqrt(np.diag(covariance))
    pairs = [(k, j) for k in (1, 2) for j in DRIFT]
    names = {1: "B", 2: "C", EAST: "east", NORTH: "north"}
    return {f"{names[k]}_{names[j]}": float(covariance[k, j] / (sigma[k] * sigma[j])) for k, j in pairs}


def _alike(series: SwingFit) -> dict[str, object]:
    """Return what the swing knows least: the combination of B, C and drift with the widest covariance."""
    index = [1, 2, *DRIFT]
    sigma = np.sqrt(np.diag(series.covariance))[index]
    size, vectors = np.linalg.eigh(series.covariance[np.ix_(index, index)] / np.outer(sigma, sigma))
    weakest = dict(zip(("B", "C", "east", "north"), (float(x) for x in vectors[:, -1]), strict=True))
    return {"share": float(size[-1] / size.sum()), "direction": weakest}


def _of_headings(swing: Swing, series: SwingFit) -> list[str]:
    recorded, warnings = swing.seen.recorded_deg, []
    distinct, gap = distinct_headings(recorded), widest_gap(recorded)
    rms = angles.rms(series.residuals[COURSE])
    if distinct < FEW_HEADINGS:
        warnings.append(
            f"{distinct} headings carry at most {distinct} coefficients, {TERMS} of which are taken"
            f"{': sin 4 of the heading is not seen at all' if distinct == 8 else ''}; "
            f"third and fourth harmonics cannot be tested. To test them, {REMEDY}"
        )
    if distinct < len(recorded) < 100:
        warnings.append(
            f"{len(recorded) - distinct} of {len(recorded)} observations repeat a heading: they tell no more of it"
        )
    if rms > STRUCTURE_DEG and not swing.seen.timed:
        warnings.append(_harmonics(swing, series, rms))
    if gap > WIDE_GAP_DEG:
        warnings.append(f"{gap:.0f}° of the circle hold no heading: the table is extrapolated there")
    return warnings


def _harmonics(swing: Swing, series: SwingFit, rms: float) -> str:
    recorded, residual = swing.seen.recorded_deg, series.residuals[COURSE]
    size = {}
    for order, name in ((3, "third"), (4, "fourth")):
        columns = np.stack(angles.sin_cos(order * recorded), axis=-1)
        columns = columns[:, 1:] if order == 4 and distinct_headings(recorded) == 8 else columns  # sin 4 is not seen
        both = np.column_stack([von_appen.design(recorded), columns])
        taken = residual - both @ np.linalg.lstsq(both, residual, rcond=1e-6)[0]
        size[name] = angles.rms(taken)
    return (
        f"the series leaves {rms:.2f}° rms; with the third harmonic of the heading {size['third']:.2f}° would be left, "
        f"with the fourth {size['fourth']:.2f}°: there may be structure (sextantal, octantal deviation) beside it"
    )


def _of_water(swing: Swing, series: SwingFit) -> list[str]:
    if not swing.seen.over_ground:
        return []
    warnings = []
    if not swing.has_speed:
        warnings.append(
            f"no speeds were logged: a drift of up to {swing.widest_drift:.2f} of the ship's speed is assumed "
            "(drift_ratio)"
        )
    found = separation(swing, series)
    if not found["separable"]:
        warnings.append(str(found["text"]))
    if swing.has_speed and drift_of(series.parameters)[1] > swing.widest_drift:
        warnings.append(
            f"the drift found is more than the {swing.widest_drift:g} kn that were allowed: "
            "raise max_drift_kn if it may be"
        )
    return warnings


def _of_time(swing: Swing, series: SwingFit) -> list[str]:
    seen, sigma = swing.seen, np.sqrt(np.diag(series.covariance))
    if not seen.timed:
        return []
    warnings = []
    noise = series.noises[COURSE]
    if noise.n_effective < len(seen) / 2.0:
        warnings.append(
            f"residuals of neighbouring samples are alike: {len(seen)} samples say as much as {noise.n_effective:.0f}"
        )
    correlation = abs(series.covariance[0, LAG]) / (sigma[0] * sigma[LAG])
    if correlation > 0.7:
        warnings.append("the ship turned one way only, so that the course's delay looks like A: swing to both sides")
    return warnings


def _of_declination(swing: Swing) -> list[str]:
    stated = swing.seen.variation_deg
    off = abs(float(angles.difference(stated, swing.declination_deg))) if np.isfinite(stated) else 0.0
    if off < 0.5:
        return []
    return [f"the log states a declination of {stated:+.1f}°, {swing.declination_deg:+.1f}° is used"]


def _of_constant(swing: Swing, series: SwingFit) -> list[str]:
    """Say where A is minus the declination, once or twice: which of the two norths is then likely confused."""
    constant, declination = float(series.parameters[0]), swing.declination_deg
    near = max(2.0 * float(np.sqrt(series.covariance[0, 0])), ALIKE_DEG)
    if min(abs(constant), abs(declination)) <= max(DECLINATION_DEG, near):
        return []
    confused = {
        1.0: "the recorded headings are probably true already (HDG of some logs is), or the courses magnetic; if so, "
        "write declination: 0",
        2.0: "the declination probably has the wrong sign; if so, correct declination, or latitude and longitude",
    }
    begin = f"A is {constant:+.1f}°, which is"
    return [
        f"{begin} {'twice ' * (times == 2.0)}minus the declination of {declination:+.1f}°: {what}"
        for times, what in confused.items()
        if abs(float(angles.difference(constant, -times * declination))) < near
    ]


def _of_size(series: SwingFit, exact: SwingFit) -> list[str]:
    columns = von_appen.design(np.arange(0.0, 360.0, SECTOR_DEG))
    largest = float(np.max(np.abs(columns @ series.parameters[SERIES])))
    if largest < SERIES_LIMIT_DEG:
        return []
    left, by_exact = angles.rms(series.residuals[COURSE]), angles.rms(exact.residuals[COURSE])
    return [
        f"deviations up to {largest:.0f}° are beyond what the five-term series is good for (about 20°): it leaves "
        f"{left:.1f}° rms, the exact compass {by_exact:.1f}°"
    ]
