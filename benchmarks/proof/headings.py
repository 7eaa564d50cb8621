"""Heading errors of a mooring by its unsealed truth: as recorded, by fits, and of the product."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from compasslib import angles, compass
from compasslib.archive import netcdf
from compasslib.deviation.exact import fit_exact
from compasslib.deviation.model import fit_from_json, nearest_root
from compasslib.deviation.series import fit_series, invert_series
from compasslib.records import take
from compasslib.types import Floats

ERRORS = ("recorded_deg", "before_deg", "after_deg", "published_deg", "sampled_deg")


def heading_errors(results: Path, truth: Path) -> dict[str, float | None]:
    """Compute rms heading errors, degrees, with the shares corrected and covered; None where they are not known.

    ``before_deg`` is that of the configured fit alone, on the branch nearest to the truth, ``after_deg`` of the
    product. For ``sampled_deg``, every effect except a clock error is removed from readings and currents of the pairs
    that the pipeline found; the same fit is repeated and corrects the readings without effects. The published series
    is fitted to the original pairs; readings that it discards are left out.
    """
    made: dict[str, float | None] = dict.fromkeys((*ERRORS, "share_corrected", "covered_95"))
    if not (results / "deviation.json").exists():
        return made
    deviation = json.loads((results / "deviation.json").read_text())["fitted"]
    time_s, heading, recorded, plain, veer, _ = np.load(truth)
    product = netcdf.read_corrected(results / "corrected.nc")
    product_s = np.rint(product.record.time_s)
    at = np.searchsorted(product_s, time_s).clip(0, product_s.size - 1)
    known = np.isfinite(heading)
    there = known & (product_s[at] == time_s)
    at = at[there]
    after = angles.difference(product.heading_corrected_deg[at], heading[there])
    good = np.isfinite(after)
    within = np.abs(after[good]) < 1.96 * product.heading_uncertainty_deg[at][good]
    made |= {
        "recorded_deg": rms(angles.difference(recorded, heading)[there]),
        "after_deg": rms(after),
        "share_corrected": float(good.mean()) if good.size else 0.0,
        "covered_95": float(within.mean()) if good.any() else None,
    }
    if deviation.get("coefficients"):
        fit, pairs = fit_from_json(deviation), netcdf.read_pairs(results / "overlap.nc")
        made["before_deg"] = exact_error(fit.coefficients, recorded[there], heading[there])
        published = invert_series(fit_series(pairs).coefficients, recorded)
        made["published_deg"] = rms(angles.difference(published, heading)[known])
        at = np.searchsorted(time_s, pairs.time_s).clip(0, time_s.size - 1)
        pairs, at = take(pairs, time_s[at] == pairs.time_s), at[time_s[at] == pairs.time_s]
        upper = angles.turn(pairs.upper_east, pairs.upper_north, angles.difference(plain, recorded)[at])
        lower = angles.turn(pairs.lower_east, pairs.lower_north, -veer[at])
        currents = {"upper_east": upper[0], "upper_north": upper[1], "lower_east": lower[0], "lower_north": lower[1]}
        sampled = fit_exact(replace(pairs, heading_deg=plain[at], **currents), fit)
        made["sampled_deg"] = exact_error(sampled.coefficients, plain[known], heading[known])
    return made


def exact_error(coefficients: Floats, recorded_deg: Floats, heading_deg: Floats) -> float | None:
    """Compute the rms error of headings by an exact compass, on the branch nearest to the truth, degrees."""
    found = nearest_root(compass.inverse(coefficients, recorded_deg), heading_deg)
    return rms(angles.difference(found, heading_deg))


def rms(error_deg: Floats) -> float | None:
    """Compute the root mean square of finite values, None if there are none."""
    return angles.rms(error_deg) if np.isfinite(error_deg).any() else None
