"""A mooring's diagnosis as the workflow asks for it, and what it says of it."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from typing import Any

from compasslib.core.records import EarthField, Pairs
from compasslib.core.types import Floats
from compasslib.deviation import model
from compasslib.deviation.model import Fit
from compasslib.search import verdict
from compasslib.search.verdict import Diagnosis

MOST_PAIRS = 20_000  # hourly pairs of two years; of more, every second, third, ... is searched, to hold memory

SWITCHED_OFF = "the search was switched off (diagnose: {enabled: false})"


def diagnose(
    pairs: Pairs, series: Mapping[str, Floats], fit: Fit, field: EarthField, *, wide: Pairs | None = None, **chosen: Any
) -> Diagnosis:
    """Return what a mooring's overlap shows that its fitted compass does not hold.

    Args:
        pairs: overlapping measurements.
        series: what was logged besides at their times, (n,) each.
        wide: pairs that may stand further apart, by which the clocks are compared.
        **chosen: ``enabled``, and what may be chosen besides, see ``diagnosis.Options``.
    """
    if not chosen.pop("enabled"):
        return verdict.insufficient(SWITCHED_OFF)
    from compasslib.search import diagnosis  # only where it searches: half of what its job imports

    some = slice(None, None, 1 + len(pairs) // MOST_PAIRS)
    kept, few = {name: column[some] for name, column in series.items()}, model.chosen(pairs, some)
    return diagnosis.diagnose(few, kept, fit, field, diagnosis.Options(**chosen), wide=wide)


def told(name: str, found: Diagnosis) -> str:
    """Return what the job says of its result.

    Args:
        name: the mooring or calibration.
    """
    said = [finding.text for finding in found.findings]
    said += [found.unexplained.text] if found.unexplained else []
    said += [found.why] if found.why else []
    said += [f"warning: {warning}" for warning in found.warnings]
    return "\n".join([f"{name}: {found.verdict}", *(textwrap.indent(text, "  ") for text in said)])
