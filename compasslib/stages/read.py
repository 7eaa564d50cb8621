"""Read raw exports to records inside the deployment, and find where records of two instruments overlap."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from compasslib import earthfield, readers
from compasslib.archive import netcdf, provenance
from compasslib.archive.files import read_json, write_json
from compasslib.calibrations.observatory import with_observatory_warnings
from compasslib.deviation.reference import reference_compass
from compasslib.preparation.deployment import (
    add_covariates,
    add_field_strength,
    apply_deployment,
    depth_of_pressure,
    describe_record,
    follow_neighbour,
    to_utc,
)
from compasslib.preparation.pairs import (
    PairRules,
    describe_pairs,
    estimate_clock_offset,
    find_pairs,
    match_ready_pairs,
    widen_rules,
)
from compasslib.preparation.references import join_references
from compasslib.readers import table
from compasslib.readers.matlab import PAIR_ROLES, read_ready_pairs
from compasslib.records import Record, ReferenceCompass


def read(
    mooring: str,
    role: str,
    *,
    raw: Sequence[str],
    companions: Sequence[str],
    record: str,
    form: str,
    reader: Mapping[str, Any],
    deployment: Mapping[str, Any],
    series: Mapping[str, Mapping[str, Any]],
    say: Callable[[str], None],
    neighbour: Mapping[str, Any] | None = None,
) -> None:
    """Write the record of one instrument.

    Args:
        companions: other files that the settings name.
        form: a format of ``readers.FORMATS``.
        reader: arguments of the reader.
        deployment: arguments of ``deployment.apply_deployment``.
        series: covariates to add to the record: files, columns and unit by name.
        neighbour: whose pressure gives the depth: ``table`` with time and pressure, or ``raw``, ``form``, ``reader``
            and ``deployment``; with ``name`` and ``depths_m`` of ``deployment.follow_neighbour``.

    Raises:
        InputError: a raw file cannot be read.
    """
    settled = record_of(raw, form, reader, deployment, series, neighbour)
    sources = provenance.hashes([*raw, *companions])
    made = provenance.origin("record read", sources) | {netcdf.SOURCES: json.dumps(sources)}
    netcdf.write_record(record, settled, attributes=made)
    say(describe_record(mooring, role, settled))


def record_of(
    raw: Sequence[str],
    form: str,
    reader: Mapping[str, Any],
    deployment: Mapping[str, Any],
    series: Mapping[str, Mapping[str, Any]],
    neighbour: Mapping[str, Any] | None = None,
) -> Record:
    """Return the record of one instrument; arguments and errors as for ``read``."""
    read = readers.read(form, list(map(Path, raw)), reader)
    if neighbour is not None:
        if "table" in neighbour:
            time_s, pressure, _ = table.read_series(neighbour["table"])
            depth_m = depth_of_pressure(pressure, deployment["latitude"])
        else:
            other = readers.read(neighbour["form"], list(map(Path, neighbour["raw"])), neighbour["reader"])
            measured = apply_deployment(other, **neighbour["deployment"])
            time_s, depth_m = measured.time_s, measured.depth_m
        span, offset = (deployment["start_s"], deployment["end_s"]), deployment["clock_offset_seconds"]
        utc = replace(read, time_s=to_utc(read.time_s, span, offset, deployment["clock_drift_seconds"]))
        keys = {"depths_m": neighbour["depths_m"], "name": neighbour["name"], "water_depth": deployment["water_depth"]}
        read = replace(follow_neighbour(utc, time_s, depth_m, **keys), time_s=read.time_s)
    return add_covariates(add_field_strength(apply_deployment(read, **deployment)), series)


def overlap(
    mooring: str,
    *,
    record: str,
    references: Sequence[str],
    observatory: Sequence[str],
    ready: Sequence[str],
    field: str,
    pairs: str,
    wide: str,
    place: Mapping[str, Any],
    rules: Mapping[str, Any],
    columns: Mapping[str, Any] | None,
    compasses: Sequence[Mapping[str, Any]],
    say: Callable[[str], None],
) -> None:
    """Write the field along the deployment, the pairs by the rules, and pairs by rules for larger separations.

    Args:
        observatory: IAGA-2002 files of one observatory, possibly none.
        ready: file of ready-made pairs, which replace those of the records; empty if there is none.
        place: arguments of ``earthfield.field_along``.
        columns: headers or variables of the ready-made file by role, and ``scale``.
        compasses: arguments of ``reference_compass`` for each reference.

    Raises:
        InputError: a file of pairs or of an observatory cannot be read, or a date lies outside the model of the field.
    """
    along = with_observatory_warnings(earthfield.field_along(**place), observatory)
    write_json(field, vars(along))
    along = earthfield.field_from_json(read_json(field))  # as every later stage reads it
    say(earthfield.describe_field(mooring, along))
    above, below = netcdf.read_record(record), [netcdf.read_record(file) for file in references]
    # Named relative to the mooring's folder, so that the bytes of the file do not depend on its location.
    sources = {f"work/{Path(file).name}": known for file, known in provenance.hashes([record, *references]).items()}
    made = provenance.origin("pairs found", sources)
    if ready and columns is not None:
        rows = read_ready_pairs(Path(ready[0]), {role: columns[role] for role in PAIR_ROLES})
        matched = match_ready_pairs(rows, columns["scale"], above, along)
        matched = replace(matched, compass=reference_compass("reference", along, magnetic=True))
        known = provenance.hashes(ready)
        made = provenance.origin("ready-made pairs read", known) | {netcdf.SOURCES: json.dumps(known)}
        for file in (wide, pairs):
            netcdf.write_pairs(file, matched, attributes=made)
        say(describe_pairs(mooring, matched))
        return
    asked = PairRules(**rules)
    each = [[reference] for reference in below] or [[]]
    clocks = [estimate_clock_offset(above, reference, asked) for reference in each]
    trusted: list[ReferenceCompass | None] = [reference_compass(field=along, **keys) for keys in compasses]
    for file, by in ((wide, widen_rules(asked)), (pairs, asked)):
        by_reference = [
            replace(find_pairs(above, r, along, by, clock), compass=compass)
            for r, clock, compass in zip(each, clocks, trusted or [None], strict=True)
        ]
        joined = join_references(by_reference, [Path(file).stem for file in references])
        netcdf.write_pairs(file, joined, attributes=made)
    say(describe_pairs(mooring, joined))
