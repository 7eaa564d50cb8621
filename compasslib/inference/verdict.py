"""What was found, as one record: findings with parameters and proof, what stays unexplained, what was not testable."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from compasslib.deviation.model import Fit
from compasslib.inference.finding import Finding, Ranked, Unexplained, curve_json
from compasslib.types import Floats

if TYPE_CHECKING:  # a verdict without findings needs no search
    from compasslib.inference.applied import Member
    from compasslib.inference.sharing import Told
    from compasslib.inference.show import BinnedResidual


VERDICTS = ("consistent", "explained", "ambiguous", "unexplained", "insufficient")


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
