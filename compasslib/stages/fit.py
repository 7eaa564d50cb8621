"""Fit the deviation model to the pairs, or convert a calibration to the field of the mooring."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from compasslib import earthfield
from compasslib.archive import netcdf
from compasslib.archive.files import read_json, write_json
from compasslib.calibrations import at_mooring
from compasslib.deviation import describe_fit, deviation_json, fit_deviation
from compasslib.deviation.model import IRON_NT, SPHERE_NT, weak_field_warnings
from compasslib.preparation.references import combine_references


def fit(
    mooring: str,
    *,
    record: str,
    pairs: str,
    field: str,
    fit: str,
    method: str,
    given: Mapping[str, Any] | None,
    sphere: bool,
    say: Callable[[str], None],
) -> None:
    """Write the fitted compass, or the one given in the YAML file.

    Args:
        given: arguments of ``at_mooring.compass_from_coefficients``, None where the compass is fitted.
        sphere: whether iron near the compass is declared.
    """
    upper, near = netcdf.read_record(record, velocities=False), combine_references(netcdf.read_pairs(pairs))
    there = earthfield.field_from_json(read_json(field))
    weak = weak_field_warnings(there.horizontal_nT)
    if given is None:
        made, origin = fit_deviation(method, near), {}
    else:
        made = at_mooring.compass_from_coefficients(**given, record=upper, pairs=near)
        origin = {"calibration": {"name": "of the mooring's file", "kind": method}}
    made = replace(made, warnings=(*made.warnings, *weak), iron_declared=sphere)
    write_json(fit, deviation_json(made, upper) | origin)
    say(describe_fit(mooring, made))


def transfer_calibration(
    mooring: str,
    *,
    calibrations: Sequence[str],
    record: str,
    pairs: str,
    field: str,
    parts: Sequence[str],
    sphere: bool,
    fit: str,
    say: Callable[[str], None],
) -> None:
    """Write the compass of a calibration, converted to the mooring's field.

    Args:
        calibrations: calibration.json of one calibration, or of those before and after the deployment.
        pairs: file of pairs, used for comparison only: nothing is fitted to them.
        parts: parts mounted near the mooring's compass.
        sphere: whether iron near it is declared.
    """
    upper, there = netcdf.read_record(record), earthfield.field_from_json(read_json(field))
    elsewhere = [read_json(path) for path in calibrations]
    near = combine_references(netcdf.read_pairs(pairs))
    iron_nT = SPHERE_NT if sphere else IRON_NT
    carried, origin = at_mooring.carry_to_mooring(elsewhere, there, upper, near, parts=parts, iron_nT=iron_nT)
    write_json(fit, deviation_json(carried, upper) | origin)
    say(describe_fit(mooring, carried))
