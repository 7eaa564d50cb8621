"""Read the results of a mooring and compare its headings with the unsealed truth."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating]

EPOCH_DAYS = 7305.0  # from 1950 to 1970
NEWTON_STEPS, LONGEST_STEP_DEG = 25, 20.0


def diagnosis(results: Path) -> dict[str, Any]:
    """Read the diagnosis of a mooring; for one that stopped, construct one with the verdict ``stopped``."""
    if (results / "stopped.txt").exists():
        why = (results / "stopped.txt").read_text().strip()
        return {"verdict": "stopped", "findings": [], "unexplained": None, "why": why}
    found: dict[str, Any] = json.loads((results / "diagnosis.json").read_text())
    return found


def product(results: Path) -> dict[str, Floats]:
    """Read times and headings of a product, NaN if missing."""
    with netCDF4.Dataset(results / "corrected.nc") as nc:
        names = ("TIME", "HEADING", "HEADING_CORRECTED", "HEADING_CORRECTED_UNCERTAINTY")
        days, recorded, corrected, sigma = (np.ma.filled(nc[each][:].astype(float), np.nan) for each in names)
    time_s = np.rint((days - EPOCH_DAYS) * 86400.0)
    return {"time_s": time_s, "recorded": recorded, "corrected": corrected, "sigma": sigma}


def headings(results: Path, locked: Path, name: str, deviation: dict[str, Any]) -> dict[str, float | None]:
    """Compute heading errors as recorded, by the configured fit, and of the product, with shares corrected and covered.

    ``before_deg`` is that of the configured fit alone, on the branch nearest to the truth.
    """
    made, (time_s, heading, recorded) = product(results), np.load(locked / f"{name}.npy")[:3]
    at = np.searchsorted(made["time_s"], time_s).clip(0, made["time_s"].size - 1)
    known = (made["time_s"][at] == time_s) & np.isfinite(heading)
    at, heading, recorded = at[known], heading[known], recorded[known]
    after = turn(made["corrected"][at], heading)
    coefficients = deviation.get("coefficients")
    before = None if not coefficients else rms(turn(corrected_by(coefficients, recorded, heading), heading))
    good = np.isfinite(after)
    return {
        "recorded_deg": rms(turn(recorded, heading)),
        "before_deg": before,
        "after_deg": rms(after),
        "share_corrected": float(good.mean()) if good.size else 0.0,
        "covered_95": float(np.mean(np.abs(after[good]) < 1.96 * made["sigma"][at][good])) if good.any() else None,
    }


def corrected_by(coefficients: dict[str, float], recorded_deg: Floats, near_deg: Floats) -> Floats:
    """Invert the exact compass with A to E for the correct heading by Newton's method, starting from ``near_deg``."""
    a, b, c, d, e = (coefficients[letter] for letter in "ABCDE")
    heading = np.deg2rad(near_deg)
    for _ in range(NEWTON_STEPS):
        w = np.exp(1j * heading)
        q = (1 - 1j * a) * w + b - 1j * c + (d - 1j * e) / w
        slope = np.real(((1 - 1j * a) * w - (d - 1j * e) / w) / q)
        miss = np.deg2rad(turn(recorded_deg, np.rad2deg(np.angle(q))))
        most = np.deg2rad(LONGEST_STEP_DEG)
        heading = heading + np.clip(miss / np.where(np.abs(slope) < 0.05, 0.05, slope), -most, most)
    return np.rad2deg(heading)


def turn(a_deg: Floats, b_deg: Floats) -> Floats:
    """Compute the difference a - b, wrapped to [-180, 180), degrees."""
    return np.asarray((a_deg - b_deg + 180.0) % 360.0 - 180.0)


def rms(x: Floats) -> float | None:
    """Compute the root mean square of finite values, None if there are none."""
    finite = x[np.isfinite(x)]
    return float(np.sqrt(np.mean(finite**2))) if finite.size else None
