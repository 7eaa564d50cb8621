"""Fit the deviation model to the pairs, or carry a calibration made elsewhere to the mooring."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from compasslib import earthfield
from compasslib.archive import netcdf
from compasslib.archive.files import read_json, write_json
from compasslib.calibrations import at_mooring
from compasslib.deviation import describe_fit, deviation_json, fit_deviation
from compasslib.preparation.references import combine_references


def fit(
    mooring: str,
    *,
    record: str,
    pairs: str,
    field: str,
    fit: str,
    method: str,
    tilt: bool,
    given: Mapping[str, Any] | None,
    say: Callable[[str], None],
) -> None:
    """Write the fit, or the compass that the YAML file gives.

    Args:
        tilt: whether pitch and roll enter.
        given: arguments of ``at_mooring.compass_from_coefficients``, None where the compass is fitted.
    """
    own, near = netcdf.read_record(record, velocities=False), combine_references(netcdf.read_pairs(pairs))
    if given is not None:
        known = at_mooring.compass_from_coefficients(**given, record=own, pairs=near)
        write_json(fit, deviation_json(known, own) | {"calibration": {"name": "of the mooring's file", "kind": method}})
        say(describe_fit(mooring, known))
        return
    dip_ratio = tilt * earthfield.dip_ratio(earthfield.field_from_json(read_json(field)))
    fitted = fit_deviation(method, near, dip_ratio=dip_ratio)
    write_json(fit, deviation_json(fitted, own))
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
