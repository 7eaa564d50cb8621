"""The times of a netCDF file: CF's units and calendars, and EPIC's two variables."""

from __future__ import annotations

import netCDF4
import numpy as np

from compasslib.readers.netcdf.variables import ROLES, File, arranged, numbers
from compasslib.readers.times import Unreadable, origin_s
from compasslib.types import Floats

EPIC_DAY, EPIC_MS = "true julian day", "msec since 0:00 gmt"
DOLFYN = ("vel", "vel_avg")  # all components in one variable; of a series of single pings, and of its means
EPIC_1970 = 2440588.0  # EPIC counts 2440000 = 0 h on 23 May 1968
WORDS = {  # seconds of a unit, and the words for it: UDUNITS', and their plurals
    604800.0: ("week",),
    86400.0: ("day", "d"),
    3600.0: ("hour", "hr", "h"),
    60.0: ("minute", "min"),
    1.0: ("second", "sec", "s"),
    1e-3: ("millisecond", "millisec", "msec", "ms"),
    1e-6: ("microsecond", "microsec", "us"),
    1e-9: ("nanosecond", "nanosec", "ns"),
}
SECONDS = {form: step for step, words in WORDS.items() for word in words for form in (word, f"{word}s")}
CALENDARS = {"": "standard", "gregorian": "standard", "standard": "standard"}
CALENDARS |= {name: name for name in ("proleptic_gregorian", "julian")}


def time_variable(file_columns: str | None, nc: netCDF4.Dataset) -> netCDF4.Variable | None:
    """Return the variable of time: by the column map, EPIC's, or the one with a unit "since"; None without one.

    Where a file has several, that of its velocities comes first.
    """
    if file_columns:
        return nc.variables.get(file_columns)
    along = [v for v in nc.variables.values() if v.ndim >= 1 and _unit(v)]
    epic = [v for v in along if _unit(v).startswith(EPIC_DAY)]
    since = [v for v in along if " since " in _unit(v) and _unit(v) != EPIC_MS]
    own = [v for v in since if v.dimensions == (v.name,) or v.name.lower() in ("time", "time_cf")]
    named = [v for v in since if getattr(v, "standard_name", "") == "time"]
    flows = [nc.variables[name] for name in (*ROLES["east"].names, *DOLFYN) if name in nc.variables]
    every = [*own, *named, *epic, *since]
    of_flow = [v for flow in flows for v in every if v.dimensions[0] in flow.dimensions]
    return next(iter([*of_flow, *every]), None)


def seconds(file: File, variable: netCDF4.Variable) -> Floats:
    """Return UTC seconds since 1970.

    Raises:
        InputError: a unit or calendar that is no time of the real world.
    """
    unit, calendar = _unit(variable), str(getattr(variable, "calendar", "")).lower()
    value = arranged(file, variable, numbers(file, variable)).ravel()
    if unit.startswith(EPIC_DAY):
        rest = next((v for v in file.nc.variables.values() if _unit(v) == EPIC_MS), None)
        if rest is None:
            advice = "add EPIC's time2 (msec since 0:00 GMT), without which the hours are unknown"
            raise file.refuse(variable.name, "EPIC's second variable of time", "none", advice)
        return (value - EPIC_1970) * 86400.0 + arranged(file, rest, numbers(file, rest)).ravel() / 1000.0
    word, _, since = unit.partition(" since ")
    step, known = SECONDS.get(word), CALENDARS.get(calendar)
    if step is None or known is None:
        found = f"{unit!r}, calendar {calendar or 'not told'}"
        raise file.refuse(variable.name, "days, hours or seconds since a date", found, "write CF's units of time")
    try:
        return origin_s(since, known) + step * value
    except Unreadable as error:
        found = f"{unit!r}: {error.found}"
        raise file.refuse(f"{variable.name}: units", error.expected, found, error.advice) from None


def _unit(variable: netCDF4.Variable) -> str:
    unit = " ".join(str(getattr(variable, "units", "")).split()).lower()
    return unit if np.issubdtype(variable.dtype, np.number) else ""
