"""Which of the catalogue's terms: hypotheses of one, two or three, compared on one scale, and all that come close.

Scores are those of the whitened residual (twice the log-likelihood gained) minus a charge for each parameter and each
date that was searched for. A hypothesis grows only while a further term is significant against the record's own noise
and large enough to matter.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compasslib.discrepancy import columns, model, rivals, scan
from compasslib.discrepancy.baseline import State
from compasslib.discrepancy.rivals import Hypothesis, Rivals
from compasslib.discrepancy.scan import Tested
from compasslib.physics import CATALOGUE

Floats = NDArray[np.floating]

MOST_TERMS = 3
NAMES = 0.5  # of the alarm: at the whole of it 2 of 181 simulated records of nothing were not consistent
LOST = 0.7  # share of the least size below which a refitted term has lost its effect
SEEN = 0.5  # the same for a term of another hypothesis that could stand there
FAR_DEG = 2.5  # visible size above which the columns are taken anew where the simulation stands
TRIES = 4  # hypotheses that are refitted before none is believed


@dataclass(frozen=True)
class Named:
    """The hypothesis that was chosen, and what comes close."""

    state: State  # with the chosen terms refitted
    alternatives: tuple[tuple[str, ...], ...] = ()  # for each chosen term
    tested: Tested | None = None  # what was tested last, beside the chosen terms
    threshold: float = np.inf  # of that test
    negligible: tuple[tuple[str, float], ...] = ()  # significant effects too small to matter, with visible degrees


def search(state: State, *, alarm: float, min_effect_deg: float) -> Named:
    """Return the terms that the residual calls for, one after the other and together.

    Args:
        state: the simulation without terms.
        alarm: probability that noise alone gives a name.
        min_effect_deg: visible size below which an effect does not matter.
    """
    found = Named(state)
    for count in range(1, MOST_TERMS + 1):
        tested = scan.test(found.state, columns.of_terms(found.state, state.case.terms), seed=count)
        threshold = tested.threshold(alarm * NAMES)
        strong = np.flatnonzero(tested.score > threshold).tolist()
        sizes = {k: scan.size_of(found.state, tested.groups[k], float(tested.inflation[k])) for k in strong}
        worth = [k for k, size in sizes.items() if size >= min_effect_deg]
        small = _largest([(tested.groups[k].name, size) for k, size in sizes.items() if size < min_effect_deg])
        grown = _grow(found.state, tested, worth, min_effect_deg) if worth else None
        if grown is None:
            return replace(found, tested=tested, threshold=threshold, negligible=() if worth else small)
        found = replace(grown, tested=tested, threshold=threshold)
    return found


def _grow(state: State, tested: Tested, worth: Sequence[int], min_effect_deg: float) -> Named | None:
    """Return the best hypothesis with one term more, refitted, with its rivals; None where none is believable."""
    field = rivals.gathered(state, tested, worth)
    found = [term for term in (*(tested.groups[k].term for k in worth), *state.simulation.terms) if term is not None]
    evident = {k for k, group in enumerate(field.groups) if type(group.term) in {type(x) for x in found if x.evident}}
    hypotheses = _best(field, state, evident, min_effect_deg)
    tried = ((best, model.dated(model.refit(state, field.terms(best)))) for best in hypotheses)
    believed = ((best, grown) for best, grown in tried if _holds(state, grown, min_effect_deg))
    first = next(believed, None)
    if first is None:
        return None
    # Columns are slopes: of large effects another may fit better once both are refitted where they stand.
    far = max(field.sizes(first[0])) > FAR_DEG
    best, grown = min(
        [first, *(believed if far else ())], key=lambda one: model.misfit(one[1], state.whitener.width_deg)
    )
    terms = grown.simulation.terms
    if max(*model.sizes_deg(grown), *field.sizes(best)) > FAR_DEG or any(term.dated() for term in terms):
        field = rivals.gathered(grown, tested, worth, standing=True)
        best = tuple(field.place(term) for term in terms)
    others = rivals.alternatives(field, best, SEEN * min_effect_deg)
    return Named(grown, tuple(() if term.evident else names for term, names in zip(terms, others, strict=True)))


def _holds(before: State, after: State, min_effect_deg: float) -> bool:
    """Tell whether refitted terms are still there, believable, and leave a smaller residual than without the last."""
    believable = all(term.believable for term in after.simulation.terms)
    smaller = model.misfit(after, before.whitener.width_deg) < model.misfit(before, before.whitener.width_deg)
    return believable and smaller and min(model.sizes_deg(after)) >= LOST * min_effect_deg


def _best(field: Rivals, state: State, evident: set[int], min_effect_deg: float) -> Iterator[Hypothesis]:
    """Give the best hypotheses with one term more, the evident ones in all.

    Pairs are all tried, a third joins the pair that was chosen.
    """
    chosen, everything = state.simulation.terms, range(len(field.groups))
    tries: list[Hypothesis] = list(itertools.combinations(everything, len(chosen) + 1))
    if len(chosen) > 1:
        kept = {field.place(term) for term in chosen}
        tries = [hypothesis for hypothesis in tries if kept <= set(hypothesis)]
    tries = [hypothesis for hypothesis in tries if evident <= set(hypothesis)]
    ranked = sorted((one for one in tries if field.sound(one)), key=field.score, reverse=True)
    acceptable = (one for one in ranked if field.acceptable(one, min_effect_deg))
    for hypothesis in itertools.islice(acceptable, TRIES):
        yield tuple(sorted(hypothesis, key=lambda k: CATALOGUE.index(type(field.groups[k].term))))


def _largest(small: Sequence[tuple[str, float]]) -> tuple[tuple[str, float], ...]:
    sizes: dict[str, float] = {}
    for name, size in small:
        sizes[name] = max(size, sizes.get(name, 0.0))
    return tuple(sizes.items())
