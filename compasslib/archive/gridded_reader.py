"""gridded.nc read back: velocities on fixed depths and times, and sums of them with their uncertainty."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from compasslib.archive.files import open_netcdf, read_variable
from compasslib.archive.netcdf import DAYS_1950_TO_1970, TIME_DECIMALS
from compasslib.product.errors import HeadingErrors, sum_sigma
from compasslib.records import Flags
from compasslib.types import DAY_S, HOUR_S, Complexes, Floats


@dataclass(frozen=True)
class GriddedCurrents:
    """Velocities of a mooring on t times and z depths, NaN where there is none."""

    time_s: Floats  # (t,) middle of each interval, UTC seconds since 1970
    depth_m: Floats  # (z,)
    velocity: Complexes  # (t, z) true east + i north, m/s
    east_sigma: Floats  # (t, z) m/s, of single cells
    north_sigma: Floats  # (t, z)
    quality: Flags  # (t, z) OceanSITES; 8 interpolated
    source: NDArray[np.intp]  # (t, z) position in ``instruments``, -1 without any
    instruments: tuple[str, ...]  # affected ones first
    errors: HeadingErrors
    memory_s: float  # of errors that turn with no heading

    def sum_cells(self, east: ArrayLike, north: ArrayLike) -> tuple[float, float]:
        """Sum weighted velocities, as a transport or a mean is one, and return the sum and its standard deviation.

        Args:
            east: weights of the eastward velocity, which broadcast to (t, z); cells without a velocity are left out.
            north: the same of the northward velocity.
        """
        there = np.isfinite(self.velocity) & np.isfinite(self.east_sigma)
        east, north = (np.where(there, np.broadcast_to(np.asarray(w, float), there.shape), 0.0) for w in (east, north))
        flow = np.where(there, self.velocity, 0.0)
        variances = np.array([self.errors.variance(s) for s in range(len(self.errors.shares))])
        of_heading = variances[np.maximum(self.source, 0), np.arange(len(there))[:, None]] * np.abs(flow) ** 2
        remainder = np.maximum((self.east_sigma**2 + self.north_sigma**2 - of_heading) / 2.0, 0.0)
        step_s = float(np.median(np.diff(self.time_s))) if len(self.time_s) > 1 else HOUR_S
        sigma = sum_sigma(
            east, north, flow, np.where(there, remainder, 0.0), np.where(there, self.source, -1), self.errors, step_s,
            memory_s=self.memory_s,
        )  # fmt: skip
        return float(np.sum(east * flow.real + north * flow.imag)), sigma


def open_gridded(path: str | Path) -> GriddedCurrents:
    """Read gridded.nc or gridded_daily.nc.

    Args:
        path: the file, or the folder of a mooring's results.

    Raises:
        InputError: the file is absent, damaged or something else.
    """
    path = Path(path)
    with open_netcdf(path / "gridded.nc" if path.is_dir() else path) as nc:
        names = ("TIME", "DEPTH", "UCUR", "VCUR", "UCUR_UNCERTAINTY", "VCUR_UNCERTAINTY", "HEADING_ERROR_MODE")
        time, depth_m, east, north, east_sigma, north_sigma, modes = (read_variable(nc, name) for name in names)
        random, memory_h = read_variable(nc, "HEADING_ERROR_RANDOM"), nc["HEADING_ERROR_RANDOM"].memory_hours
        errors = HeadingErrors(
            tuple(nc["HEADING_ERROR_MODE"].mode_names.split(", ")), modes, np.atleast_2d(random), memory_h * HOUR_S,
            read_variable(nc, "HEADING_ERROR_SHARE"),
        )  # fmt: skip
        return GriddedCurrents(
            np.round((time - DAYS_1950_TO_1970) * DAY_S, TIME_DECIMALS), depth_m, east + 1j * north, east_sigma,
            north_sigma, np.asarray(nc["UCUR_QC"][:]), np.asarray(nc["SOURCE"][:], dtype=np.intp) - 1,
            tuple(nc["SOURCE"].flag_meanings.split()[1:]), errors,
            nc["UCUR_UNCERTAINTY"].error_memory_hours * HOUR_S,
        )  # fmt: skip
