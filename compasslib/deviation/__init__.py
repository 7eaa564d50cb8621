"""Deviation curves: the published series and the exact compass, each with fit, inverse and uncertainty."""

from __future__ import annotations

from collections.abc import Callable

from compasslib.deviation import exact, von_appen
from compasslib.deviation.model import Fit
from compasslib.records import Pairs

METHODS: dict[str, Callable[[Pairs], Fit]] = {"exact": exact.fit, "von_appen": von_appen.fit}


def fit(method: str, pairs: Pairs) -> Fit:
    """Return a deviation model fitted to overlapping measurements.

    Args:
        method: ``exact`` or ``von_appen``.
        pairs: overlapping measurements.
    """
    return METHODS[method](pairs)
