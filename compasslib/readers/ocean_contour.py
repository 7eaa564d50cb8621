"""Read the netCDF files of Nortek's OceanContour, whose series stand in groups."""

from __future__ import annotations

from functools import partial

from compasslib.readers import netcdf

read = partial(netcdf.read, grouped=True)
