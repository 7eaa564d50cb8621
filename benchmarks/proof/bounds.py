"""Heading errors of fits by the library: of the published method, and of the configured one without effects.

These are the only reference values of the scorecard that need the library.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.proof import measure
from compasslib import angles
from compasslib.archive import netcdf
from compasslib.deviation.exact import fit_exact
from compasslib.deviation.model import LETTERS, fit_from_json
from compasslib.deviation.series import fit_series, invert_series
from compasslib.records import take


def errors_deg(results: Path, locked: Path, name: str, deviation: dict[str, Any]) -> dict[str, float | None]:
    """Compute rms heading errors, degrees: by the published series, and by the fit without effects.

    For the latter, every effect except a clock error is removed from readings and currents of the pairs that the
    pipeline found; the same fit is repeated and corrects the readings without effects. The published series is fitted
    to the original pairs; readings that it discards are left out.
    """
    if not deviation.get("coefficients"):
        return {"published_deg": None, "sampled_deg": None}
    time_s, heading, recorded, plain, veer, _ = np.load(locked / f"{name}.npy")
    pairs = netcdf.read_pairs(results / "overlap.nc")
    series = fit_series(pairs)
    published = invert_series(series.coefficients, recorded)
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
    fit = fit_exact(freed, fit_from_json(deviation))
    letters = dict(zip(LETTERS, fit.coefficients.tolist(), strict=True))
    known = np.isfinite(heading)
    sampled = measure.corrected_by(letters, plain[known], heading[known])
    return {
        "published_deg": measure.rms(measure.turn(published, heading)[known]),
        "sampled_deg": measure.rms(measure.turn(sampled, heading[known])),
    }
