"""What was found, as one record: findings with parameters and proof, what stays unexplained, what was not testable."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

from compasslib.core.types import Floats
from compasslib.deviation.model import Fit

if TYPE_CHECKING:  # a verdict without findings needs no search
    from compasslib.search.applied import Member
    from compasslib.search.sharing import Told
    from compasslib.search.show import BinnedResidual, HeldOut


VERDICTS = ("consistent", "explained", "ambiguous", "unexplained", "insufficient")


@dataclass(frozen=True)
class Parameter:
    """One fitted number of an effect."""

    value: float
    sigma: float
    unit: str


@dataclass(frozen=True)
class Where:
    """The range of a covariate in which an effect shows."""

    covariate: str
    low: float
    high: float
    text: str

    def to_json(self) -> dict[str, Any]:
        """Return it for diagnosis.json."""
        return {"covariate": self.covariate, "from": self.low, "to": self.high, "text": self.text}


@dataclass(frozen=True)
class Finding:
    """One effect that was found, with what it could also be."""

    effect: str
    side: str
    alternatives: tuple[str, ...]
    where: Where
    when_s: tuple[float, float] | None  # None where the recording has no clock
    parameters: Mapping[str, Parameter]
    rms_effect_deg: float
    held_out: HeldOut
    text: str
    applied: bool = False  # whether it enters the corrected headings
    probability: float = 1.0  # that this effect is what is there
    alternatives_probability: Mapping[str, float] = field(default_factory=dict)
    composition: Mapping[str, str] | None = None  # what it acts on, its driver and its form, where it is no listed one

    @property
    def named(self) -> str:
        """Its name among alternatives: a composed one is written composed:ACTS_ON/DRIVER/FORM."""
        return self.effect if self.composition is None else f"{self.effect}:{'/'.join(self.composition.values())}"

    @property
    def of_compass(self) -> bool:
        """Whether it acts on the affected compass, or may."""
        from compasslib.effects import side_of  # only where something was found: the whole catalogue comes with it

        return "compass" in {self.side, *(side_of(name) for name in self.alternatives)}

    @property
    def beside_compass(self) -> bool:
        """Whether it surely does not act on the affected compass."""
        return not self.of_compass

    def to_json(self) -> dict[str, Any]:
        """Return it for diagnosis.json."""
        return {
            "effect": self.effect,
            "side": self.side,
            "alternatives": list(self.alternatives),
            "probability": self.probability,
            "alternatives_probability": dict(self.alternatives_probability),
            "where": self.where.to_json(),
            "when": when(self.when_s),
            "parameters": {name: vars(one) for name, one in self.parameters.items()},
            "rms_effect_deg": self.rms_effect_deg,
            "heldout": self.held_out.to_json(),
            "applied": self.applied,
            "text": self.text,
            **({} if self.composition is None else {"composition": dict(self.composition)}),
        }


@dataclass(frozen=True)
class Unexplained:
    """A mismatch that is established and that nothing in the catalogue fits."""

    covariates: tuple[str, ...]
    where: Where
    when_s: tuple[float, float] | None
    rms_effect_deg: float
    curves: tuple[BinnedResidual, ...]
    text: str

    def to_json(self) -> dict[str, Any]:
        """Return it for diagnosis.json."""
        return {
            "covariates": list(self.covariates),
            "where": self.where.to_json(),
            "when": when(self.when_s),
            "rms_effect_deg": self.rms_effect_deg,
            "curves": [curve_json(curve) for curve in self.curves],
            "text": self.text,
        }


@dataclass(frozen=True)
class Ranked:
    """One effect of the catalogue, tried alone: how well it does, whatever was chosen in the end."""

    effect: str
    score: float  # log of how much likelier it makes the recording, sizes and dates integrated over
    rms_effect_deg: float
    probability: float  # that it acts, alone or with others


@dataclass(frozen=True)
class Diagnosis:
    """The result of holding one recording against its simulation."""

    verdict: str
    findings: tuple[Finding, ...] = ()
    unexplained: Unexplained | None = None
    separated_by: str | None = None
    not_testable: tuple[tuple[str, str], ...] = ()
    negligible: tuple[tuple[str, float], ...] = ()  # effect or covariate, visible degrees
    why: str = ""  # what the verdict rests on, or why there is none
    curves: tuple[BinnedResidual, ...] = ()  # residual before and after along the covariates of what was found
    applied: tuple[Member, ...] = ()  # compasses whose average corrects the record, the chosen one first
    fit: Fit | None = None  # the exact compass that the search stood on, where it may correct the record
    covariance: Floats | None = None  # (5, 5) of A..E without terms, slow water in the noise
    sides: Mapping[str, float] = field(default_factory=dict)  # probability of each; empty where nothing was judged
    noise: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # each with its standard error
    detectable_deg: Mapping[str, float] = field(default_factory=dict)  # visible size that each effect needs to be named
    hypotheses: tuple[Ranked, ...] = ()  # the best first
    threshold: Mapping[str, float] = field(default_factory=dict)  # scores that noise alone hardly exceeds
    warnings: tuple[str, ...] = ()  # sentences for the summary
    told: Told | None = None  # what other records of the same compass may learn from this one
    experiments: tuple[tuple[str, float], ...] = ()  # what to observe, and the chance that one name is left then

    def __post_init__(self) -> None:
        """Keep an effect that was judged in any of its forms from standing among those that could not be tested."""
        judged = {*self.detectable_deg, *(finding.effect for finding in self.findings)}
        kept = tuple(one for one in self.not_testable if one[0] not in judged)
        object.__setattr__(self, "not_testable", kept)

    def to_json(self) -> dict[str, Any]:
        """Return diagnosis.json."""
        return {
            "verdict": self.verdict,
            "findings": [finding.to_json() for finding in self.findings],
            "unexplained": None if self.unexplained is None else self.unexplained.to_json(),
            "separated_by": self.separated_by,
            "not_testable": [{"effect": effect, "why": why} for effect, why in self.not_testable],
            "negligible": [{"effect": effect, "rms_effect_deg": size} for effect, size in self.negligible],
            "why": self.why,
            "curves": [curve_json(curve) for curve in self.curves],
            **({"sides": dict(self.sides)} if self.sides else {}),
            "noise": {name: {"value": value, "sigma": sigma} for name, (value, sigma) in self.noise.items()},
            "experiments": [{"what": what, "probability": chance} for what, chance in self.experiments],
            "fit": None if self.fit is None else self.fit.to_json(),
            "detectable_deg": dict(self.detectable_deg),
            "hypotheses": [vars(one) for one in self.hypotheses],
            "threshold": dict(self.threshold),
            "warnings": list(self.warnings),
        }

    def log_line(self, name: str) -> str:
        """Return what the job says of its result, findings and warnings on lines of their own."""
        texts = [finding.text for finding in self.findings]
        texts += [self.unexplained.text] if self.unexplained else []
        texts += [self.why] if self.why else []
        texts += [f"warning: {warning}" for warning in self.warnings]
        return "\n".join([f"{name}: {self.verdict}", *(textwrap.indent(text, "  ") for text in texts)])


def insufficient(why: str, not_testable: tuple[tuple[str, str], ...] = ()) -> Diagnosis:
    """Return the diagnosis that there was too little to judge.

    Args:
        why: in a sentence.
    """
    return Diagnosis("insufficient", why=why, not_testable=not_testable)


def when(span_s: tuple[float, float] | None) -> dict[str, str] | None:
    """Return a span of time as the JSON writes it, null for a recording without a clock.

    Args:
        span_s: first and last instant, UTC seconds since 1970.
    """
    if span_s is None:
        return None
    return {"from": stamp(span_s[0]), "to": stamp(span_s[1])}


def of(found: Sequence[Finding], unexplained: Unexplained | None) -> str:
    """Return the verdict that findings and an unexplained rest amount to.

    Args:
        unexplained: what nothing explains, or None.
    """
    if unexplained is not None:
        return "unexplained"
    if not found:
        return "consistent"
    return "ambiguous" if any(finding.alternatives for finding in found) else "explained"


def stamp(time_s: float) -> str:
    """Return an instant as ISO 8601.

    Args:
        time_s: UTC seconds since 1970.
    """
    return datetime.fromtimestamp(round(time_s), UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def curve_json(curve: BinnedResidual) -> dict[str, Any]:
    """Return a binned residual for diagnosis.json."""
    columns = ("centre", "before_deg", "after_deg", "sigma_deg")
    written = {"covariate": curve.covariate} | ({"compared": curve.compared} if curve.compared else {})
    return written | {name: getattr(curve, name).tolist() for name in columns}
