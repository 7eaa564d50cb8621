"""Where an instrument stood, as far as its netCDF file tells: for drafts alone."""

from __future__ import annotations

from pathlib import Path

import netCDF4
import numpy as np

from compasslib.readers.netcdf.variables import refuse_size
from compasslib.types import Floats

NAMES = {  # variables of one value, or attributes: OceanSITES, IMOS (imos-toolbox), EPIC (stglib), dolfyn
    "latitude": ("LATITUDE", "latitude", "lat", "geospatial_lat_min"),
    "longitude": ("LONGITUDE", "longitude", "lon", "geospatial_lon_min"),
    "water_depth": ("water_depth", "WATER_DEPTH", "site_nominal_depth", "sea_floor_depth_below_sea_surface"),
}


def of(path: Path) -> dict[str, float]:
    """Return latitude, longitude and water depth (m), those that the file tells as one finite number."""
    with netCDF4.Dataset(path) as nc:
        each = {key: [_number(path, nc, name) for name in names] for key, names in NAMES.items()}
    found = {key: next(filter(np.isfinite, numbers), np.nan) for key, numbers in each.items()}
    return {key: float(value) for key, value in found.items() if np.isfinite(value)}


def _number(path: Path, nc: netCDF4.Dataset, name: str) -> float:
    """Return a variable's or an attribute's one number, NaN without one."""
    if name in nc.variables:
        refuse_size(path, nc.variables[name])
    value = nc.variables[name][...] if name in nc.variables else getattr(nc, name, np.nan)
    try:
        values: Floats = np.unique(np.ma.filled(np.ma.asarray(value, dtype=float), np.nan))
    except (TypeError, ValueError):
        return float("nan")
    return float(values[0]) if values.size == 1 else float("nan")
