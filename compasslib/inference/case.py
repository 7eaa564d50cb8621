"""A long record, its simulation and what was logged beside it: all that the search needs; made of an overlap."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from compasslib import angles, compass
from compasslib.deviation import likelihood, model
from compasslib.deviation.model import Fit
from compasslib.deviation.prior import Prior
from compasslib.effects import Scene, Term, all_terms, composition
from compasslib.effects.composed import TIDE_S
from compasslib.effects.composition import Simulation
from compasslib.effects.iron import Heeling
from compasslib.effects.term import HOUR_S
from compasslib.inference import covariates
from compasslib.inference.comparison import Comparison
from compasslib.records import EarthField, Pairs
from compasslib.statistics.whitening import Louder
from compasslib.types import Floats

WOBBLE_HOURS = 6.0  # tilts faster than this are mostly the sensor's and the waves'
TIDES_H = (TIDE_S / HOUR_S, 12.0, 12.6583, 23.9345, 25.8193)  # periods of M2, S2, N2, K1, O1
LEAST = 1e-9  # of a column, rounding aside: sampled exactly twice a day the tide of the sun is a constant
TIDES_FOLLOWED_S = 3 * 3600.0  # sampling that still follows them
SEEN = 0.1  # standard deviation of a wave of the tide: one that stands nearly still is a mean shear, and A's
ALIKE = "it acts on both compasses alike and cancels in the difference of their directions"
LEVELLED = "constant errors of the tilts turn the heading as iron does: B and C of the fitted curve contain them"
CONSTANT = "a constant declination error cannot be separated from A, a mean directional shear or a mounting offset"
TRUSTED_STILL = "the reference's file has no heading that varies"
ABSENT = {
    "temperature": "no temperature that varies was logged",
    "supply_voltage": "no supply voltage that varies was logged",
    "battery_number": "the supply voltage shows no battery change",
    "declination_observatory": "no observatory series given",
    "horizontal_observatory": "no observatory series given",
    "storm_index": "no observatory series given",
    "separation": "the distance between the two layers does not vary",
    "depth": "the depth does not vary",
    "lean_pitch": "the tilts are never stuck for ten days, or nothing shows how the instrument leaned then",
    **dict.fromkeys(
        ("flow_east", "body_flow_sine", "body_flow_sine2"),
        "the pairs are too far apart in time to predict the flow's direction from the hours before",
    ),
    "reference_sine": TRUSTED_STILL,
    "reference_flow_sine": f"{TRUSTED_STILL}, or the pairs are too far apart in time",
    "reference_flow_sine2": f"{TRUSTED_STILL}, or the pairs are too far apart in time",
    "exact_minus_series": "the fit is the exact compass already",
}


# Information (k, k) and score (k,) of each term's parameters by other records of the same compass, in their units.
Shared = Mapping[type[Term], tuple[Floats, Floats]]


@dataclass(frozen=True, kw_only=True)
class Case(Comparison):
    """A recording of weeks or years held against its simulation; n samples in the order of time."""

    simulation: Simulation  # what the recording is held against
    scene: Scene  # in what it was made, with the departures that terms need
    recorded_deg: Floats  # (n,) heading that the affected compass gave
    observed_deg: Floats  # (n,) heading that the reference's side shows
    slowness: Floats  # (n,) what widens the scatter, 1/speed; 0 where nothing does
    expected_deg: (
        Floats  # (n,) width of the scatter as the fit has it; two headings nearer than a few are not told apart
    )
    precision_deg: float  # noise of the recorded heading itself
    nuisance: Floats  # (n, k) columns that are fitted and never named
    in_water: bool = True  # whether slow water of two depths may stand between both sides
    louder: Louder | None = None  # slow water, once it was learnt
    usual: Mapping[type[Term], Floats] = field(default_factory=dict)  # standard deviation expected of each parameter
    prior: Prior | None = None  # what other records of the compass tell of A..E
    shared: Shared = field(default_factory=dict)  # and of its effects


def mooring_case(
    pairs: Pairs,
    logged: Mapping[str, Floats],
    fit: Fit,
    earth: EarthField,
    *,
    reference_magnetic: bool = True,
    units: Mapping[str, str] | None = None,
) -> Case:
    """Return the overlap of a mooring held against its fitted exact compass.

    Args:
        logged: other series at their times, (n,) each.
        reference_magnetic: whether the reference has a compass too.
        units: of series that have no name of their own here; 1 where absent.
    """
    columns = covariates.of_pairs(pairs, logged)
    references = covariates.references(columns)
    observed = model.observed_heading(pairs)
    heading = model.nearest_root(compass.inverse(fit.coefficients, pairs.heading_deg), observed)
    scene = scene_of(pairs, columns, references, field=earth, heading_deg=heading)
    simulation = Simulation(fit.coefficients, float(np.mean(scene.horizontal_nT)))
    terms, missing = testable(scene, reference_magnetic)
    upper, lower = model.speeds(pairs)
    return Case(
        time_s=pairs.time_s,
        simulation=simulation,
        scene=scene,
        recorded_deg=pairs.heading_deg,
        observed_deg=observed,
        slowness=np.hypot(1.0 / np.maximum(upper, 1e-3), 1.0 / np.maximum(lower, 1e-3)),
        expected_deg=likelihood.widths(fit.noise, upper, lower),
        precision_deg=fit.noise.compass_deg,
        covariates=columns,
        nuisance=_nuisance(pairs, scene, simulation),
        terms=terms,
        not_testable=missing,
        prior=fit.prior,
        units={
            name: (units or {}).get(name, "1") for name in logged if name in columns and name not in covariates.LISTED
        },
    )


def scene_of(
    pairs: Pairs,
    columns: Mapping[str, Floats],
    references: Mapping[str, float],
    *,
    field: EarthField,
    heading_deg: Floats,
) -> Scene:
    """Return in what the pairs were measured.

    Args:
        columns: covariates, (n,) each.
        references: what the terms' departures count from.
        heading_deg: headings as the fit corrects them, (n,), degrees.
    """
    h, z = (np.interp(pairs.time_s, field.time_s, x) for x in (field.horizontal_nT, field.vertical_nT))
    return Scene(
        time_s=pairs.time_s,
        horizontal_nT=h,
        vertical_nT=z,
        pitch_deg=np.nan_to_num(pairs.pitch_deg),
        roll_deg=np.nan_to_num(pairs.roll_deg),
        begin_s=references["time"],
        departures=covariates.departures(pairs, columns, references, heading_deg),
    )


def testable(scene: Scene, reference_magnetic: bool) -> tuple[tuple[type[Term], ...], tuple[tuple[str, str], ...]]:
    """Return the terms that a mooring's record can be tested for, and which not with the reason.

    Args:
        reference_magnetic: whether the reference has a compass too.
    """
    terms, missing = [], []
    for term in all_terms():
        if "mooring" not in term.recordings or term.acts_on == "time":
            continue
        absent = [name for name in term.needs if name not in scene.departures]
        if term.name == "declination_error":
            missing.append((term.name, CONSTANT))
        elif term.name == "tilt_offset":
            missing.append((term.name, LEVELLED))
        elif term.acts_on == "north" and reference_magnetic:
            missing.append((term.name, ALIKE))
        elif absent:
            missing.append((term.name, ABSENT.get(absent[0], f"no {absent[0].replace('_', ' ')} was logged")))
        elif term.name in ("heeling", "tilt_uncompensated") and np.ptp(scene.pitch_deg) + np.ptp(scene.roll_deg) == 0.0:
            missing.append((term.name, "no tilt that varies was logged"))
        elif not term.found_by:
            terms.append(term)
    return tuple(terms), tuple(dict.fromkeys(missing))


def _nuisance(pairs: Pairs, scene: Scene, simulation: Simulation) -> Floats:
    """Return columns that every overlap has: noise of the tilt sensor through Z, and a rate of turn of the flow.

    The noise of a recorded tilt stands in the heading and in the tilt alike; on the fast part of the tilt it looks
    like heeling. A clock, or water that arrives at one depth later, shows as the rate of turn of the flow, and a clock
    that drifts as the same growing.
    """
    span = max(int(WOBBLE_HOURS * 3600.0 / np.median(np.diff(pairs.time_s))), 1)
    fast = [x - _running_mean(x, span) for x in (scene.pitch_deg, scene.roll_deg)]
    wobble = Scene(scene.time_s, scene.horizontal_nT, scene.vertical_nT, fast[0], fast[1], scene.begin_s)
    vertical = Simulation(simulation.coefficients, simulation.horizontal_nT, (Heeling(),))
    heading = composition.headings(simulation, scene, pairs.heading_deg)[:, 0]
    noise = composition.derivative(vertical, wobble, heading, first=5) * scene.vertical_nT[:, None]
    turning = scene.departures["flow_turn"]
    columns = np.column_stack([np.nan_to_num(noise), turning, turning * scene.years, _standing_tides(scene.time_s)])
    return columns[:, columns.std(axis=0) > LEAST]


def _standing_tides(time_s: Floats) -> Floats:
    """Return waves of the tides where they are sampled too rarely to be followed, else none, (n, k).

    A profiler that passes twice a day sees the tides' directional shear as waves of weeks to a year, and that of the
    sun's tide as very nearly a constant. The mean of each wave is A's, as any mean shear is, and what hardly varies
    beside it is left out: else nothing would be known of A.
    """
    if np.median(np.diff(time_s)) < TIDES_FOLLOWED_S:
        return np.zeros((len(time_s), 0))
    waves = tides(time_s)
    return np.asarray((waves - waves.mean(axis=0))[:, waves.std(axis=0) > SEEN])


def tides(time_s: Floats) -> Floats:
    """Return sine and cosine of the five largest tides, (n, 10)."""
    return np.column_stack(angles.sin_cos(360.0 * (time_s - time_s[0])[:, None] / 3600.0 / np.array(TIDES_H)))


def _running_mean(x: Floats, reach: int) -> Floats:
    summed = np.concatenate([[0.0], np.cumsum(x)])
    first, last = np.maximum(np.arange(len(x)) - reach, 0), np.minimum(np.arange(len(x)) + reach + 1, len(x))
    return (summed[last] - summed[first]) / (last - first)
