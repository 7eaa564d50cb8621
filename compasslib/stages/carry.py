"""Carry a calibration made elsewhere to a mooring, in place of a fit to its pairs."""

from __future__ import annotations

from collections.abc import Callable

from compasslib import deviation, earthfield
from compasslib.archive import netcdf
from compasslib.calibrations import at_mooring
from compasslib.preparation import several


def run(
    mooring: str, *, calibration: str, record: str, pairs: str, field: str, fit: str, say: Callable[[str], None]
) -> None:
    """Write the calibration's model as it is in the mooring's field.

    Args:
        pairs: they are held against it; nothing is fitted to them.
    """
    own, there = netcdf.read_record(record), earthfield.from_json(netcdf.read_json(field))
    elsewhere = netcdf.read_json(calibration)
    carried = at_mooring.carried(elsewhere, there, own, several.together(netcdf.read_pairs(pairs)))
    netcdf.write_json(fit, deviation.described(carried, own) | at_mooring.origin(elsewhere, there))
    say(deviation.log_line(mooring, carried))
