"""Fit the deviation model to the pairs, or carry a calibration made elsewhere to the mooring."""

from __future__ import annotations

from collections.abc import Callable

from compasslib import earthfield
from compasslib.archive import netcdf
from compasslib.archive.files import read_json, write_json
from compasslib.calibrations import at_mooring
from compasslib.deviation import describe_fit, deviation_json, fit_deviation
from compasslib.preparation.references import combine_references


def fit(
    mooring: str, *, record: str, pairs: str, field: str, fit: str, method: str, tilt: bool, say: Callable[[str], None]
) -> None:
    """Write the fit, and how often each heading occurs in the record that it is to correct.

    Args:
        tilt: whether pitch and roll enter.
    """
    dip_ratio = tilt * earthfield.dip_ratio(earthfield.field_from_json(read_json(field)))
    fitted = fit_deviation(method, combine_references(netcdf.read_pairs(pairs)), dip_ratio=dip_ratio)
    write_json(fit, deviation_json(fitted, netcdf.read_record(record, velocities=False)))
    say(describe_fit(mooring, fitted))


def carry(
    mooring: str, *, calibration: str, record: str, pairs: str, field: str, fit: str, say: Callable[[str], None]
) -> None:
    """Write the calibration's model as it is in the mooring's field.

    Args:
        pairs: they are held against it; nothing is fitted to them.
    """
    own, there = netcdf.read_record(record), earthfield.field_from_json(read_json(field))
    elsewhere = read_json(calibration)
    carried = at_mooring.carry_to_mooring(elsewhere, there, own, combine_references(netcdf.read_pairs(pairs)))
    write_json(fit, deviation_json(carried, own) | at_mooring.origin(elsewhere, there))
    say(describe_fit(mooring, carried))
