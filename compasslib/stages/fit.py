"""Fit the deviation model to the pairs."""

from __future__ import annotations

from collections.abc import Callable

from compasslib import deviation, earthfield
from compasslib.archive import netcdf
from compasslib.preparation import several


def run(
    mooring: str, *, record: str, pairs: str, field: str, fit: str, method: str, tilt: bool, say: Callable[[str], None]
) -> None:
    """Write the fit, and how often each heading occurs in the record that it is to correct.

    Args:
        tilt: whether pitch and roll enter.
    """
    dip_ratio = tilt * earthfield.dip_ratio(earthfield.from_json(netcdf.read_json(field)))
    fitted = deviation.fit(method, several.together(netcdf.read_pairs(pairs)), dip_ratio=dip_ratio)
    netcdf.write_json(fit, deviation.described(fitted, netcdf.read_record(record, velocities=False)))
    say(deviation.log_line(mooring, fitted))
