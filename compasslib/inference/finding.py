"""Findings of a diagnosis, and the gain on held-out data that supports each of them.

The interval of a gain comes from blocks of days: neighbouring hours repeat each other.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.records import iso_time
from compasslib.statistics.resampling import block_sums
from compasslib.types import Floats

HELD_OUT_BLOCK_S = 10 * 86400.0  # longer than any memory of the water that a filter leaves
FOLDS = 5  # parts of a recording that are left out in turn
SHOWN_QUANTILES = (0.05, 0.95)  # quantiles of a covariate that tell where an effect lives
MOST_WIDTHS = 3.0  # robust widths beyond which a residual counts no more
BOOTSTRAP_DRAWS = 1000  # draws of blocks, which set the smallest p-value
CONFIRMED_P = 0.05  # rank of the gain among surrogates up to which a finding is explained
REFUTED_P = 0.05  # p-value on held-out days above which a finding is refuted where they agree worse
REFUTED_GROWTH = 1.1  # growth of the rms that is no chance of weights: the score, which is judged, clips outliers
SURE = 0.95  # probability from which something is stated
TILTS = {"pitch": "tilt", "roll": "tilt"}  # one driver with two axes
CURVE_BINS = 18  # of a figure's curve
NO_ROOT_DEG = 90.0  # residual of a heading that a fit cannot give
RESIDUAL_MEMORY_S = 2 * 86400.0  # the residual's own memory, for the error of a bin


@dataclass(frozen=True)
class BinnedResidual:
    """The residual along one covariate, before and after; what the fitted compass can take of it is taken."""

    covariate: str  #: name of what it is binned by
    centre: Floats  #: (b,) middle of each bin, in the covariate's unit
    before_deg: Floats  #: (b,) degrees, by the fit alone
    after_deg: Floats  #: (b,) degrees, including the effect
    sigma_deg: Floats  #: (b,) one standard deviation of either
    compared: str = ""  #: what was, where a recording holds more than one comparison

    def times(self, factor: float) -> BinnedResidual:
        """Multiply the turn along which it is binned, which is also what it is before less what it is after."""
        centre = self.centre * factor
        return replace(self, centre=centre, after_deg=self.before_deg - centre)


@dataclass(frozen=True)
class Interval:
    """A number with its 95 % interval."""

    value: float  #: the estimate
    low: float  #: lower end of 95 %
    high: float  #: upper end of 95 %


@dataclass(frozen=True)
class Amplitude:
    """The size of an effect, rms degrees, as other days have it and as the held-out days do with its 95 % interval."""

    fitted_elsewhere: float  #: by the days that were fitted
    held_out: float  #: by the held-out days
    low: float  #: lower end of 95 % of ``held_out``
    high: float  #: upper end of 95 % of ``held_out``


@dataclass(frozen=True)
class Placebo:
    """The rank of the gain among those of surrogates without the effect."""

    n: int  #: number of surrogates
    rank_p: float | None  #: rank as a probability; None without surrogates


def is_confirmed(low_deg: float, rank_p: float | None) -> bool:
    """Judge whether held-out days show an effect and chance hardly does.

    Args:
        low_deg: lower end of the 95 % interval of its size on held-out days.
        rank_p: rank of its gain among surrogates, as a probability; None where there are none.
    """
    return low_deg > 0.0 and rank_p is not None and rank_p <= CONFIRMED_P


@dataclass(frozen=True)
class HeldOut:
    """What terms add on days that were not fitted."""

    rms_before_deg: float  #: degrees, of the residual by the fit alone
    rms_after_deg: float  #: degrees, including the terms
    gain: float  #: log score, all held-out samples together
    gain_interval: tuple[float, float]  #: 95 %, from the blocks
    p_value: float  #: share of drawn blocks whose gain is not positive
    method: str | None = None  #: fifths | within_event, how days were held out
    anew: Interval | None = None  #: gain where effect, driver and date are chosen anew without the days, not sizes only
    amplitude: Amplitude | None = None  #: size of the effect there; None where it was not measured
    slope: Interval | None = None  #: held-out amplitude over the predicted, where that is clear
    points: BinnedResidual | None = None  #: the same in bins of the predicted turn
    placebo: Placebo | None = None  #: surrogates; None where chance is judged otherwise, as of clocks and calibrations

    @property
    def confirmed(self) -> bool:
        """Whether held-out days show it and chance hardly does."""
        if self.placebo is None or self.amplitude is None:
            return True
        return is_confirmed(self.amplitude.low, self.placebo.rank_p)

    @property
    def refuted(self) -> bool:
        """Whether held-out data deny what was found rather than confirm it: they agree worse with it."""
        return self.gain < 0.0 or (
            self.p_value >= REFUTED_P and self.rms_after_deg > REFUTED_GROWTH * self.rms_before_deg
        )

    def to_json(self) -> dict[str, object]:
        return {
            "rms_before_deg": self.rms_before_deg,
            "rms_after_deg": self.rms_after_deg,
            "log_score_gain": self.gain,
            "log_score_gain_interval": list(self.gain_interval),
            "p_value": self.p_value,
            "method": self.method,
            "gain": None if self.anew is None else vars(self.anew),
            "amplitude_deg": None if self.amplitude is None else vars(self.amplitude),
            "slope": None if self.slope is None else vars(self.slope),
            "placebo": None if self.placebo is None else vars(self.placebo),
        }


UNTESTED = HeldOut(np.nan, np.nan, np.nan, (np.nan, np.nan), np.nan)


def compare_residuals(
    before_deg: Floats, after_deg: Floats, width_deg: Floats | float, block: NDArray[np.intp]
) -> HeldOut:
    """Score by how much a residual became smaller, outliers clipped."""
    sizes = [np.abs(angles.wrap180(np.nan_to_num(left))) / width_deg for left in (before_deg, after_deg)]
    squares = [np.minimum(size, MOST_WIDTHS) ** 2 for size in sizes]
    return bootstrap_gain((squares[0] - squares[1]) / 2.0, block, (angles.rms(before_deg), angles.rms(after_deg)))


def bootstrap_gain(each: Floats, block: NDArray[np.intp], rms_deg: tuple[float, float]) -> HeldOut:
    """Estimate interval and p-value of a gain by resampling blocks.

    Args:
        each: gain of each sample's log score, (n,).
        block: number of the block of each, (n,).
        rms_deg: of the residual, before and after.
    """
    sums = block_sums(each, block)
    resampled = np.random.default_rng(0).choice(sums, (BOOTSTRAP_DRAWS, len(sums))).sum(axis=1)
    low, high = np.quantile(resampled, [0.025, 0.975])
    share = float((np.sum(resampled <= 0.0) + 1) / (BOOTSTRAP_DRAWS + 1))
    return HeldOut(*rms_deg, float(sums.sum()), (float(low), float(high)), share)


@dataclass(frozen=True)
class Parameter:
    """One fitted number of an effect."""

    value: float  #: in ``unit``
    sigma: float  #: one standard deviation, in ``unit``
    unit: str  #: as the catalogue writes it


@dataclass(frozen=True)
class CovariateRange:
    """The range of a covariate in which an effect shows."""

    covariate: str  #: its name
    low: float  #: from, in the covariate's unit
    high: float  #: to, in the covariate's unit
    text: str  #: the range in words

    def to_json(self) -> dict[str, Any]:
        return {"covariate": self.covariate, "from": self.low, "to": self.high, "text": self.text}


@dataclass(frozen=True)
class Statement:
    """The deepest statement on a finding that holds."""

    level: str | None  # effect, driver or side; None where nothing holds
    probability: float | None
    side: str
    driver: str


@dataclass(frozen=True)
class Finding:
    """One effect that was found, with what it could also be."""

    effect: str  #: name in the catalogue, or composed
    side: str  #: compass | clock | reference | water
    alternatives: tuple[str, ...]  #: names of other effects that fit
    where: CovariateRange  #: range of the covariate where it shows
    when_s: tuple[float, float] | None  #: from and to, UTC seconds since 1970; None where the recording has no clock
    parameters: Mapping[str, Parameter]  #: fitted numbers by name
    rms_effect_deg: float  #: visible size, degrees rms
    held_out: HeldOut  #: ``finding.UNTESTED`` where the finding rests on the configuration, not on a search
    text: str  #: the finding in sentences
    applied: bool = False  #: whether it enters the corrected headings
    probability: float = 1.0  #: that this effect is what is there
    alternatives_probability: Mapping[str, float] = field(default_factory=dict)  #: probability of each alternative
    driver: str = ""  #: on what its size depends
    heading_error_deg: float | None = None  #: rms error of corrected headings were it left out, degrees
    composition: Mapping[str, str] | None = None  #: what it acts on, its driver and its form, where it is no listed one
    shares_driver: bool = False  #: whether it is one of two terms of a driver, which only together have the right form

    @property
    def named(self) -> str:
        """Its name among alternatives: a composed one is written composed:ACTS_ON/DRIVER/FORM."""
        return self.effect if self.composition is None else f"{self.effect}:{'/'.join(self.composition.values())}"

    @cached_property
    def statement(self) -> Statement:
        """The deepest statement that the probabilities of its names hold."""
        from compasslib.effects import driver_of, side_of  # only where something was found, as below

        if self.probability >= SURE and not self.shares_driver:
            return Statement("effect", self.probability, self.side, self.driver)
        names = {self.named: self.probability, **self.alternatives_probability}
        places = {name: (side_of(name), driver_of(name)) for name in self.alternatives_probability}
        places[self.named] = (self.side, self.driver)
        drivers, sides = defaultdict[tuple[str, str], float](float), defaultdict[str, float](float)
        for name, (side, driver) in places.items():
            drivers[side, TILTS.get(driver, driver)] += names[name]
            sides[side] += names[name]
        (side, driver), probability = max(drivers.items(), key=lambda item: item[1])
        if probability >= SURE:
            return Statement("driver", min(probability, 1.0), side, driver)
        side, probability = max(sides.items(), key=lambda item: item[1])
        if probability >= SURE:
            return Statement("side", min(probability, 1.0), side, "")
        return Statement(None, None, self.side, self.driver)

    @property
    def level(self) -> str | None:
        """The depth of that statement: effect, driver, side, or None."""
        return self.statement.level

    @property
    def of_compass(self) -> bool:
        """Whether it acts on the affected compass, or may."""
        from compasslib.effects import side_of  # only where something was found: the whole catalogue comes with it

        return "compass" in {self.side, *(side_of(name) for name in self.alternatives)}

    @property
    def outside_compass(self) -> bool:
        """Whether it surely does not act on the affected compass."""
        return not self.of_compass

    def to_json(self) -> dict[str, Any]:
        return {
            "effect": self.effect,
            "side": self.side,
            "alternatives": list(self.alternatives),
            "probability": self.probability,
            "alternatives_probability": dict(self.alternatives_probability),
            "level": self.level,
            "level_probability": self.statement.probability,
            "driver": self.driver or None,
            "heading_error_without_deg": self.heading_error_deg,
            "where": self.where.to_json(),
            "when": span_json(self.when_s),
            "parameters": {name: vars(parameter) for name, parameter in self.parameters.items()},
            "rms_effect_deg": self.rms_effect_deg,
            "heldout": None if self.held_out is UNTESTED else self.held_out.to_json(),
            "applied": self.applied,
            "text": self.text,
            **({} if self.composition is None else {"composition": dict(self.composition)}),
        }


@dataclass(frozen=True)
class Unexplained:
    """A mismatch that is established and that nothing in the catalogue fits."""

    covariates: tuple[str, ...]  #: names of those along which it shows
    where: CovariateRange  #: range where it shows
    when_s: tuple[float, float] | None  #: from and to, UTC seconds since 1970; None without a clock
    rms_effect_deg: float  #: visible size, degrees rms
    curves: tuple[BinnedResidual, ...]  #: the residual along each covariate
    text: str  #: in sentences

    def to_json(self) -> dict[str, Any]:
        return {
            "covariates": list(self.covariates),
            "where": self.where.to_json(),
            "when": span_json(self.when_s),
            "rms_effect_deg": self.rms_effect_deg,
            "curves": [curve_json(curve) for curve in self.curves],
            "text": self.text,
        }


@dataclass(frozen=True)
class RankedEffect:
    """One effect of the catalogue, tried alone: how well it does, whatever was chosen in the end."""

    effect: str  #: name in the catalogue
    score: float  #: log of how much likelier it makes the recording, sizes and dates integrated over
    rms_effect_deg: float  #: visible size, degrees rms
    probability: float  #: that it acts, alone or with others


def span_json(span_s: tuple[float, float] | None) -> dict[str, str] | None:
    """Encode a span of time, null for a recording without a clock."""
    if span_s is None:
        return None
    return {"from": iso_time(span_s[0]), "to": iso_time(span_s[1])}


def curve_json(curve: BinnedResidual) -> dict[str, Any]:
    """Describe the residual along a covariate for diagnosis.json."""
    columns = ("centre", "before_deg", "after_deg", "sigma_deg")
    written = {"covariate": curve.covariate} | ({"compared": curve.compared} if curve.compared else {})
    return written | {name: getattr(curve, name).tolist() for name in columns}
