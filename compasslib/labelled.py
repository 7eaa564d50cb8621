"""Labelled data in memory: records, pairs and products as xarray datasets, where xarray is installed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import xarray

NEEDED = "xarray is needed for labelled data; install it by: pip install 'compasslib[xarray]'"
# Units by the last word of a name, which every array of a record carries; velocities carry none.
UNITS = {
    "deg": "degrees",
    "m": "m",
    "minutes": "minutes",
    "dbar": "dbar",
    "c": "degree_Celsius",
    "probability": "1",
    "quality": "1",
    "index": "1",
}
VELOCITIES = ("east", "north", "up", "velocity")  # in the name of what is in m/s
DIMENSIONS = ("time", "bin", "beam")


class Labelled:
    """What can be had as an xarray dataset; for frozen dataclasses of arrays along ``time_s``."""

    def to_xarray(self) -> xarray.Dataset:
        """Convert to a dataset along ``time`` (UTC), ``bin`` and ``beam``, with units; texts are attributes.

        Raises:
            ImportError: xarray is not installed.
        """
        try:
            import xarray
        except ImportError as error:
            raise ImportError(NEEDED) from error
        columns, attributes = collect(self)
        time_s = columns.pop("time_s")
        variables = {
            name: (DIMENSIONS[: values.ndim], values, units(name, attributes.get("channel_units", {})))
            for name, values in columns.items()
            if values.ndim <= len(DIMENSIONS) and len(values) == len(time_s)
        }
        written = {name: value for name, value in attributes.items() if name != "channel_units"}
        time = np.round(time_s * 1e3).astype("datetime64[ms]").astype("datetime64[ns]")
        return xarray.Dataset(variables, coords={"time": time}, attrs=written)


def collect(instance: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """Collect the arrays of a dataclass and of those inside it by name, and everything else that is known."""
    columns, attributes = dict[str, Any](), dict[str, Any]()
    for name, value in ((field.name, getattr(instance, field.name)) for field in fields(instance)):
        if is_dataclass(value):
            inner, more = collect(value)
            columns |= inner
            attributes |= more
        elif isinstance(value, np.ndarray):
            columns[name] = value
        elif name in ("channels", "profiles"):
            columns |= {part: np.asarray(series[:]) for part, series in value.items()}
        elif isinstance(value, Mapping):
            attributes |= (
                {name: dict(value)} if name == "channel_units" else {f"{name}_{k}": v for k, v in value.items()}
            )
        elif isinstance(value, bool):
            attributes[name] = int(value)  # netCDF has no truth values
        elif value not in (None, "", ()):
            attributes[name] = list(value) if isinstance(value, tuple) else value
    return columns, attributes


def units(name: str, of_channels: Mapping[str, str]) -> dict[str, str]:
    """Return the attribute ``units`` of an array, none where it is not known."""
    if name in of_channels:
        return {"units": of_channels[name]}
    last = name.rpartition("_")[2]
    if last not in UNITS and any(part in name for part in VELOCITIES):
        return {"units": "m s-1"}
    return {"units": UNITS[last]} if last in UNITS else {}
