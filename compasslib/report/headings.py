"""What the report needs of corrected.nc: counts, uncertainty, and where the headings lie; profiles are not read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from compasslib.archive.files import get, opened
from compasslib.core import angles
from compasslib.core.records import PROBABLY_BAD
from compasslib.core.types import Floats

SAID = ("instrument", "serial_number", "software_version", "date_created", "time_coverage_start", "time_coverage_end")


@dataclass(frozen=True)
class Headings:
    """The headings of one product in a few numbers."""

    n: int  # samples
    recorded: int
    corrected: int
    doubtful: int  # corrected, flagged 3
    sigma_deg: tuple[float, float]  # median and 95th percentile of the uncertainty; NaN where none is corrected
    largest_deviation_deg: float
    recorded_span_deg: tuple[float, float]  # where nine in ten lie
    corrected_span_deg: tuple[float, float]
    declination_deg: tuple[float, float]
    attributes: dict[str, Any]  # those of SAID that the file has


def read(path: str | Path) -> Headings:
    """Return the headings of a corrected.nc.

    Raises:
        InputError: the file is absent, damaged or something else.
    """
    with opened(path) as nc:
        recorded, corrected, sigma, deviation, declination = (
            get(nc, name)
            for name in ("HEADING", "HEADING_CORRECTED", "HEADING_CORRECTED_UNCERTAINTY", "DEVIATION", "DECLINATION")
        )
        flags = get(nc, "HEADING_CORRECTED_QC")
        attributes = {name: nc.getncattr(name) for name in SAID if name in nc.ncattrs()}
    there = np.isfinite(corrected)
    return Headings(
        n=len(recorded),
        recorded=int(np.isfinite(recorded).sum()),
        corrected=int(there.sum()),
        doubtful=int(np.sum(there & (flags == PROBABLY_BAD))),
        sigma_deg=_percentiles(sigma[there], (50.0, 95.0)),
        largest_deviation_deg=float(np.max(np.abs(deviation[there]))) if there.any() else float("nan"),
        recorded_span_deg=span(recorded),
        corrected_span_deg=span(corrected),
        declination_deg=_percentiles(declination[np.isfinite(declination)], (0.0, 100.0)),
        attributes=attributes,
    )


def span(heading_deg: Floats) -> tuple[float, float]:
    """Return the two headings between which nine in ten lie, clockwise, about their circular mean; NaN where none is.

    Args:
        heading_deg: (n,) degrees, NaN left out.
    """
    finite = heading_deg[np.isfinite(heading_deg)]
    middle = angles.mean(finite)
    low, high = _percentiles(angles.difference(finite, middle), (5.0, 95.0))
    return float(angles.wrap360(middle + low)), float(angles.wrap360(middle + high))


def _percentiles(values: Floats, at: tuple[float, float]) -> tuple[float, float]:
    if not values.size:
        return float("nan"), float("nan")
    low, high = np.percentile(values, at)
    return float(low), float(high)
