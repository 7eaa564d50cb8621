"""What the search of a swing's log says of water and delays, found or not, and what it cannot test."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from compasslib import angles, compass
from compasslib.calibration.result import Calibration
from compasslib.deviation import von_appen
from compasslib.discrepancy import show
from compasslib.discrepancy.diagnosis import Options
from compasslib.discrepancy.recordings import fitting, report, telling, testing
from compasslib.discrepancy.recordings.fitting import Fitted
from compasslib.discrepancy.recordings.swing_terms import Carried, LateCourse
from compasslib.discrepancy.recordings.swing_track import KNOT_M_S
from compasslib.discrepancy.recordings.testing import Group
from compasslib.discrepancy.verdict import Diagnosis, Finding, Parameter

Floats = NDArray[np.floating]

WATER = "water_drift"
SEEN = 0.3  # share of a column that the curve must leave for it to be tested
NO_SPEED = "no speeds over ground were logged: what a drift does to the course is not known"
ONE_CLOCK = "courses and headings stand in one log, by one clock"
ONE_WAY = "the ship turned one way only, so that a delay is a constant like A; swing to both sides"
CONSTANT = "a constant of the course is the same as A of the curve"
NO_SENSOR = "the log carries no temperature, voltage or tilt"


def too_short(count: int, fewest: int) -> str:
    """Return why a log is too short.

    Args:
        count: stretches.
        fewest: that are needed.
    """
    return (
        f"the log holds {count} stretches of 20 s that count, at least {fewest} are needed: residuals are alike for "
        "minutes, and so few do not tell an effect from them; swing for a quarter of an hour or longer"
    )


def untested(made: Calibration, fitted: Fitted, *, one_clock: bool) -> tuple[tuple[str, str], ...]:
    """Return what a log cannot show, with the reasons.

    Args:
        made: the calibration of the log.
        fitted: the chosen hypothesis.
        one_clock: whether headings and courses were logged by one.
    """
    said = [("declination_error", CONSTANT)]
    said += [(effect, NO_SENSOR) for effect in ("temperature", "supply_voltage", "heeling")]
    said += [("clock_offset", ONE_CLOCK)] if one_clock else []
    if not _one_way(fitted):
        said += [(effect, ONE_WAY) for effect in ("course_lag", "compass_lag")]
    if water := _not_told(made):
        said.append((WATER, water))
    return tuple(said)


def _one_way(fitted: Fitted) -> bool:
    """Tell whether the turns show a delay beside the curve, or one was found."""
    if any(term.acts_on == "time" for term in fitted.terms):
        return True
    column = testing.columns(fitted, LateCourse())
    return float(np.linalg.norm(fitted.projected(column))) > SEEN * float(np.linalg.norm(column))


def _not_told(made: Calibration) -> str:
    """Return why set and drift cannot be told from B and C, empty where they can or where there is no water."""
    drift = made.details["drift"]
    if drift is None or drift["separable"]:
        return ""
    return NO_SPEED if drift["drift_kn"] is None else str(drift["text"])


def too_large(bare: Fitted, exact: Fitted, options: Options) -> list[Finding]:
    """Return the finding that the exact compass fits where the series does not, or none.

    Args:
        bare: the five-term series, fitted.
        exact: the exact compass with what was found beside it; the series gets the same.
        options: what may be chosen.
    """
    needs_it = any(term.acts_on == "field" for term in exact.terms)
    if needs_it or _beyond_series(exact.base) < options.min_effect_deg:
        return []
    series = fitting.fit(bare.channel, exact.terms, near=bare)
    apart = series.residual_deg - exact.residual_deg
    if angles.rms(apart) < options.min_effect_deg or exact.square >= series.square:
        return []
    tested = testing.test(series, exact, [Group("large_deviation", apart[:, None])])
    if not tested or tested[0].p_value > options.alarm:
        return []
    block = fitting.stretches(exact)
    folds = min(report.FOLDS, block.max() + 1)
    left = [report.left_out(one, exact.terms, block, folds) for one in (series, exact)]
    squares = [np.minimum(np.abs(one) / exact.scale_deg, fitting.CLIP) ** 2 for one in left]
    proof = show.judged((squares[0] - squares[1]) / 2.0, block, (angles.rms(left[0]), angles.rms(left[1])))
    return [] if proof.refuted else [telling.large(angles.rms(apart), proof, series.channel.what)]


def _beyond_series(coefficients: Floats) -> float:
    """Return what the five-term series cannot take of an exact compass's curve, rms degrees round the circle."""
    correct = np.arange(0.0, 360.0, 5.0)
    recorded = compass.recorded_heading(coefficients, correct)
    columns, deviation = von_appen.design(recorded), angles.difference(correct, recorded)
    return angles.rms(deviation - columns @ np.linalg.lstsq(columns, deviation, rcond=None)[0])


def settled(found: Diagnosis, made: Calibration, fitted: Fitted) -> Diagnosis:
    """Return the diagnosis with what it says of the water: set and drift, a bound, or why they cannot be told.

    Args:
        found: by the search.
        made: the calibration of the log.
        fitted: the chosen hypothesis of the course.
    """
    found = replace(found, findings=tuple(_with_set(one) for one in found.findings))
    drift = made.details["drift"]
    if drift is None or any(WATER in (one.effect, *one.alternatives) for one in found.findings):
        return found
    why = _not_told(made)
    if not why:
        return replace(found, why=f"{found.why} {_bound(fitted)}")
    if found.verdict == "consistent":
        return replace(found, verdict="insufficient", why=f"{found.why} {why}", separated_by=SEPARATED)
    return replace(found, separated_by="; ".join(filter(None, (found.separated_by, SEPARATED))))


SEPARATED = (
    "water_drift or B and C of the curve: each heading at two speeds, a log of the speed through the water, a visual "
    "mark or the sun; the same circle the other way round tells only a delay"
)


def _bound(fitted: Fitted) -> str:
    """Return how large a drift the courses still allow."""
    if fitted.channel.covariates.get("speed") is None:
        return ""
    with_water = fitting.fit(fitted.channel, (*fitted.terms, Carried()), near=fitted)
    drift, spread = with_water.terms[-1].values, fitting.covariance(with_water)[-2:, -2:]
    most = float(np.hypot(*drift) + 1.96 * np.sqrt(np.linalg.eigvalsh(spread)[-1]))
    return f"Set and drift of the water do not show in the courses: less than {most / KNOT_M_S:.2g} kn (95 %)."


def _with_set(one: Finding) -> Finding:
    """Return the finding of the water with set and drift beside its components."""
    if one.effect != WATER:
        return one
    east, north = (one.parameters[name] for name in ("east_m_s", "north_m_s"))
    drift = max(float(np.hypot(east.value, north.value)), 1e-9)
    along = np.abs([east.value, north.value]) / drift
    sigma = np.array([east.sigma, north.sigma])
    size, side = (float(np.hypot(*(sigma * share))) for share in (along, along[::-1]))
    more = {
        "drift_kn": Parameter(drift / KNOT_M_S, size / KNOT_M_S, "kn"),
        "set_deg": Parameter(float(angles.direction(east.value, north.value)), np.degrees(side / drift), "degrees"),
    }
    said = (
        f" The water sets {more['set_deg'].value:.0f}° ± {1.96 * more['set_deg'].sigma:.0f}° (true) at "
        f"{more['drift_kn'].value:.2f} ± {1.96 * more['drift_kn'].sigma:.2f} kn; a steady leeway would look the same."
    )
    return replace(one, parameters={**more, **one.parameters}, text=one.text + said)
