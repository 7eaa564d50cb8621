"""A recording compared with its simulation: what every search starts from, and the findings made of its terms.

Hypotheses of a long record are weighed by the slopes of their columns, beside slow noise (``long_record``); those of a
short one, whose effects may be a thousand times its noise, are each refitted in the forward model (``short_fit``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from compasslib import angles, compass
from compasslib.deviation.likelihood import scatter_widths
from compasslib.deviation.model import CoefficientPrior, DeviationFit, nearest_root, observed_heading, pair_speeds
from compasslib.effects import COMPOSED, Effect, Scene, all_effects
from compasslib.effects.composed import TIDE_S, ComposedEffect
from compasslib.effects.effect import HOUR_S
from compasslib.effects.forward import ForwardModel, heading_jacobian, invert_heading
from compasslib.effects.iron import Heeling
from compasslib.inference import covariates as covariate_series
from compasslib.inference import finding as findings
from compasslib.inference import wording
from compasslib.inference.finding import BinnedResidual, CovariateRange, Finding, HeldOut, Parameter, Unexplained
from compasslib.records import EarthField, Pairs
from compasslib.statistics.whitening import LowRankNoise
from compasslib.types import Floats

BAND_SIGMAS = 2.5  # standard errors by which a bin leaves the band

TILT_HIGHPASS_HOURS = 6.0  # tilts faster than this are mostly the sensor's and the waves'
TIDE_PERIODS_H = (TIDE_S / HOUR_S, 12.0, 12.6583, 23.9345, 25.8193)  # periods of M2, S2, N2, K1, O1
LEAST_SPREAD = 1e-9  # of a column, rounding aside: sampled exactly twice a day the tide of the sun is a constant
TIDE_RESOLVING_STEP_S = 3 * 3600.0  # sampling that still follows them
LEAST_WAVE_SPREAD = (
    0.1  # standard deviation of a wave of the tide: one that stands nearly still is a mean shear, and A's
)
CANCELS = "it acts on both compasses alike and cancels in the difference of their directions"
IN_FITTED_IRON = "constant errors of the tilts turn the heading as iron does: B and C of the fitted curve contain them"
CONSTANT_IN_A = "a constant declination error cannot be separated from A, a mean directional shear or a mounting offset"
CONSTANT_REFERENCE = "the reference's file has no heading that varies"
MISSING_SERIES = {
    "temperature": "no temperature that varies was logged",
    "supply_voltage": "no supply voltage that varies was logged",
    "battery_number": "the supply voltage shows no battery change",
    "declination_observatory": "no observatory series given",
    "horizontal_observatory": "no observatory series given",
    "storm_index": "no observatory series given",
    "separation": "the distance between the two layers does not vary",
    "depth": "the depth does not vary",
    "turn_rate": "the pairs are too far apart in time to show how fast the instrument turns",
    "lean_pitch": "the tilts are never stuck for ten days, or too few of them move",
    **dict.fromkeys(
        ("flow_east", "body_flow_sine", "body_flow_sine2"),
        "the pairs are too far apart in time to predict the flow's direction from the hours before",
    ),
    "reference_sine": CONSTANT_REFERENCE,
    "reference_flow_sine": f"{CONSTANT_REFERENCE}, or the pairs are too far apart in time",
    "reference_flow_sine2": f"{CONSTANT_REFERENCE}, or the pairs are too far apart in time",
    "exact_minus_series": "the fit is the exact compass already",
}


# Information (k, k) and score (k,) of each term's parameters by other records of the same compass, in their units.
SharedInformation = Mapping[type[Effect], tuple[Floats, Floats]]

FEWEST_PAIRS, SHORTEST_DAYS = 200, 20.0  # below which an effect is not told from the water


@dataclass(frozen=True)
class Options:
    """What may be chosen about a diagnosis."""

    min_effect_deg: float = 0.5  # visible size, rms, below which a mismatch does not matter
    apply: bool = True  # whether findings on the compass side are handed to the correction
    alarm: float = 0.006  # probability that noise alone gives an unexplained mismatch, or a name of a short record
    prior_odds: float = 1.0  # of a fault of compass or clock in a long record, beforehand
    surrogates: int = 19  # of a record without an effect, by which a finding is held against chance
    reference_magnetic: bool = True  # whether the reference has a compass too
    share: bool = False  # whether to collect information for other records of the compass


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """A recording held against its simulation; n samples in the order of time."""

    time_s: Floats  # (n,) increasing: UTC seconds, or the number of the reading where there is no clock
    terms: tuple[type[Effect], ...]  # that can be tested
    covariates: Mapping[str, Floats]  # (n,) each; what the omnibus tests look along
    not_testable: tuple[tuple[str, str], ...] = ()  # (effect, why)
    units: Mapping[str, str] = field(default_factory=dict)  # of covariates that have no name of their own here
    what: str = ""  # is compared, in words, where a recording may hold several comparisons
    clocked: bool = True  # whether its times are UTC

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time."""
        return float(self.time_s[0]), float(self.time_s[-1])

    def unit(self, term: Effect, k: int) -> tuple[float, str]:
        """Give the factor and the unit by which a parameter is shown."""
        return 1.0, self.driven(term, term.units()[k])

    def driven(self, term: Effect, unit: str) -> str:
        """Replace a driver's name in a unit by the driver's own unit."""
        if isinstance(term, ComposedEffect):
            for driver in term.composition[1].split("*"):
                driver_unit = self.units.get(driver, driver)
                unit = unit.replace(
                    driver, f"({driver_unit})" if "/" in driver_unit or " " in driver_unit else driver_unit
                )
        return unit

    def where(self, name: str, span: tuple[float, float] | None = None) -> CovariateRange:
        """Describe a range of a covariate, by default the one that it covers."""
        low, high = span or tuple(np.quantile(self.covariates[name], findings.SHOWN_QUANTILES).tolist())
        text = wording.range_text(name, low, high, on_land=bool(self.what), clocked=self.clocked)
        return CovariateRange(name, low, high, text)

    def outside(self, curve: BinnedResidual) -> CovariateRange:
        """Describe the range in which a binned residual leaves its band; all of the covariate where no bin does."""
        far = np.abs(curve.before_deg) > BAND_SIGMAS * curve.sigma_deg
        if not far.any() or len(curve.centre) < 2:
            return self.where(curve.covariate)
        column, inside = self.covariates[curve.covariate], curve.centre[far]
        half = np.median(np.diff(curve.centre)) / 2.0
        low, high = max(inside.min() - half, column.min()), min(inside.max() + half, column.max())
        return self.where(curve.covariate, (float(low), float(high)))

    def since(self, date_s: float) -> CovariateRange:
        """Describe the time from a date on."""
        last = self.span_s[1]
        if self.clocked:
            return CovariateRange("time", date_s, last, f"from {wording.date_text(date_s, last - self.span_s[0])} on")
        first = float(self.time_s[np.searchsorted(self.time_s, date_s)])
        return CovariateRange("reading", first, last, f"from reading {first:.0f} on")

    def main_covariate(self, term: Effect) -> str:
        """Choose the covariate along which an effect shows: of those it depends on the one that varies most."""
        listed = term.needs if isinstance(term, ComposedEffect) else wording.SHOWN_ALONG.get(term.name, ("time",))
        known = [name for name in listed if name in self.covariates]
        known = [name for name in known if name in term.needs] or known
        known = known or [name for name in ("time", "reading") if name in self.covariates] or list(self.covariates)
        return max(known, key=lambda name: float(np.std(self.covariates[name])))

    def unexplained(
        self,
        curves: Sequence[BinnedResidual],
        size_deg: float,
        named: Sequence[str],
        place: CovariateRange | None = None,
    ) -> Unexplained:
        """Describe the mismatch that the named terms leave: where, how large, its empirical curve.

        Args:
            curves: along its covariates.
            size_deg: visible size, rms.
            named: effects that stand beside it.
            place: where it is known; else where the curves leave their bands.
        """
        places = [place] if place else [self.outside(curve) for curve in curves]
        dates = next(((where.low, where.high) for where in places if where.covariate == "time"), self.span_s)
        text = wording.unexplained_text(" and ".join(where.text for where in places), size_deg, named)
        covariates = tuple(curve.covariate for curve in curves)
        return Unexplained(covariates, places[0], dates if self.clocked else None, size_deg, tuple(curves), text)


@dataclass(frozen=True, kw_only=True)
class LongComparison(Comparison):
    """A recording of weeks or years held against its simulation; n samples in the order of time."""

    simulation: ForwardModel  # what the recording is held against
    scene: Scene  # in what it was made, with the departures that terms need
    recorded_deg: Floats  # (n,) heading that the affected compass gave
    observed_deg: Floats  # (n,) heading that the reference's side shows
    slowness: Floats  # (n,) what widens the scatter, 1/speed; 0 where nothing does
    expected_deg: (
        Floats  # (n,) width of the scatter as the fit has it; two headings nearer than a few are not told apart
    )
    precision_deg: float  # noise of the recorded heading itself
    nuisance: Floats  # (n, k) columns that are fitted and never named
    has_slow_noise: bool = True  # whether slow water of two depths may stand between both sides
    low_rank: LowRankNoise | None = None  # slow water, once it was learnt
    usual: Mapping[type[Effect], Floats] = field(default_factory=dict)  # standard deviation expected of each parameter
    prior: CoefficientPrior | None = None  # what other records of the compass tell of A..E
    shared: SharedInformation = field(default_factory=dict)  # and of its effects


def compare_pairs(
    pairs: Pairs,
    logged: Mapping[str, Floats],
    fit: DeviationFit,
    earth: EarthField,
    *,
    reference_magnetic: bool = True,
    units: Mapping[str, str] | None = None,
) -> LongComparison:
    """Compare the overlap of a mooring with its fitted exact compass.

    Args:
        logged: other series at their times, (n,) each.
        reference_magnetic: whether the reference has a compass too.
        units: of series that have no name of their own here; 1 where absent.
    """
    columns = covariate_series.pair_covariates(pairs, logged)
    references = covariate_series.reference_values(columns)
    observed = observed_heading(pairs)
    heading = nearest_root(compass.inverse(fit.coefficients, pairs.heading_deg), observed)
    scene = scene_of_pairs(pairs, columns, references, field=earth, heading_deg=heading)
    simulation = ForwardModel(fit.coefficients, float(np.mean(scene.horizontal_nT)))
    terms, missing = testable_effects(scene, reference_magnetic)
    upper, lower = pair_speeds(pairs)
    return LongComparison(
        time_s=pairs.time_s,
        simulation=simulation,
        scene=scene,
        recorded_deg=pairs.heading_deg,
        observed_deg=observed,
        slowness=np.hypot(1.0 / np.maximum(upper, 1e-3), 1.0 / np.maximum(lower, 1e-3)),
        expected_deg=scatter_widths(fit.noise, upper, lower),
        precision_deg=fit.noise.compass_deg,
        covariates=columns,
        nuisance=_nuisance_columns(pairs, scene, simulation),
        terms=terms,
        not_testable=missing,
        prior=fit.prior,
        units={
            name: (units or {}).get(name, "1")
            for name in logged
            if name in columns and name not in covariate_series.NAMED_SERIES
        },
    )


def scene_of_pairs(
    pairs: Pairs,
    columns: Mapping[str, Floats],
    references: Mapping[str, float],
    *,
    field: EarthField,
    heading_deg: Floats,
) -> Scene:
    """Build the scene in which the pairs were measured."""
    h, z = (np.interp(pairs.time_s, field.time_s, x) for x in (field.horizontal_nT, field.vertical_nT))
    return Scene(
        time_s=pairs.time_s,
        horizontal_nT=h,
        vertical_nT=z,
        pitch_deg=np.nan_to_num(pairs.pitch_deg),
        roll_deg=np.nan_to_num(pairs.roll_deg),
        begin_s=references["time"],
        departures=covariate_series.departures(pairs, columns, references, heading_deg),
    )


def testable_effects(
    scene: Scene, reference_magnetic: bool
) -> tuple[tuple[type[Effect], ...], tuple[tuple[str, str], ...]]:
    """Select the terms that a mooring's record can test; give the reason for every other."""
    terms, missing = [], []
    for term in all_effects():
        if "mooring" not in term.recordings or term.acts_on == "time":
            continue
        absent = [name for name in term.needs if name not in scene.departures]
        if term.name == "declination_error":
            missing.append((term.name, CONSTANT_IN_A))
        elif term.name == "tilt_offset":
            missing.append((term.name, IN_FITTED_IRON))
        elif term.acts_on == "north" and reference_magnetic:
            missing.append((term.name, CANCELS))
        elif absent:
            missing.append((term.name, MISSING_SERIES.get(absent[0], f"no {absent[0].replace('_', ' ')} was logged")))
        elif term.name in ("heeling", "tilt_uncompensated") and np.ptp(scene.pitch_deg) + np.ptp(scene.roll_deg) == 0.0:
            missing.append((term.name, "no tilt that varies was logged"))
        elif not term.detector:
            terms.append(term)
    return tuple(terms), tuple(dict.fromkeys(missing))


def _nuisance_columns(pairs: Pairs, scene: Scene, simulation: ForwardModel) -> Floats:
    """Build the columns that every overlap has: noise of the tilt sensor through Z, and the flow's rate of turn.

    The noise of a recorded tilt stands in the heading and in the tilt alike; on the fast part of the tilt it looks
    like heeling. A clock, or water that arrives at one depth later, shows as the rate of turn of the flow, and a clock
    that drifts as the same growing.
    """
    span = max(int(TILT_HIGHPASS_HOURS * 3600.0 / np.median(np.diff(pairs.time_s))), 1)
    fast, n = [], len(scene.pitch_deg)
    first, last = np.maximum(np.arange(n) - span, 0), np.minimum(np.arange(n) + span + 1, n)
    for tilt in (scene.pitch_deg, scene.roll_deg):
        summed = np.concatenate([[0.0], np.cumsum(tilt)])
        fast.append(tilt - (summed[last] - summed[first]) / (last - first))
    wobble = Scene(scene.time_s, scene.horizontal_nT, scene.vertical_nT, fast[0], fast[1], scene.begin_s)
    vertical = ForwardModel(simulation.coefficients, simulation.horizontal_nT, (Heeling(),))
    heading = invert_heading(simulation, scene, pairs.heading_deg)[:, 0]
    noise = heading_jacobian(vertical, wobble, heading, first=5) * scene.vertical_nT[:, None]
    turning = scene.departures["flow_turn"]
    columns = np.column_stack([np.nan_to_num(noise), turning, turning * scene.years, _aliased_tides(scene.time_s)])
    return columns[:, columns.std(axis=0) > LEAST_SPREAD]


def _aliased_tides(time_s: Floats) -> Floats:
    """Build waves of the tides where they are sampled too rarely to be resolved, else none, (n, k).

    A profiler that passes twice a day sees the tides' directional shear as waves of weeks to a year, and that of the
    sun's tide as very nearly a constant. The mean of each wave is A's, as any mean shear is, and what hardly varies
    beside it is left out: else nothing would be known of A.
    """
    if np.median(np.diff(time_s)) < TIDE_RESOLVING_STEP_S:
        return np.zeros((len(time_s), 0))
    waves = tide_waves(time_s)
    return np.asarray((waves - waves.mean(axis=0))[:, waves.std(axis=0) > LEAST_WAVE_SPREAD])


def tide_waves(time_s: Floats) -> Floats:
    """Build sine and cosine of the five largest tides, (n, 10)."""
    return np.column_stack(angles.sin_cos(360.0 * (time_s - time_s[0])[:, None] / 3600.0 / np.array(TIDE_PERIODS_H)))


def held_out_text(proof: HeldOut, heading_error_deg: float | None) -> str:
    """State the size on held-out days beside the prediction, its rank, and the heading error without the effect."""
    texts = []
    if proof.amplitude is not None:
        size = (
            " On held-out days, everything chosen anew, its size is {held_out:.1f}° ({low:.1f} to {high:.1f}°, 95 %), "
            "where the other days predict {fitted_elsewhere:.1f}°".format(**vars(proof.amplitude))
        )
        rank = wording.rank_text(vars(proof.placebo)) if proof.placebo else ""
        texts.append(size + (f", {rank} records simulated without it." if rank else "."))
        texts += [] if proof.confirmed else [" So held-out days do not confirm it."]
    if heading_error_deg is not None:
        texts.append(f" Without it headings would be wrong by {heading_error_deg:.1f}° rms.")
    return "".join(texts)


def build_finding(
    comparison: Comparison,
    term: Effect,
    chances: Mapping[str, float],
    parameters: Mapping[str, Parameter],
    *,
    size_deg: float,
    proof: HeldOut,
    place: CovariateRange,
    span_s: tuple[float, float] | None = None,
    heading_error_deg: float | None = None,
    others: Sequence[Effect] = (),
) -> Finding:
    """Build the finding of one term of the likeliest hypothesis.

    Args:
        chances: probability of the effect, which is first, and of what else may stand in its place.
        parameters: by name, for people.
        size_deg: visible size, rms.
        place: where it shows; of a term with a date, since then.
        span_s: when it acts, where that is not always.
        heading_error_deg: rms error that headings would have without it.
        others: the other terms of the hypothesis. A composed term that shares its driver with another one means that
            neither has the right form: only the driver is established.
    """
    probability, alternatives = next(iter(chances.values())), dict(list(chances.items())[1:])
    effect, composition = _name_and_composition(term)
    begin, end = span_s or comparison.span_s
    if term.dated():
        begin, place = term.date, comparison.since(term.date)
    physics = " changes ".join(wording.describe_composition(*composition.values())) if composition else term.words
    text = wording.finding_text(
        term.name,
        tuple(alternatives),
        where=place.text,
        parameters={name: (parameter.value, parameter.sigma, parameter.unit) for name, parameter in parameters.items()},
        size_deg=size_deg,
        proof=None if proof.amplitude else (proof.rms_before_deg, proof.rms_after_deg, proof.p_value),
        physics=f"{physics}, which no listed effect does" if composition else physics,
        what=comparison.what,
    )
    made = Finding(
        effect=effect,
        side=term.side,
        driver=term.driver,
        alternatives=tuple(alternatives),
        where=place,
        when_s=(begin, end) if comparison.clocked else None,
        parameters=parameters,
        rms_effect_deg=size_deg,
        held_out=proof,
        text=text,
        probability=probability,
        alternatives_probability=alternatives,
        composition=composition,
        heading_error_deg=heading_error_deg,
        shares_driver=any(_share_driver(term, other) for other in others),
    )
    stated = made.statement
    text += held_out_text(proof, heading_error_deg)
    if made.shares_driver:
        text += " Another term with the same driver is fitted beside it: neither has the right form by itself."
    text += wording.level_text(stated.level, stated.probability, stated.side, stated.driver)
    return replace(made, text=text)


def large_deviation_finding(size_deg: float, proof: HeldOut, *, what: str = "") -> Finding:
    """Build the finding that the exact compass fits where the five-term series does not."""
    effect, place = "large_deviation", CovariateRange("heading", 0.0, 360.0, "along the recorded heading")
    shown = (proof.rms_before_deg, proof.rms_after_deg, proof.p_value)
    text = wording.finding_text(effect, (), where=place.text, parameters={}, size_deg=size_deg, proof=shown, what=what)
    return Finding(effect, "compass", (), place, None, {"share": Parameter(1.0, 0.0, "1")}, size_deg, proof, text)


def _share_driver(term: Effect, other: Effect) -> bool:
    drivers = {findings.TILTS.get(each.driver, each.driver) for each in (term, other)}
    composed = [_name_and_composition(each)[1] for each in (term, other)]
    return term.side == other.side and len(drivers) == 1 and any(composed)


def _name_and_composition(term: Effect) -> tuple[str, dict[str, str] | None]:
    if not isinstance(term, ComposedEffect) or not term.name.startswith(COMPOSED):
        return term.name, None
    return "composed", dict(zip(("acts_on", "driver", "form"), term.said(), strict=True))
