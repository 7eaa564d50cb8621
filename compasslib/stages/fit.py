"""Calibrate compasses, fit the deviation model to pairs, or convert a calibration to the field of a mooring."""

import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from compasslib import calibrations, earthfield
from compasslib.archive import calibrations as archived
from compasslib.archive import netcdf, provenance
from compasslib.archive.files import read_json, write_json
from compasslib.calibrations import at_mooring, result
from compasslib.deviation import describe_fit, deviation_json, fit_deviation
from compasslib.deviation.exact import recognize_frame
from compasslib.deviation.model import IRON_NT, SPHERE_NT, weak_field_warnings
from compasslib.preparation.references import combine_references
from compasslib.stages import Files, Say, Settings


def fit(mooring: str, files: Files, say: Say, *, method: str, given: Settings | None, sphere: bool) -> None:
    """Write the compass fitted to the pairs, or the one ``given`` in the YAML file; ``sphere``: iron is declared.

    Args:
        given: arguments of ``at_mooring.compass_from_coefficients``, None where the compass is fitted.
        sphere: whether iron near the compass is declared.
    """
    upper = netcdf.read_record(files.record, velocities=False)
    near = combine_references(netcdf.read_pairs(files.pairs))
    there = earthfield.field_from_json(read_json(files.field))
    if given is None:
        made, origin = fit_deviation(method, near), {}
    else:
        made = at_mooring.compass_from_coefficients(**given, record=upper, pairs=near)
        origin = {"calibration": {"name": "of the mooring's file", "kind": method}}
    warnings = (*made.warnings, *weak_field_warnings(there.horizontal_nT))
    made = replace(made, warnings=warnings, iron_declared=sphere, mistake=recognize_frame(near, made))
    write_json(files.fit, deviation_json(made, upper) | origin)
    say(describe_fit(mooring, made))


def transfer_calibration(mooring: str, files: Files, say: Say, *, parts: Sequence[str], sphere: bool) -> None:
    """Write the compass of one calibration, or of those before and after, in the mooring's field; nothing is fitted.

    Args:
        parts: parts mounted near the mooring's compass.
        sphere: whether iron near it is declared.
    """
    upper, there = netcdf.read_record(files.record), earthfield.field_from_json(read_json(files.field))
    elsewhere = [read_json(path) for path in files.calibrations]
    near = combine_references(netcdf.read_pairs(files.pairs))
    iron_nT = SPHERE_NT if sphere else IRON_NT
    carried, origin = at_mooring.carry_to_mooring(elsewhere, there, upper, near, parts=parts, iron_nT=iron_nT)
    write_json(files.fit, deviation_json(carried, upper) | origin)
    say(describe_fit(mooring, carried))


def calibrate(name: str, files: Files, say: Say, *, kind: str, settings: Settings) -> None:
    """Write coefficients, deviation table, points and uncertainty budget of a calibration."""
    settled = earthfield.resolve_settings(settings)
    made = calibrations.calibrate(kind, files.raw, settled)
    page = result.to_json(name, made, settled) | {"source_files": list(files.raw)}
    page |= {"software": provenance.software(), "date_created": provenance.date_created()}
    archived.write(page=page, made=made, calibration=files.calibration, table=files.table, points=files.points)
    say(result.log_line(page))


def compare_calibrations(name: str, files: Files, say: Say) -> None:
    """Write the files of a calibration, with its comparison with ``others`` in calibration.json."""
    page = read_json(files.calibration)
    others = {Path(path).parent.name: read_json(path) for path in files.others}
    write_json(files.compared, page | result.compare_all(name, page, others))
    for source, copy in zip((files.table, files.points), files.made, strict=True):
        shutil.copyfile(source, copy)
    say(f"{name}: compared with {', '.join(others) or 'no other calibration'}")
