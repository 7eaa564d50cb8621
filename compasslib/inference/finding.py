"""What a search writes of one effect and of what has no name: where, when, how large, how sure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from compasslib.inference.show import UNTESTED, BinnedResidual, HeldOut
from compasslib.records import stamp


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
    held_out: HeldOut  # ``show.UNTESTED`` where the finding rests on the configuration, not on a search
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
            "heldout": None if self.held_out is UNTESTED else self.held_out.to_json(),
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


def when(span_s: tuple[float, float] | None) -> dict[str, str] | None:
    """Return a span of time as the JSON writes it, null for a recording without a clock.

    Args:
        span_s: first and last instant, UTC seconds since 1970.
    """
    if span_s is None:
        return None
    return {"from": stamp(span_s[0]), "to": stamp(span_s[1])}


def curve_json(curve: BinnedResidual) -> dict[str, Any]:
    """Return a binned residual for diagnosis.json."""
    columns = ("centre", "before_deg", "after_deg", "sigma_deg")
    written = {"covariate": curve.covariate} | ({"compared": curve.compared} if curve.compared else {})
    return written | {name: getattr(curve, name).tolist() for name in columns}
