"""Whether the deviation is too large for the small-angle series: the series against the exact compass.

Both have five parameters, so the comparison on held-out days needs no charge for complexity.
"""

from __future__ import annotations

import numpy as np

from compasslib.core import angles, compass
from compasslib.core.records import Pairs
from compasslib.deviation import exact, model, von_appen
from compasslib.deviation.forms import EXACT, SeriesInCorrect
from compasslib.deviation.model import Fit
from compasslib.search import show, wording
from compasslib.search.show import HeldOut
from compasslib.search.verdict import Finding, Parameter, Where

PAIRS = 1000  # as many, evenly taken, tell the curves apart
SURE = 0.01


def findings(pairs: Pairs, fit: Fit, series: Fit, min_effect_deg: float) -> list[Finding]:
    """Return the finding that the exact compass fits where the series does not, or none.

    Args:
        pairs: overlapping measurements.
        min_effect_deg: size below which the difference does not matter, rms.
    """
    observed = model.observed_heading(pairs)
    by_exact = model.nearest_root(compass.inverse(fit.coefficients, pairs.heading_deg), observed)
    by_series = von_appen.invert(series.coefficients, pairs.heading_deg)
    size, lost = angles.rms(angles.difference(by_exact, by_series)), float(np.mean(~np.isfinite(by_series)))
    if not (size >= min_effect_deg or lost > 0.02):
        return []
    proof = _held_out(pairs, fit, series)
    if proof.p_value > SURE or proof.refuted:
        return []
    said = wording.finding(
        "large_deviation",
        (),
        where="Along the recorded heading",
        parameters={},
        size_deg=size,
        proof=(proof.rms_before_deg, proof.rms_after_deg, proof.p_value),
    )
    low, high = np.quantile(pairs.heading_deg, [0.05, 0.95]).tolist()
    place = Where("heading", low, high, wording.place("heading", low, high))
    span = (float(pairs.time_s[0]), float(pairs.time_s[-1]))
    share = {"share": Parameter(1.0, 0.0, "1")}
    return [Finding("large_deviation", "compass", (), place, span, share, size, proof, said, applied=True)]


def _held_out(pairs: Pairs, fit: Fit, series: Fit) -> HeldOut:
    """Return the gain of the exact compass over the best series on blocks that neither was fitted to."""
    some = model.chosen(pairs, np.arange(0, len(pairs), max(1, len(pairs) // PAIRS)))
    block = np.floor((some.time_s - some.time_s[0]) / show.BLOCK_S).astype(int)
    scores = [
        exact.held_out_scores(form, some, block % 2, near) for form, near in ((SeriesInCorrect(), None), (EXACT, fit))
    ]
    left = [show.left_out(some, near) for near in (series, fit)]
    return show.judged(scores[1] - scores[0], block, (angles.rms(left[0]), angles.rms(left[1])))
