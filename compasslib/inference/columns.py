"""Columns that are tested: one group for each catalogue term and date, splines of the covariates for the rest."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from compasslib.effects import Term, composition
from compasslib.effects.reading import HeadingSlip
from compasslib.inference import stuck
from compasslib.inference.baseline import State
from compasslib.inference.case import TIDES_H
from compasslib.inference.omnibus import KNOTS, Group, hats, heading_hats, periodic, standard
from compasslib.types import Floats

DATE_STEP_S, DATE_MARGIN = 10 * 86400.0, 0.04  # dates of steps that are tried, and how near to the ends
THRESHOLDS = (0.07, 0.13, 0.2, 0.35, 0.5, 0.65, 0.8, 0.87, 0.93)  # quantiles beyond which an effect may set in
HEADING_HAT_DEG, FEWEST_IN_HAT = 6.0, 30  # sectors that the omnibus sees, and readings in one
TEETH = 24  # highest harmonic of the recorded heading
TIME_KNOTS, SHORTEST_WAVE_S = (12, 36), 20 * 86400.0  # changes that the omnibus sees
SPELL, SPELL_STEP_S, SPELLS = "spell", 5 * 86400.0, (4, 6, 8, 12, 18)  # weeks in which the reading is off, in steps
FAINTEST = 1e-2  # of the power of the best seen combination of splines or harmonics
PERIODS = {"hour_of_day": 24.0, "reference_heading": 360.0}  # of what goes round
LINEAR = ("time", "temperature", "depth", "pitch", "roll", "speed", "supply_voltage")  # of the products


def of_term(state: State, term: Term) -> Group:
    """Return the columns of one term beside a simulation.

    Args:
        term: the term at the values where the derivative is taken.
    """
    return Group(term.name, _derivative(state, term), term)


def of_dates(state: State, kind: type[Term], dates_s: Floats) -> list[Group]:
    """Return the columns of a term that begins at each of some dates.

    Args:
        kind: a term with a date.
        dates_s: UTC seconds since 1970, (m,).
    """
    always = _derivative(state, kind())
    since = state.case.scene.since
    return [Group(kind.name, always * since(d)[:, None], replace(kind(), date_s=float(d))) for d in dates_s]  # type: ignore[call-arg]


def dates(time_s: Floats) -> Floats:
    """Return the dates of steps that are tried, (m,)."""
    first, last = np.quantile(time_s, [DATE_MARGIN, 1.0 - DATE_MARGIN])
    return np.arange(first, last, max(DATE_STEP_S, (last - first) / 60.0))


def omnibus(state: State) -> list[Group]:
    """Return splines and thresholds of each covariate, harmonics and hats of the heading, and products."""
    found, groups = state.case.covariates, []
    heading = state.case.recorded_deg
    each = [
        periodic(heading, range(3, 7)),
        heading_hats(heading, HEADING_HAT_DEG, FEWEST_IN_HAT),
        periodic(heading, range(7, TEETH + 1)),
    ]
    groups += [Group("heading", hats, covariates=("heading",)) for hats in each]
    for name, column in found.items():
        if name in PERIODS:
            groups.append(Group(name, periodic(360.0 / PERIODS[name] * column, range(1, 4)), covariates=(name,)))
        elif name == "time":
            groups += [Group(name, hats(column, k), covariates=(name,)) for k in TIME_KNOTS]
            groups += [*waves(column), *spells(state)]
            tides = [periodic(360.0 * column / (3600.0 * hours), range(1, 2)) for hours in TIDES_H]
            groups += [Group(name, tide, covariates=(name,)) for tide in tides]
        elif name != "heading" and name not in stuck.LEANS:
            groups.append(Group(name, hats(column, KNOTS), covariates=(name,)))
            groups += [Group(name, step, covariates=(name,)) for step in _steps(column)]
    linear = {name: standard(found[name]) for name in LINEAR if name in found}
    turning = np.column_stack([np.ones(len(heading)), periodic(heading, range(1, 4))])
    for name, column in linear.items():
        groups.append(Group(f"heading x {name}", turning * column[:, None], covariates=("heading", name)))
    for (a, x), (b, y) in itertools.combinations(linear.items(), 2):
        both = [u * v for u in _bent(x) for v in _bent(y)]
        groups.append(Group(f"{a} x {b}", np.column_stack(both), covariates=(a, b)))
    return [replace(group, columns=_well_seen(group.columns)) for group in groups]


def waves(time_s: Floats) -> list[Group]:
    """Return one wave a group: what swings with one period is faint among all knots."""
    turns = 360.0 * (time_s - time_s[0]) / np.ptp(time_s)
    each = [periodic(turns, range(k, k + 1)) for k in range(1, int(np.ptp(time_s) / SHORTEST_WAVE_S) + 1)]
    return [Group("time", wave, covariates=("time",)) for wave in each]


def spells(state: State) -> list[Group]:
    """Return offsets of the reading with a begin and an end, each a group: among all knots they are faint."""
    time_s = state.case.scene.time_s
    begins = np.arange(time_s[0], time_s[-1], max(SPELL_STEP_S, float(np.ptp(time_s)) / 120.0))[1:]
    tried = [group.columns for group in of_dates(state, HeadingSlip, begins)]
    both = [(first, last) for length in SPELLS for first, last in zip(tried, tried[length:], strict=False)]
    return [Group(SPELL, first - last, covariates=("time",)) for first, last in both]


def _derivative(state: State, term: Term) -> Floats:
    columns = composition.beside(state.simulation, state.case.scene, state.heading_deg, term)
    return np.where(np.isfinite(columns), columns, 0.0)


def _well_seen(columns_deg: Floats) -> Floats:
    """Return combinations of columns without those that only a few samples at the edge of what occurs would tell.

    Of 36 harmonics over headings that spread by 34 degrees 22 are left; among the others single samples decide.
    """
    if columns_deg.shape[1] < 2:
        return columns_deg
    unit = columns_deg / np.maximum(np.linalg.norm(columns_deg, axis=0), 1e-300)
    values, vectors = np.linalg.eigh(unit.T @ unit)
    return np.asarray(unit @ vectors[:, values > FAINTEST * values[-1]] * np.sqrt(len(unit)))


def _steps(x: Floats) -> list[Floats]:
    """Return what sets in beyond a threshold, each alone: where a covariate has a long tail, hats do not turn there."""
    return [(x > threshold)[:, None].astype(float) for threshold in np.unique(np.quantile(x, THRESHOLDS))]


def _bent(x: Floats) -> tuple[Floats, Floats]:
    """Return a standardised series and its square's departure."""
    return x, x**2 - np.mean(x**2)
