"""What the pipeline's own fit leaves where nothing was planted: no judgement, the one bound that needs the library."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.proof import measure
from compasslib.archive import netcdf
from compasslib.core import angles
from compasslib.core.records import take
from compasslib.deviation import exact, model


def error_deg(cruise: Path, locked: Path, name: str, deviation: dict[str, Any]) -> float | None:
    """Return the error of the configured fit where nothing was planted, rms degrees: what the water alone makes of it.

    Every effect is taken out of the readings and of the water of the very pairs that the pipeline found, but for a
    wrong clock; the same fit is made again and corrects the readings without effects.
    """
    if not deviation.get("coefficients"):
        return None
    time_s, heading, recorded, plain, veer = np.load(locked / f"{name}.npy")
    pairs = netcdf.read_pairs(cruise / "results" / name / "overlap.nc")
    at = np.searchsorted(time_s, pairs.time_s).clip(0, time_s.size - 1)
    pairs, at = take(pairs, time_s[at] == pairs.time_s), at[time_s[at] == pairs.time_s]
    upper = angles.turn(pairs.upper_east, pairs.upper_north, measure.turn(plain, recorded)[at])
    lower = angles.turn(pairs.lower_east, pairs.lower_north, -veer[at])
    freed = replace(
        pairs,
        heading_deg=plain[at],
        upper_east=upper[0],
        upper_north=upper[1],
        lower_east=lower[0],
        lower_north=lower[1],
    )
    fit = exact.fit(freed, model.from_json(deviation))
    letters = dict(zip(model.LETTERS, fit.coefficients.tolist(), strict=True))
    known = np.isfinite(heading)
    return measure.rms(measure.turn(measure.corrected_by(letters, plain[known], heading[known]), heading[known]))
