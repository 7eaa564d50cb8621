"""What every search begins with and ends with: a recording held against its simulation, and what that tells.

Hypotheses of a long record are weighed by the slopes of their columns, beside slow water (``long_record``); those of a
short one, whose effects may be a thousand times its noise, are each refitted in the forward model (``short_record``).
Prior odds, posterior, places, findings, omnibus threshold and verdict are the same.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from compasslib.effects import Term
from compasslib.effects.composed import Composed
from compasslib.inference import show, wording
from compasslib.inference.finding import Finding, Ranked, Unexplained, Where
from compasslib.inference.posterior import Posterior, Slot
from compasslib.inference.show import BinnedResidual
from compasslib.types import Floats

OUTSIDE = 2.5  # standard errors by which a bin leaves the band


@dataclass(frozen=True)
class Options:
    """What may be chosen about a diagnosis."""

    min_effect_deg: float = 0.5  # visible size, rms, below which a mismatch does not matter
    apply: bool = True  # whether findings on the compass side are handed to the correction
    alarm: float = 0.006  # probability that noise alone gives a name, and that it gives an unexplained mismatch
    reference_magnetic: bool = True  # whether the reference has a compass too
    tell: bool = False  # whether other records of the compass are to know what this one tells


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """A recording held against its simulation; n samples in the order of time."""

    time_s: Floats  # (n,) increasing: UTC seconds, or the number of the reading where there is no clock
    terms: tuple[type[Term], ...]  # that can be tested
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

    def unit(self, term: Term, k: int) -> tuple[float, str]:
        """Return by what a parameter is multiplied for people, and its unit.

        Args:
            k: number of the parameter among those that are fitted.
        """
        return 1.0, self.driven(term, term.units()[k])

    def driven(self, term: Term, unit: str) -> str:
        """Return a unit with that of a driver which the grammar knows by its name only."""
        if isinstance(term, Composed):
            for driver in term.composition[1].split("*"):
                own = self.units.get(driver, driver)
                unit = unit.replace(driver, f"({own})" if "/" in own or " " in own else own)
        return unit

    def where(self, name: str, span: tuple[float, float] | None = None) -> Where:
        """Return a range of a covariate, by default the one that it covers."""
        low, high = span or tuple(np.quantile(self.covariates[name], show.RANGE).tolist())
        text = wording.place(name, low, high, on_land=bool(self.what), clocked=self.clocked)
        return Where(name, low, high, text)

    def outside(self, curve: BinnedResidual) -> Where:
        """Return the range in which a binned residual leaves its band; all of the covariate where no bin does alone."""
        far = np.abs(curve.before_deg) > OUTSIDE * curve.sigma_deg
        if not far.any() or len(curve.centre) < 2:
            return self.where(curve.covariate)
        column, inside = self.covariates[curve.covariate], curve.centre[far]
        half = np.median(np.diff(curve.centre)) / 2.0
        low, high = max(inside.min() - half, column.min()), min(inside.max() + half, column.max())
        return self.where(curve.covariate, (float(low), float(high)))

    def since(self, date_s: float) -> Where:
        """Return the time from a date on."""
        last = self.span_s[1]
        if self.clocked:
            return Where("time", date_s, last, f"from {wording.moment(date_s, last - self.span_s[0])} on")
        first = float(self.time_s[np.searchsorted(self.time_s, date_s)])
        return Where("reading", first, last, f"from reading {first:.0f} on")

    def lives(self, term: Term) -> str:
        """Return the covariate along which an effect lives: of those known to go with it the one that varies most."""
        listed = term.needs if isinstance(term, Composed) else wording.WHERE.get(term.name, ("time",))
        known = [name for name in listed if name in self.covariates]
        known = [name for name in known if name in term.needs] or known
        known = known or [name for name in ("time", "reading") if name in self.covariates] or list(self.covariates)
        return max(known, key=lambda name: float(np.std(self.covariates[name])))

    def unexplained(
        self, curves: Sequence[BinnedResidual], size_deg: float, named: Sequence[str], place: Where | None = None
    ) -> Unexplained:
        """Return what is left after the named terms: where it lives, how large, its empirical curve.

        Args:
            curves: along its covariates.
            size_deg: visible size, rms.
            named: effects that stand beside it.
            place: where it is known; else where the curves leave their bands.
        """
        places = [place] if place else [self.outside(curve) for curve in curves]
        dates = next(((one.low, one.high) for one in places if one.covariate == "time"), self.span_s)
        text = wording.unexplained(" and ".join(one.text for one in places), size_deg, named)
        covariates = tuple(curve.covariate for curve in curves)
        return Unexplained(covariates, places[0], dates if self.clocked else None, size_deg, tuple(curves), text)


@dataclass(frozen=True)
class Outcome:
    """What the search of one comparison tells, however its hypotheses were weighed."""

    comparison: Comparison
    posterior: Posterior
    findings: tuple[Finding, ...]  # of the likeliest hypothesis, in the order of its terms
    slots: tuple[Slot, ...]  # places of the findings
    left: Unexplained | None
    small: tuple[tuple[str, float], ...]  # what is left and does not matter, visible degrees
    curves: Callable[[Sequence[Finding], Unexplained | None], list[BinnedResidual]]  # of what was found and is left
    noise: Mapping[str, tuple[float, float]]  # each with its standard error
    taken_back: frozenset[str] = frozenset()  # names that the search gave, and that only stood for something else
    tried: tuple[Ranked, ...] = ()  # each effect alone
    deniable: bool = False  # whether held-out readings that agree worse take a name back
