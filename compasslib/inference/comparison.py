"""Comparison of a recording with its simulation, the input of every search, and the findings built from its terms.

Both kinds of recordings are searched with one linear Gaussian model: long ones have slow noise (``linear_model``); in
short ones effects may exceed the noise a thousandfold; each form is refitted in the forward model (``short_model``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from compasslib import angles, compass
from compasslib.deviation.likelihood import scatter_widths
from compasslib.deviation.model import CoefficientPrior, DeviationFit, nearest_root, observed_heading, pair_speeds
from compasslib.effects import COMPOSED, Effect, Scene, all_effects, meanings
from compasslib.effects.composed import TIDE_S, ComposedEffect
from compasslib.effects.effect import HOUR_S
from compasslib.effects.forward import ForwardModel, heading_jacobian, invert_heading
from compasslib.effects.iron import Heeling
from compasslib.effects.readout import LargeDeviation
from compasslib.inference import covariates as covariate_series
from compasslib.inference import finding as findings
from compasslib.inference import wording
from compasslib.inference.finding import BinnedResidual, CovariateRange, Finding, HeldOut, Parameter, Unexplained
from compasslib.records import EarthField, Pairs, SlowShear
from compasslib.statistics.whitening import LowRankNoise
from compasslib.types import Floats

BAND_SIGMAS = 2.5  # standard errors beyond which a bin is outside its band

TILT_HIGHPASS_HOURS = 6.0  # tilt variations faster than this are mostly sensor noise and waves
TIDE_PERIODS_H = (TIDE_S / HOUR_S, 12.0, 12.6583, 23.9345, 25.8193)  # periods of M2, S2, N2, K1, O1
LEAST_SPREAD = 1e-9  # of a column, to exclude constants: S2 sampled exactly twice a day is one up to rounding
TIDE_RESOLVING_STEP_S = 3 * 3600.0  # longest sampling interval that resolves the tides
# Least standard deviation of an aliased tidal wave: a nearly constant one cannot be separated from A or a mean shear.
LEAST_WAVE_SPREAD = 0.1
CANCELS = "it acts on both compasses alike and cancels in the difference of their directions"
IN_FITTED_IRON = "constant errors of the tilts turn the heading as iron does: B and C of the fitted curve contain them"
CONSTANT_IN_A = "a constant declination error cannot be separated from A, a mean directional shear or a mounting offset"
CONSTANT_REFERENCE = "the reference's file has no heading that varies, or that of a vane, which follows the flow"
UNTESTABLE = {"declination_error": CONSTANT_IN_A, "tilt_offset": IN_FITTED_IRON}
MISSING_SERIES = {
    "battery_number": "the supply voltage shows no battery change",
    "declination_observatory": "no observatory series given",
    "horizontal_observatory": "no observatory series given",
    "storm_index": "no observatory series given",
    "separation": "the distance between the two layers does not vary",
    "turn_rate": "the pairs are too far apart in time to show how fast the instrument turns",
    "lean_pitch": "the tilts are never stuck for ten days, or too few of them move",
    **dict.fromkeys(("reference_sine", "reference_flow_sine", "reference_flow_sine2"), CONSTANT_REFERENCE),
    "exact_minus_series": "the fit is the exact compass already",
}
APPROXIMATE = {  # by the deepest level that can be stated beside other effects
    "driver": " Another term with the same driver is fitted beside it: neither has the right form by itself.",
    "side": " Other effects are fitted beside it, and the form of one of them is only approximate: what that form does "
    "not explain may follow the driver of another.",
}


# Information (k, k) and score (k,) of each term's parameters from other records of the same compass, in their units.
SharedInformation = Mapping[type[Effect], tuple[Floats, Floats]]

FEWEST_PAIRS, SHORTEST_DAYS = 200, 20.0  # least record in which an effect can be distinguished from directional shear


@dataclass(frozen=True)
class Options:
    """Options of a diagnosis."""

    min_effect_deg: float = 0.5  # visible size, degrees rms, below which a mismatch is negligible
    apply: bool = True  # whether findings on the compass side are corrected
    prior_odds: float = 1.0  # of a fault of compass or clock
    surrogates: int = 199  # simulated records without an effect, against which its evidence and its gain are ranked
    reference_magnetic: bool = True  # whether the reference has a magnetic compass too
    share: bool = False  # whether to collect information for other records of the compass
    clock_sigmas: float = findings.NAMED_SIGMAS  # normal score from which a clock error is named


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """A recording and what its search needs; n samples in the order of time."""

    time_s: Floats  # (n,) increasing: UTC seconds, or the number of the reading if there is no clock
    terms: tuple[type[Effect], ...]  # effects that can be tested
    covariates: Mapping[str, Floats]  # (n,) each, along which a mismatch is searched and shown
    not_testable: tuple[tuple[str, str], ...] = ()  # (effect, reason)
    units: Mapping[str, str] = field(default_factory=dict)  # of instrument-specific covariates, by name
    what: str = ""  # description of the comparison, if the recording may contain several
    clocked: bool = True  # whether the times are UTC

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time."""
        return float(self.time_s[0]), float(self.time_s[-1])

    def unit(self, term: Effect, k: int) -> tuple[float, str]:
        """Give the factor and the unit in which a parameter is reported."""
        return 1.0, self.driven(term, term.units()[k])

    def driven(self, term: Effect, unit: str) -> str:
        """Replace a driver's name in a unit by the driver's own unit."""
        if isinstance(term, ComposedEffect):
            for driver in term.composition[1].split("*"):
                own = self.units.get(driver, driver)
                unit = unit.replace(driver, f"({own})" if "/" in own or " " in own else own)
        return unit

    def where(self, name: str, span: tuple[float, float] | None = None) -> CovariateRange:
        """Describe a range of a covariate, by default the one that most of its values cover."""
        span = span or (self.span_s if name == "time" else None)  # a cause along time has no usual range
        low, high = span or tuple(np.quantile(self.covariates[name], findings.SHOWN_QUANTILES).tolist())
        text = wording.range_text(name, low, high, on_land=bool(self.what), clocked=self.clocked)
        return CovariateRange(name, low, high, text)

    def outside(self, curve: BinnedResidual) -> CovariateRange:
        """Describe the range in which a binned residual is outside its band, the whole range if no bin is."""
        far = np.abs(curve.before_deg) > BAND_SIGMAS * curve.sigma_deg
        if not far.any() or len(curve.centre) < 2:
            return self.where(curve.covariate)
        column, inside = self.covariates[curve.covariate], curve.centre[far]
        half = np.median(np.diff(curve.centre)) / 2.0
        low, high = max(inside.min() - half, column.min()), min(inside.max() + half, column.max())
        return self.where(curve.covariate, (float(low), float(high)))

    def since(self, date_s: float) -> CovariateRange:
        """Describe the period from a date to the end of the recording."""
        last = self.span_s[1]
        if self.clocked:
            return CovariateRange("time", date_s, last, f"from {wording.date_text(date_s, last - self.span_s[0])} on")
        first = float(self.time_s[np.searchsorted(self.time_s, date_s)])
        return CovariateRange("reading", first, last, f"from reading {first:.0f} on")

    def main_covariate(self, term: Effect) -> str:
        """Choose the covariate along which an effect is shown: the most variable of those it depends on."""
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
        """Describe a mismatch beyond named effects: its curve, and its place, by default outside the curve's bands."""
        places = [place] if place else [self.outside(curve) for curve in curves]
        dates = next(((where.low, where.high) for where in places if where.covariate == "time"), self.span_s)
        text = wording.unexplained_text(" and ".join(where.text for where in places), size_deg, named)
        covariates = tuple(curve.covariate for curve in curves)
        return Unexplained(covariates, places[0], dates if self.clocked else None, size_deg, tuple(curves), text)


@dataclass(frozen=True, kw_only=True)
class LongComparison(Comparison):
    """A recording of weeks or years with its simulation; n samples in the order of time."""

    simulation: ForwardModel  # the fitted compass with which the recording is compared
    scene: Scene  # conditions of the recording, with the departures that terms need
    recorded_deg: Floats  # (n,) heading recorded by the affected compass
    observed_deg: Floats  # (n,) heading derived from the reference
    slowness: Floats  # (n,) 1/speed, with which the scatter grows; 0 where it does not
    # (n,) width of the scatter according to the fit, by which the branches of a two-valued compass are distinguished
    expected_deg: Floats
    precision_deg: float  # noise of the recorded heading itself
    nuisance: Floats  # (n, k) columns that are fitted and never reported
    low_rank: LowRankNoise | None = None  # the slow noise, once estimated
    slow_shear: SlowShear | None = None  # as a profile shows it; None if none does
    usual: Mapping[type[Effect], Floats] = field(default_factory=dict)  # prior standard deviation of each parameter
    prior: CoefficientPrior | None = None  # of A..E, from other records of the compass
    shared: SharedInformation = field(default_factory=dict)  # on effects, from other records of the compass
    reference_turns: tuple[Floats, Floats] | None = None  # dates, and log likelihood ratio of a turn of the reference


def compare_pairs(
    pairs: Pairs,
    logged: Mapping[str, Floats],
    fit: DeviationFit,
    earth: EarthField,
    *,
    reference_magnetic: bool = True,
    units: Mapping[str, str] | None = None,
) -> LongComparison:
    """Compare the overlap of a mooring, with other logged series at its times, with the fitted exact compass.

    Args:
        reference_magnetic: whether the reference has a magnetic compass too.
        units: units of instrument-specific series, by name; 1 where absent.
    """
    columns = covariate_series.pair_covariates(pairs, logged)
    references = covariate_series.reference_values(columns)
    observed = observed_heading(pairs)
    heading = nearest_root(compass.inverse(fit.coefficients, pairs.heading_deg), observed)
    h, z = (np.interp(pairs.time_s, earth.time_s, x) for x in (earth.horizontal_nT, earth.vertical_nT))
    scene = Scene(
        time_s=pairs.time_s,
        horizontal_nT=h,
        vertical_nT=z,
        pitch_deg=np.nan_to_num(pairs.pitch_deg),
        roll_deg=np.nan_to_num(pairs.roll_deg),
        begin_s=references["time"],
        departures=covariate_series.departures(pairs, columns, references, heading),
    )
    simulation = ForwardModel(fit.coefficients, float(np.mean(scene.horizontal_nT)))
    terms, missing = testable_effects(scene, reference_magnetic)
    upper, lower = pair_speeds(pairs)
    unnamed = [name for name in logged if name in columns and name not in covariate_series.NAMED_SERIES]
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
        slow_shear=pairs.slow_shear,
        reference_turns=covariate_series.reference_turns(pairs, angles.difference(observed, heading)),
        units={name: (units or {}).get(name, "1") for name in unnamed},
    )


def testable_effects(
    scene: Scene, reference_magnetic: bool
) -> tuple[tuple[type[Effect], ...], tuple[tuple[str, str], ...]]:
    """Select the terms that can be tested in a mooring's record, and give the reason for every other."""
    terms, missing = [], []
    for term in all_effects():
        if "mooring" not in term.recordings or term.acts_on == "time":
            continue
        absent = [name for name in term.needs if name not in scene.departures]
        if term.name in UNTESTABLE:
            missing.append((term.name, UNTESTABLE[term.name]))
        elif term.acts_on == "north" and reference_magnetic:
            missing.append((term.name, CANCELS))
        elif absent:
            general = f"no {absent[0].replace('_', ' ')} that varies was logged"
            missing.append((term.name, MISSING_SERIES.get(absent[0], general)))
        elif term.name in ("heeling", "tilt_uncompensated") and np.ptp(scene.pitch_deg) + np.ptp(scene.roll_deg) == 0.0:
            missing.append((term.name, "no tilt that varies was logged"))
        elif not term.detector:
            terms.append(term)
    return tuple(terms), tuple(dict.fromkeys(missing))


def _nuisance_columns(pairs: Pairs, scene: Scene, simulation: ForwardModel) -> Floats:
    """Build the nuisance columns of every overlap: tilt sensor noise, rate of turn of the flow, aliased tides.

    Noise of the tilt sensor enters both tilt and heading, so that the fast part of the tilt resembles heeling. A clock
    offset, or a current that changes later at one depth, is proportional to the rate of turn of the flow, a clock drift
    to this rate times time.
    """
    span = max(int(TILT_HIGHPASS_HOURS * 3600.0 / np.median(np.diff(pairs.time_s))), 1)
    number, kept = np.arange(len(scene), dtype=float), 2.0 * span + 1.0
    tilts = (scene.pitch_deg, scene.roll_deg)
    pitch, roll = (tilt - covariate_series.running_mean(tilt, number, kept) for tilt in tilts)
    wobble = Scene(scene.time_s, scene.horizontal_nT, scene.vertical_nT, pitch, roll, scene.begin_s)
    vertical = ForwardModel(simulation.coefficients, simulation.horizontal_nT, (Heeling(),))
    heading = invert_heading(simulation, scene, pairs.heading_deg)[:, 0]
    noise = heading_jacobian(vertical, wobble, heading, first=5) * scene.vertical_nT[:, None]
    turning = scene.departures["flow_turn"]
    columns = np.column_stack([np.nan_to_num(noise), turning, turning * scene.years, _aliased_tides(scene.time_s)])
    return columns[:, columns.std(axis=0) > LEAST_SPREAD]


def _aliased_tides(time_s: Floats) -> Floats:
    """Build sine and cosine columns of aliased tides, (n, k); k is 0 if the sampling resolves the tides.

    A profiler that passes twice a day aliases the tidal directional shear to periods of weeks to a year, that of S2 to
    nearly a constant. The mean of each wave belongs to A, as any mean shear does, and waves that hardly vary are left
    out: otherwise A would be undetermined.
    """
    if np.median(np.diff(time_s)) < TIDE_RESOLVING_STEP_S:
        return np.zeros((len(time_s), 0))
    waves = tide_waves(time_s)
    return np.asarray((waves - waves.mean(axis=0))[:, waves.std(axis=0) > LEAST_WAVE_SPREAD])


def tide_waves(time_s: Floats) -> Floats:
    """Build sine and cosine columns of the five largest tidal constituents, (n, 10)."""
    return np.column_stack(angles.sin_cos(360.0 * (time_s - time_s[0])[:, None] / 3600.0 / np.array(TIDE_PERIODS_H)))


def held_out_text(proof: HeldOut, heading_error_deg: float | None) -> str:
    """State held-out and predicted size of an effect, the rank of its gain, and the heading error without it."""
    text = ""
    if proof.amplitude is not None:
        text = (
            " On held-out days, with the whole selection repeated, its size is {held_out:.1f}° ({low:.1f} to "
            "{high:.1f}°, 95 %), where the other days predict {fitted_elsewhere:.1f}°".format(**vars(proof.amplitude))
        )
        rank = wording.rank_text(vars(proof.placebo)) if proof.placebo and proof.amplitude.held_out > 0.0 else ""
        text += (f", {rank} records simulated without it." if rank else ".") + (
            "" if proof.confirmed else " So held-out days do not confirm it."
        )
    if heading_error_deg is not None:
        text += f" Without this correction headings would be wrong by {heading_error_deg:.1f}° rms."
    return text


def _finding_text(made: Finding, effect: str, physics: str, what: str) -> str:
    """Describe one finding in two or three sentences; ``effect`` is the name of its term."""
    proof, known, numbers = made.held_out, meanings(effect), ""
    where = f"{what}, {made.where.text}" if what else made.where.text
    fitted = {name: parameter for name, parameter in made.parameters.items() if parameter.sigma > 0.0}
    if len(fitted) > 6 or any(name[-1].isdigit() for name in fitted):  # of a smooth curve
        numbers = f"; {len(fitted)} coefficients, in diagnosis.json"
    else:
        for name, parameter in fitted.items():
            interval = f"{float(f'{parameter.value:.3g}'):g} ± {float(f'{1.96 * parameter.sigma:.2g}'):g}"
            meaning = known.get(name, name.removesuffix("_deg").replace("_", " "))
            numbers += f"; {meaning} {interval}{'' if parameter.unit == '1' else f' {parameter.unit}'} (95 %)"
    size_deg = made.rms_effect_deg
    size = f"{size_deg:.1f}" if size_deg >= 1.0 else f"{size_deg:.2g}"
    text = (
        f"{where[0].upper()}{where[1:]}: {physics or wording.PHYSICS.get(effect, effect)}. Size {size}° rms{numbers}."
    )
    if proof is not findings.UNTESTED and proof.method is None:
        before, after, p = proof.rms_before_deg, proof.rms_after_deg, proof.p_value
        least = 1.0 / findings.BOOTSTRAP_DRAWS
        chance = f"p = {p:.2g}" if p > least else f"p < {least:g}"
        stretches = "stretches" if what else "days"
        text += f" On held-out {stretches} the residual goes from {before:.2f}° to {after:.2f}° rms ({chance})."
    if made.alternatives:
        text += f" This record cannot separate it from {wording.join_names(made.alternatives)}."
    text += held_out_text(proof, made.heading_error_deg)
    text += APPROXIMATE.get(made.deepest, "")
    stated = made.statement
    return text + wording.level_text(stated.level, stated.probability, stated.side, stated.driver)


def equal_chances(*effects: str) -> dict[str, float]:
    """Divide the probability of a finding that was made without a search equally between its effects."""
    return dict.fromkeys(effects, 1.0 / len(effects))


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
    physics: str = "",
) -> Finding:
    """Build the finding of one term.

    Args:
        chances: probability of the effect, which comes first, and of each alternative.
        size_deg: visible size, degrees rms.
        place: range in which it shows; replaced by the period from its date on if the term has a date.
        span_s: when it acts; by default throughout.
        others: the other terms of the hypothesis.
        physics: in words; by default that of the effect.
    """
    probability, alternatives = next(iter(chances.values())), dict(list(chances.items())[1:])
    composition = _composition(term)
    when_s = (span_s or comparison.span_s) if comparison.clocked else None
    if term.dated():
        place = comparison.since(term.date)
        when_s = when_s and (term.date, when_s[1])
    if composition:
        words = " changes ".join(wording.describe_composition(*composition.values()))
        physics = f"{words}, which no listed effect does"
    made = Finding(
        effect="composed" if composition else term.name,
        side=term.side,
        driver=term.driver,
        alternatives=tuple(alternatives),
        where=place,
        when_s=when_s,
        parameters=parameters,
        rms_effect_deg=size_deg,
        held_out=proof,
        text="",
        probability=probability,
        alternatives_probability=alternatives,
        composition=composition,
        heading_error_deg=heading_error_deg,
        deepest=_deepest_level(term, [each for each in others if each.side == term.side]),
    )
    return replace(made, text=_finding_text(made, term.name, physics or term.words, comparison.what))


def _deepest_level(term: Effect, others: Sequence[Effect]) -> str:
    """Choose the deepest level that can be stated of a term beside others of its side.

    The form of a composed term is only approximate, and what it does not explain is attributed to whatever varies with
    its driver: the drivers of terms beside it are wrong more often than their probabilities say.
    """
    if not others or not any(_composition(each) for each in (term, *others)):
        return "effect"
    drivers = {findings.TILTS.get(each.driver, each.driver) for each in (term, *others)}
    return "driver" if len(drivers) == 1 else "side"


def _composition(term: Effect) -> dict[str, str] | None:
    """Split a composed effect into target, driver and form; None for those that the catalogue lists."""
    if not isinstance(term, ComposedEffect) or not term.name.startswith(COMPOSED):
        return None
    return dict(zip(("acts_on", "driver", "form"), term.reported_composition(), strict=True))


def large_deviation(comparison: Comparison, size_deg: float, proof: HeldOut) -> Finding:
    """Build the finding that the exact compass fits better than the five-term series."""
    term, place = LargeDeviation(), comparison.where("heading", (0.0, 360.0))
    share = {"share": Parameter(1.0, 0.0, "1")}
    return build_finding(comparison, term, {term.name: 1.0}, share, size_deg=size_deg, proof=proof, place=place)
