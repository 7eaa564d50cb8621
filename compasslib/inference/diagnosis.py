"""The verdict on a recording: what all its comparisons show together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from compasslib.inference import verdict, wording
from compasslib.inference.comparison import Options, Outcome
from compasslib.inference.finding import Finding, Ranked, Unexplained
from compasslib.inference.posterior import Slot
from compasslib.inference.verdict import Diagnosis

WORTH_SAYING = 0.1  # of the size that matters: less is not even listed


def of(
    parts: Sequence[Outcome],
    options: Options,
    *,
    beside: Sequence[Finding] = (),
    not_testable: Sequence[tuple[str, str]] = (),
    separated_by: str | None = None,
) -> Diagnosis:
    """Return what all comparisons of a recording show together.

    Args:
        beside: findings that were made apart from a search.
        separated_by: an observation that this kind of recording always lacks, said beside a finding.
    """
    every = [*beside, *(finding for part in parts for finding in part.findings)]
    denied = {id(one) for part in parts if part.deniable for one in part.findings if one.held_out.refuted}
    matter = [one for one in every if one.rms_effect_deg >= options.min_effect_deg]
    stands = [one for one in matter if id(one) not in denied]
    found = _once([[one for one in group if one in stands] for group in (beside, *(part.findings for part in parts))])
    unnamed = [part.left for part in parts if part.left is not None]
    unnamed += [_unconfirmed(one) for one in matter if id(one) in denied]
    left = max(unnamed, key=lambda one: one.rms_effect_deg, default=None)
    small = [(one.effect, one.rms_effect_deg) for one in every if one.rms_effect_deg < options.min_effect_deg]
    small += [one for part in parts for one in part.small]
    sides = min((_sides(part, stands) for part in parts), key=lambda one: one["none"], default={})
    for one in beside:
        sides = surely(one.side, sides) if one in found else sides
    phrases = [wording.separated_by(f.named, f.alternatives) for f in found if f.alternatives]
    if separated_by and any(one.side == "compass" for one in found):
        phrases.append(separated_by)
    compared = [part.comparison.what for part in parts]
    return Diagnosis(
        verdict=verdict.of(found, left),
        findings=found,
        unexplained=left,
        separated_by="; ".join(dict.fromkeys(phrases)) or None,
        not_testable=tuple(not_testable),
        negligible=tuple({name: size for name, size in small if size > WORTH_SAYING * options.min_effect_deg}.items()),
        why=wording.why([one.effect for one in found], left.text if left else "", compared),
        curves=tuple(curve for part in parts for curve in part.curves(found, left)),
        hypotheses=_ranked(parts),
        sides=sides,
        noise=parts[0].noise if parts else {},
    )


def surely(side: str, sides: Mapping[str, float]) -> dict[str, float]:
    """Return the probabilities of sides where something surely acts on one: what is left out is not nothing."""
    if not sides:
        return {}
    yielding = ("none", "water") if side == "clock" else ("none", "water", "clock", "reference")
    return {
        name: value + sum(sides[x] for x in yielding) if name == side else value * (name not in yielding)
        for name, value in sides.items()
    }


def joined(first: Sequence[Finding], rest: Diagnosis) -> Diagnosis:
    """Return the diagnosis with findings that were made before the search, strongest first."""
    if not first:
        return rest
    found = tuple(sorted((*first, *rest.findings), key=lambda one: -one.rms_effect_deg))
    sides = surely(first[0].side, rest.sides)
    return replace(rest, findings=found, verdict=verdict.of(found, rest.unexplained), sides=sides)


def _sides(part: Outcome, stands: Sequence[Finding]) -> dict[str, float]:
    """Return the probability of each side: what is too small to matter or was taken back counts as nothing."""
    kept, fallen = set[str](), set(part.taken_back)
    for finding, slot in zip(part.findings, part.slots, strict=True):
        (kept if finding in stands else fallen).update(_names(slot))
    return part.posterior.sides(fallen - kept)


def _names(slot: Slot) -> tuple[str, ...]:
    return (slot.effect, *slot.alternatives)


def _unconfirmed(one: Finding) -> Unexplained:
    """Return a mismatch that is proven where it was fitted, and whose name held-out readings deny."""
    text = wording.unexplained(one.where.text, one.rms_effect_deg, [])
    return Unexplained((one.where.covariate,), one.where, one.when_s, one.rms_effect_deg, (), text)


def _ranked(parts: Sequence[Outcome]) -> tuple[Ranked, ...]:
    """Return every effect that was tried alone, the best first, each once."""
    best: dict[str, Ranked] = {}
    for one in (one for part in parts for one in part.tried):
        if one.effect not in best or best[one.effect].score < one.score:
            best[one.effect] = one
    return tuple(sorted(best.values(), key=lambda one: -one.score))


def _once(groups: Sequence[Sequence[Finding]]) -> tuple[Finding, ...]:
    """Return findings, strongest first: what two comparisons show is one effect."""
    kept: list[Finding] = []
    for group in groups:
        again = {one.effect: one for one in group}
        for k, one in enumerate(kept):
            if (other := again.get(one.effect)) is not None:
                stronger = max(one, other, key=lambda x: x.rms_effect_deg)
                both = tuple(name for name in one.alternatives if name in other.alternatives)
                text = f"{stronger.text} A second comparison shows it too."
                kept[k] = replace(stronger, alternatives=both, text=text)
        known = {one.effect for one in kept}
        kept += [one for one in group if one.effect not in known]
    return tuple(sorted(kept, key=lambda one: -one.rms_effect_deg))
