"""Whether corrected and reference velocities agree where they meet."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from compasslib.preparation.references import combine_references
from compasslib.records import Pairs
from compasslib.statistics.noise import effective_sample_size
from compasslib.statistics.resampling import NORMAL_95

FEWEST = 30  # pairs


def compare_at_seam(pairs: Pairs, assessment: Mapping[str, Any]) -> dict[str, Any]:
    """Compare both velocities of the pairs: by speed, which no heading changes, and by direction on held-out pairs.

    The fit made the directions of its own pairs agree; those of ``assessment`` are of pairs that it had not seen.

    Returns:
        Means of affected minus reference, each with its standard error; None where there are too few pairs.
    """
    pairs, speed, sigma = combine_references(pairs), None, None
    if len(pairs) >= FEWEST:
        off = np.hypot(pairs.upper_east, pairs.upper_north) - np.hypot(pairs.lower_east, pairs.lower_north)
        speed, sigma = float(off.mean()), float(off.std() / np.sqrt(effective_sample_size(off, pairs.time_s)))
    after = assessment["after"]
    known = after["n"] >= FEWEST
    independent = (after["rms_deg"] / after["rms_deg_sigma"]) ** 2 / 2.0 if known else 1.0
    return {
        "pairs": len(pairs),
        "speed_difference_m_s": speed,
        "speed_difference_sigma_m_s": sigma,
        "held_out_pairs": after["n"],
        "direction_difference_deg": after["mean_deg"] if known else None,
        "direction_difference_sigma_deg": after["rms_deg"] / float(np.sqrt(independent)) if known else None,
    }


def describe_seam(seam: Mapping[str, Any]) -> str:
    """Describe the seam in a sentence, nothing where there are too few pairs."""
    parts = []
    for key, unit, scale in (("speed_difference", "m_s", 100.0), ("direction_difference", "deg", 1.0)):
        value, sigma = seam[f"{key}_{unit}"], seam[f"{key}_sigma_{unit}"]
        if value is None:
            continue
        half = NORMAL_95 * scale * sigma
        words = (
            f"{key.replace('_', ' ')} {scale * value:+.1f} ± {half:.1f} {'cm/s' if unit == 'm_s' else 'degrees'} (95 %)"
        )
        parts.append(words + ("" if abs(scale * value) <= half else ", more than chance"))
    return f"affected minus reference: {'; '.join(parts)}" if parts else ""
