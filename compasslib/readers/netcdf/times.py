"""The times of a netCDF file: CF's units and calendars, and EPIC's two variables."""

from __future__ import annotations

import netCDF4
import numpy as np

from compasslib.core.types import Floats
from compasslib.readers.netcdf.variables import File, arranged, numbers

EPIC_DAY, EPIC_MS = "true julian day", "msec since 0:00 gmt"
EPIC_1970 = 2440588.0  # EPIC counts 2440000 = 0 h on 23 May 1968
SECONDS = {"day": 86400.0, "hour": 3600.0, "minute": 60.0, "second": 1.0, "millisecond": 1e-3, "microsecond": 1e-6}
SHORT = {"d": "day", "h": "hour", "hr": "hour", "min": "minute", "s": "second", "sec": "second", "msec": "millisecond"}
SHORT |= {"ms": "millisecond", "us": "microsecond"}
CALENDARS = ("standard", "gregorian", "proleptic_gregorian", "")


def time_variable(file_columns: str | None, nc: netCDF4.Dataset) -> netCDF4.Variable | None:
    """Return the variable of time: by the column map, EPIC's, or the one with a unit "since"; None without one."""
    if file_columns:
        return nc.variables.get(file_columns)
    along = [v for v in nc.variables.values() if v.ndim >= 1 and _unit(v)]
    epic = [v for v in along if _unit(v).startswith(EPIC_DAY)]
    since = [v for v in along if " since " in _unit(v) and _unit(v) != EPIC_MS]
    own = [v for v in since if v.dimensions == (v.name,) or v.name.lower() in ("time", "time_cf")]
    named = [v for v in since if getattr(v, "standard_name", "") == "time"]
    return next(iter([*own, *named, *epic, *since]), None)


def seconds(file: File, variable: netCDF4.Variable) -> Floats:
    """Return UTC seconds since 1970.

    Raises:
        InputError: a unit or calendar that is no time of the real world.
    """
    unit, calendar = _unit(variable), str(getattr(variable, "calendar", "")).lower()
    value = arranged(file, variable, numbers(variable)).ravel()
    if unit.startswith(EPIC_DAY):
        rest = next((v for v in file.nc.variables.values() if _unit(v) == EPIC_MS), None)
        if rest is None:
            advice = "add EPIC's time2 (msec since 0:00 GMT), without which the hours are unknown"
            raise file.refuse(variable.name, "EPIC's second variable of time", "none", advice)
        return (value - EPIC_1970) * 86400.0 + arranged(file, rest, numbers(rest)).ravel() / 1000.0
    word, since = unit.partition(" since ")[0], str(variable.units).strip()[unit.find(" since ") + 7 :]
    step = SECONDS.get(SHORT.get(word, word.rstrip("s")))
    if step is None or calendar not in CALENDARS:
        found = f"{unit!r}, calendar {calendar or 'not told'}"
        raise file.refuse(variable.name, "days, hours or seconds since a date", found, "write CF's units of time")
    try:
        origin = netCDF4.num2date(np.zeros(1), f"seconds since {since}", calendar or "standard")
        return np.asarray(netCDF4.date2num(origin, "seconds since 1970-01-01", calendar or "standard")) + step * value
    except ValueError as error:
        raise file.refuse(
            variable.name, "days, hours or seconds since a date", f"{unit!r} ({error})", "mend it"
        ) from None


def _unit(variable: netCDF4.Variable) -> str:
    return str(getattr(variable, "units", "")).strip().lower() if np.issubdtype(variable.dtype, np.number) else ""
