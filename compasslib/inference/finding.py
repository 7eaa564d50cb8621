"""Findings of a diagnosis, and the gain on held-out data that supports each of them.

The interval of a gain comes from resampled blocks of days, because neighbouring hours are correlated.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.effects import driver_of, side_of
from compasslib.records import iso_time
from compasslib.statistics.resampling import block_sums
from compasslib.types import Floats

HELD_OUT_BLOCK_S = 10 * 86400.0  # longer than the autocorrelation that the filter leaves
FOLDS = 5  # parts of a recording that are left out in turn
SHOWN_QUANTILES = (0.05, 0.95)  # quantiles of a covariate reported as the range of an effect
MOST_WIDTHS = 3.0  # robust widths at which residuals are clipped
BOOTSTRAP_DRAWS = 1000  # draws of blocks, which limit the smallest p-value
CONFIRMED_P = 0.05  # largest rank probability of the gain among surrogates at which a finding is confirmed
REFUTED_P = 0.05  # p-value on held-out days from which a finding is refuted if the rms grows
REFUTED_GROWTH = 1.1  # growth of the rms needed for that: the gain itself is weighted and clipped, the rms is not
DETECTED_P = 0.01  # rank among surrogates up to which an effect is detected: in one of a hundred records without any
NAMED_SIGMAS = 4.0  # normal score from which a clock error is named: 1 in 16,000 by noise alone
LISTED_SHARE = 0.1  # smallest size that is listed as negligible, as a share of ``min_effect_deg``
SURE = 0.95  # probability from which something is stated as established
TILTS = {"pitch": "tilt", "roll": "tilt"}  # two axes of one driver
CURVE_BINS, FEWEST_IN_BIN = 18, 10  # of a plotted curve, and samples in one
NO_ROOT_DEG = 90.0  # residual assigned to a recorded heading that the fit cannot give
RESIDUAL_MEMORY_S = 2 * 86400.0  # autocorrelation of the residual, for the standard error of a bin


def compare_names(effect: str, names: Mapping[str, float]) -> dict[str, float]:
    """Divide a probability of 1 between an effect, which comes first, and its alternatives, by the weights of both.

    Alternatives follow by their probability, until all sum to ``SURE``.
    """
    total = sum(names.values())
    chances = {effect: names[effect] / total}
    for name, weight in sorted(names.items(), key=lambda item: -item[1]):
        if name != effect and sum(chances.values()) < SURE:
            chances[name] = weight / total
    return chances


@dataclass(frozen=True)
class BinnedResidual:
    """Binned residual along one covariate, without and with the effects, after refitting the compass."""

    covariate: str  #: name of the covariate
    centre: Floats  #: (b,) centre of each bin, in the covariate's unit
    before_deg: Floats  #: (b,) degrees, residual of the fit alone
    after_deg: Floats  #: (b,) degrees, residual of the fit including the effects
    sigma_deg: Floats  #: (b,) degrees, standard error of both
    compared: str = ""  #: the comparison, if a recording contains more than one


def bins_along(covariate: str, x: Floats) -> tuple[NDArray[np.intp], Floats]:
    """Assign samples to bins of equal count along a covariate, of equal width along headings; return also the edges."""
    count = int(np.clip(len(x) // 4, 4, CURVE_BINS))
    edges = np.unique(np.quantile(x, np.linspace(0.0, 1.0, count + 1)))
    if covariate == "heading":
        edges = np.linspace(0.0, 360.0, 2 * count + 1)
    return np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2), edges


@dataclass(frozen=True)
class Interval:
    """An estimate with its 95 % interval."""

    value: float  #: the estimate
    low: float  #: lower end of the 95 % interval
    high: float  #: upper end of the 95 % interval


@dataclass(frozen=True)
class Amplitude:
    """Size of an effect on held-out days, with the size predicted from the other days; rms degrees."""

    fitted_elsewhere: float  #: predicted from the days that were fitted
    held_out: float  #: estimated on the held-out days
    low: float  #: lower end of the 95 % interval of ``held_out``
    high: float  #: upper end of the 95 % interval of ``held_out``


@dataclass(frozen=True)
class Placebo:
    """Rank of the gain among the gains of surrogates without the effect."""

    n: int  #: number of surrogates
    rank_p: float | None  #: rank as a p-value; None without surrogates


def is_confirmed(low_deg: float, rank_p: float | None) -> bool:
    """Return whether held-out days show an effect: its interval is above 0, and it is rare among surrogates."""
    return low_deg > 0.0 and rank_p is not None and rank_p <= CONFIRMED_P


@dataclass(frozen=True)
class Detection:
    """Evidence of a further effect, ranked among surrogates without it."""

    statistic: float  #: log Bayes factor of any effect
    n_surrogates: int  #: of each kind
    rank_p: float | None  #: rank as a p-value, the larger one of both kinds of surrogates; None without surrogates
    threshold: float | None = None  #: statistic from which an effect is detected; None without surrogates

    @property
    def significant(self) -> bool:
        """Whether an effect is detected; never without surrogates."""
        return self.rank_p is not None and self.rank_p <= _required_p(self.n_surrogates)

    @classmethod
    def by_rank(cls, statistic: float, surrogates: Sequence[Floats]) -> Detection:
        """Rank a statistic among those of each kind of surrogates, of equal number; the larger p-value counts."""
        count = len(surrogates[0]) if surrogates else 0
        chances = [(1 + int(np.sum(kind >= statistic))) / (1 + count) for kind in surrogates]
        rank = int(_required_p(count) * (1 + count) + 1e-9)  # 0 if too few are drawn for any rank to be high enough
        thresholds = [float(np.sort(kind)[-rank]) for kind in surrogates if rank]
        return cls(statistic, count, max(chances, default=None), max(thresholds, default=None))

    def to_json(self) -> dict[str, float | int | None]:
        return {"rank_p": self.rank_p, "n_surrogates": self.n_surrogates, "statistic": self.statistic}


def _required_p(surrogates: int) -> float:
    """Find the largest p-value of a detection: ``DETECTED_P``, or the least of few surrogates if up to 0.05."""
    least = 1.0 / (1 + surrogates)
    return max(DETECTED_P, least) if least <= CONFIRMED_P else DETECTED_P


@dataclass(frozen=True)
class HeldOut:
    """Performance of terms on days that were not fitted."""

    rms_before_deg: float  #: degrees, residual of the fit alone
    rms_after_deg: float  #: degrees, residual of the fit including the terms
    gain: float  #: in log score, summed over all held-out samples
    gain_interval: tuple[float, float]  #: 95 % interval, from resampled blocks
    p_value: float  #: share of bootstrap draws whose gain is not positive
    method: str | None = None  #: fifths | interleaved, how days were held out
    anew: Interval | None = None  #: gain if effect, driver and date, not only sizes, are selected without these days
    amplitude: Amplitude | None = None  #: size of the effect on held-out days; None if it was not estimated
    slope: Interval | None = None  #: held-out over predicted amplitude; None if the prediction is too uncertain
    points: BinnedResidual | None = None  #: held-out residual in bins of the predicted turn
    placebo: Placebo | None = None  #: None if significance is assessed otherwise, as for clocks and calibrations

    @property
    def confirmed(self) -> bool:
        """Whether held-out days confirm the effect; True if it was not compared with surrogates."""
        if self.placebo is None or self.amplitude is None:
            return True
        return is_confirmed(self.amplitude.low, self.placebo.rank_p)

    @property
    def absent(self) -> bool:
        """Whether held-out days show nothing of the effect: neither a gain nor a rank among surrogates."""
        if self.confirmed or self.placebo is None or self.placebo.rank_p is None or self.anew is None:
            return False
        return self.placebo.rank_p > CONFIRMED_P and self.anew.low <= 0.0

    @property
    def refuted(self) -> bool:
        """Whether held-out data agree less with the effect than without it, in log score or in rms."""
        return self.gain < 0.0 or (
            self.p_value >= REFUTED_P and self.rms_after_deg > REFUTED_GROWTH * self.rms_before_deg
        )

    def to_json(self) -> dict[str, object]:
        plain = {name: getattr(self, name) for name in ("rms_before_deg", "rms_after_deg", "p_value", "method")}
        parts = {"gain": self.anew, "amplitude_deg": self.amplitude, "slope": self.slope, "placebo": self.placebo}
        return {
            **plain,
            "log_score_gain": self.gain,
            "log_score_gain_interval": list(self.gain_interval),
            **{name: None if part is None else vars(part) for name, part in parts.items()},
        }


UNTESTED = HeldOut(np.nan, np.nan, np.nan, (np.nan, np.nan), np.nan)


def compare_residuals(
    before_deg: Floats, after_deg: Floats, width_deg: Floats | float, block: NDArray[np.intp]
) -> HeldOut:
    """Compute the gain in log score between two residuals, with outliers clipped."""
    sizes = [np.abs(angles.wrap180(np.nan_to_num(left))) / width_deg for left in (before_deg, after_deg)]
    squares = [np.minimum(size, MOST_WIDTHS) ** 2 for size in sizes]
    return bootstrap_gain((squares[0] - squares[1]) / 2.0, block, (angles.rms(before_deg), angles.rms(after_deg)))


def bootstrap_gain(each: Floats, block: NDArray[np.intp], rms_deg: tuple[float, float]) -> HeldOut:
    """Estimate the interval and p-value of a gain by resampling blocks.

    Args:
        each: gain in log score of each sample, (n,).
        block: number of the block of each sample, (n,).
        rms_deg: rms of the residual without and with the effect, degrees.
    """
    sums = block_sums(each, block)
    resampled = np.random.default_rng(0).choice(sums, (BOOTSTRAP_DRAWS, len(sums))).sum(axis=1)
    low, high = np.quantile(resampled, [0.025, 0.975])
    share = float((np.sum(resampled <= 0.0) + 1) / (BOOTSTRAP_DRAWS + 1))
    return HeldOut(*rms_deg, float(sums.sum()), (float(low), float(high)), share)


@dataclass(frozen=True)
class Parameter:
    """A fitted parameter of an effect."""

    value: float  #: in ``unit``
    sigma: float  #: one standard deviation, in ``unit``
    unit: str  #: as written in the catalogue


@dataclass(frozen=True)
class CovariateRange:
    """The range of a covariate in which an effect shows."""

    covariate: str  #: name of the covariate
    low: float  #: lower end, in the covariate's unit
    high: float  #: upper end, in the covariate's unit
    text: str  #: the range in words

    def to_json(self) -> dict[str, Any]:
        return {"covariate": self.covariate, "from": self.low, "to": self.high, "text": self.text}


@dataclass(frozen=True)
class Statement:
    """The most specific statement on a finding that is established."""

    level: str | None  # effect, driver or side; None if nothing is established
    probability: float | None
    side: str
    driver: str


@dataclass(frozen=True)
class Finding:
    """An effect that was found, with its alternatives."""

    effect: str  #: name in the catalogue, or composed
    side: str  #: compass | clock | reference | water
    alternatives: tuple[str, ...]  #: names of other effects that explain the mismatch
    where: CovariateRange  #: range of the covariate in which it shows
    when_s: tuple[float, float] | None  #: from and to, UTC seconds since 1970; None if the recording has no clock
    parameters: Mapping[str, Parameter]  #: fitted parameters by name
    rms_effect_deg: float  #: visible size, degrees rms
    held_out: HeldOut  #: ``finding.UNTESTED`` if the finding is derived from the configuration, not from a search
    text: str  #: the finding in sentences
    applied: bool = False  #: whether the headings are corrected for it
    probability: float = 1.0  #: posterior probability of the effect
    alternatives_probability: Mapping[str, float] = field(default_factory=dict)  #: probability of each alternative
    driver: str = ""  #: variable on which its size depends
    heading_error_deg: float | None = None  #: rms error of the headings if it were not corrected, degrees
    composition: Mapping[str, str] | None = None  #: target, driver and form of a composed effect; None for listed ones
    deepest: str = "effect"  #: deepest level that its probability may establish: effect, driver or side

    @property
    def named(self) -> str:
        """Name of the effect; a composed one is written composed:ACTS_ON/DRIVER/FORM."""
        return self.effect if self.composition is None else f"{self.effect}:{'/'.join(self.composition.values())}"

    @property
    def settled(self) -> bool:
        """Whether the effect itself is established, without alternatives, and confirmed on held-out days."""
        return self.level == "effect" and not self.alternatives and self.held_out.confirmed

    @cached_property
    def statement(self) -> Statement:
        """The most specific statement that the probabilities of the effect and its alternatives establish.

        Nothing is established that held-out days do not show: of ten such statements of the sealed proof with seed
        839868382, whose probabilities were 95 % or more, two were right.
        """
        if self.held_out.absent:
            return Statement(None, None, self.side, self.driver)
        if self.probability >= SURE and self.deepest == "effect":
            return Statement("effect", self.probability, self.side, self.driver)
        causes = [(p, side_of(name), driver_of(name)) for name, p in self.alternatives_probability.items()]
        drivers, sides = defaultdict[tuple[str, str], float](float), defaultdict[str, float](float)
        for p, side, driver in (*causes, (self.probability, self.side, self.driver)):
            drivers[side, TILTS.get(driver, driver)] += p
            sides[side] += p
        (side, driver), probability = max(drivers.items(), key=lambda item: item[1])
        if probability >= SURE and self.deepest != "side":
            return Statement("driver", min(probability, 1.0), side, driver)
        alike = sum(p for (_, name), p in drivers.items() if name == driver and name)
        if alike >= SURE and self.deepest != "side":  # one of the two instruments
            return Statement("driver", min(alike, 1.0), "", driver)
        side, probability = max(sides.items(), key=lambda item: item[1])
        if probability >= SURE:
            return Statement("side", min(probability, 1.0), side, "")
        return Statement(None, None, self.side, self.driver)

    @property
    def twins(self) -> tuple[str, ...]:
        """Names of the same driver that this record cannot separate from the effect."""
        likely = (name for name, probability in self.alternatives_probability.items() if probability > 1.0 - SURE)
        return tuple(name for name in likely if driver_of(name) == self.driver)

    @property
    def level(self) -> str | None:
        """Level of ``statement``: effect, driver, side, or None."""
        return self.statement.level

    @property
    def of_compass(self) -> bool:
        """Whether the effect or one of its alternatives acts on the affected compass."""
        return "compass" in {self.side, *(side_of(name) for name in self.alternatives)}

    def to_json(self) -> dict[str, Any]:
        return {
            "effect": self.effect,
            "side": self.side,
            "alternatives": list(self.alternatives),
            "probability": self.probability,
            "alternatives_probability": dict(self.alternatives_probability),
            "twins": list(self.twins),
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
    """An established mismatch that no effect of the catalogue explains."""

    covariates: tuple[str, ...]  #: names of the covariates along which it shows
    where: CovariateRange  #: range in which it shows
    when_s: tuple[float, float] | None  #: from and to, UTC seconds since 1970; None if the recording has no clock
    rms_effect_deg: float  #: visible size, degrees rms
    curves: tuple[BinnedResidual, ...]  #: binned residual along each covariate
    text: str  #: the mismatch in sentences

    def to_json(self) -> dict[str, Any]:
        return {
            "covariates": list(self.covariates),
            "where": self.where.to_json(),
            "when": span_json(self.when_s),
            "rms_effect_deg": self.rms_effect_deg,
            "curves": [curve_json(curve) for curve in self.curves],
            "text": self.text,
        }


def span_json(span_s: tuple[float, float] | None) -> dict[str, str] | None:
    """Encode a time span for diagnosis.json, None for a recording without a clock."""
    if span_s is None:
        return None
    return {"from": iso_time(span_s[0]), "to": iso_time(span_s[1])}


def curve_json(curve: BinnedResidual) -> dict[str, Any]:
    """Encode a binned residual for diagnosis.json."""
    columns = ("centre", "before_deg", "after_deg", "sigma_deg")
    written = {"covariate": curve.covariate} | ({"compared": curve.compared} if curve.compared else {})
    return written | {name: getattr(curve, name).tolist() for name in columns}
