"""What the velocities of a netCDF file came with: upward and error velocity, echo, correlation and percent good.

Found by the names of OceanSITES, IMOS, EPIC, dolfyn and MHKiT, and of this program's own product. No heading depends on
it, so that what is not clear is left out, and never refused.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import netCDF4
import numpy as np
from numpy.typing import NDArray

from compasslib.readers.netcdf.variables import SPEED, File, numbers
from compasslib.types import Floats

VELOCITIES: Mapping[str, tuple[str, ...]] = {
    "up": ("WCUR", "w_1204", "vel_up", "up", "w"),
    "error_velocity": ("ERROR_VELOCITY", "ECUR", "Werr_1201", "Werr"),
}
AMONG = {"up": ("U", "U1"), "error_velocity": ("err",)}  # of dolfyn's one variable of all components
COUNTS: Mapping[str, tuple[str, ...]] = {
    "echo": ("ECHO_INTENSITY", "ABSIC{}", "amp"),
    "correlation": ("CORRELATION", "CMAG{}", "corr"),
    "percent_good": ("PERCENT_GOOD", "PERG{}", "prcnt_gd"),
}
BEAMS = ("BEAM", "beam")
LARGEST = 255


def of_file(file: File, shape: tuple[int, ...], order: slice) -> dict[str, NDArray[Any]]:
    """Return the profiles of a record.

    Args:
        shape: (n, m) of its velocities.
        order: of its bins.
    """
    flows = {key: _velocity(file, key) for key in VELOCITIES}
    found: dict[str, NDArray[Any]] = {key: flow.astype(np.float32) for key, flow in flows.items() if flow is not None}
    counts = {key: _counts(file, names) for key, names in COUNTS.items()}
    found |= {key: _packed(values) for key, values in counts.items() if values is not None}
    return {key: values[:, order] for key, values in found.items() if values.shape[:2] == shape}


def _velocity(file: File, key: str) -> Floats | None:
    variable = next((file.nc.variables[name] for name in VELOCITIES[key] if name in file.nc.variables), None)
    if variable is not None and (flow := _arranged(file, variable)) is not None and flow.ndim == 2:
        factor = SPEED.get(str(getattr(variable, "units", "")).lower())
        return None if factor is None else factor * flow
    velocity = file.nc.variables.get(f"vel{file.suffix}")
    if velocity is None or "dir" not in velocity.dimensions:
        return None
    labels = file.labels("dir")
    label = next((one for one in AMONG[key] if one in labels), None)
    every = _arranged(file, velocity, "dir")
    return None if label is None or every is None else every[..., labels.index(label)]


def _counts(file: File, names: tuple[str, ...]) -> Floats | None:
    """Return counts, (n, m, beams) or (n, m), NaN where missing."""
    for name in (*(f"{name}{file.suffix}" for name in names if file.suffix), *names):
        several = [name.format(beam) for beam in range(1, 5)] if "{}" in name else [name]
        there = [file.nc.variables[one] for one in several if one in file.nc.variables]
        each = [one for variable in there if (one := _arranged(file, variable, *BEAMS)) is not None]
        if len(each) == len(several):
            return each[0] if len(each) == 1 else np.stack(each, axis=-1)
    return None


def _packed(values: Floats) -> NDArray[Any]:
    """Return counts as the bytes that they were; -1 where missing."""
    missing = ~((values >= 0) & (values <= LARGEST))
    whole = np.where(missing, -1, np.rint(values)).astype(np.int16)
    return whole if missing.any() else whole.astype(np.uint8)


def _arranged(file: File, variable: netCDF4.Variable, *last: str) -> Floats | None:
    """Return values by time, bin and a last dimension, those of one value gone; None where there are others."""
    wanted = (file.time, file.bins, *last)
    long = [name for name, size in zip(variable.dimensions, variable.shape, strict=True) if size > 1]
    if not np.issubdtype(variable.dtype, np.number) or {*long} - {*wanted} or file.time not in variable.dimensions:
        return None
    own = [name for name in wanted if name in variable.dimensions]
    data = numbers(file, variable)
    apart = [k for k, name in enumerate(variable.dimensions) if name not in own]
    data = data.transpose([*(variable.dimensions.index(name) for name in own), *apart])
    data = data.reshape([variable.shape[variable.dimensions.index(name)] for name in own])
    return data if file.bins in own else data[:, None]
