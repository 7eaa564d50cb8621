"""What the files of one mooring or calibration hold, as far as its section of the report needs it."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import angles
from compasslib.archive import currents, netcdf, summary
from compasslib.archive.currents import Currents
from compasslib.archive.files import get, opened
from compasslib.records import PROBABLY_BAD
from compasslib.types import Floats

NAMED = ("instrument", "serial_number", "software_version", "date_created", "time_coverage_start", "time_coverage_end")


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
    attributes: dict[str, Any]  # those of NAMED that the file has


@dataclass(frozen=True)
class MooringResults:
    """What the files of one mooring hold, as far as the report needs it."""

    name: str
    folder: Path
    row: Mapping[str, str]  # of summary.csv
    fit: Mapping[str, Any]  # deviation.json
    diagnosis: Mapping[str, Any]
    assessment: Mapping[str, Any]
    headings: Headings
    currents: Currents  # of the bin that is shown
    inputs: Mapping[str, Mapping[str, int]]  # counts of each instrument

    @property
    def product(self) -> Mapping[str, Any]:
        """Return the fit that the product was made by, which is the one in the figures."""
        applied = self.fit["applied"]
        block: Mapping[str, Any] = applied["fit"] or self.fit
        return block


def rows(table: str | Path) -> dict[str, dict[str, str]]:
    """Return the rows of summary.csv by mooring."""
    with Path(table).open(newline="", encoding="utf-8") as stream:
        return {row["name"]: row for row in csv.DictReader(stream)}


def of_mooring(name: str, root: Path, row: Mapping[str, str], roles: Iterable[str] | None = None) -> MooringResults:
    """Return what the files of one mooring hold.

    Args:
        roles: its instruments, see ``summary.records``.
    """
    folder = root / name
    fit, diagnosis, assessment = (
        netcdf.read_json(folder / f"{file}.json") for file in ("deviation", "diagnosis", "assessment")
    )
    inputs = {path.stem: netcdf.read_counts(path) for path in summary.records(folder, roles)}
    product = folder / "corrected.nc"
    shown = currents.of_product(product)
    return MooringResults(name, folder, row, fit, diagnosis, assessment, _headings(product), shown, inputs)


@dataclass(frozen=True)
class CalibrationResults:
    """What the files of one calibration hold, as far as the report needs it."""

    name: str
    folder: Path
    content: Mapping[str, Any]  # calibration.json
    table: tuple[tuple[str, ...], ...]  # rows of table.csv
    diagnosis: Mapping[str, Any] | None


def of_calibration(name: str, root: Path) -> CalibrationResults:
    """Return what the files of one calibration hold."""
    folder = root / "calibrations" / name
    with (folder / "table.csv").open(newline="", encoding="utf-8") as stream:
        rows = tuple(tuple(row) for row in csv.reader(stream))[1:]
    searched = folder / "diagnosis.json"
    diagnosis = netcdf.read_json(searched) if searched.exists() else None
    return CalibrationResults(name, folder, netcdf.read_json(folder / "calibration.json"), rows, diagnosis)


def _headings(path: str | Path) -> Headings:
    """Return the headings of a corrected.nc; its profiles are not read."""
    with opened(path) as nc:
        recorded, corrected, sigma, deviation, declination = (
            get(nc, name)
            for name in ("HEADING", "HEADING_CORRECTED", "HEADING_CORRECTED_UNCERTAINTY", "DEVIATION", "DECLINATION")
        )
        flags = get(nc, "HEADING_CORRECTED_QC")
        attributes = {name: nc.getncattr(name) for name in NAMED if name in nc.ncattrs()}
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
