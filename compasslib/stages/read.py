"""Read raw exports, or those simulated here, to records inside the deployment, and find where two records overlap."""

import json
import os
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from compasslib import earthfield, readers
from compasslib.archive import netcdf, provenance
from compasslib.archive.files import read_json, write_json
from compasslib.calibrations.observatory import with_observatory_warnings
from compasslib.deviation.model import reference_compass
from compasslib.errors import InputError
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
from compasslib.records import EarthField, Pairs, Record
from compasslib.stages import Files, Say, Settings
from compasslib.statistics.whitening import sampling_interval_s
from compasslib.types import HOUR_S


def read(
    mooring: str, role: str, files: Files, say: Say, *, form: str, reader: Settings, deployment: Settings,
    series: Mapping[str, Settings], neighbour: Settings | None = None,
) -> None:  # fmt: skip
    """Write the ``record`` of one instrument, see ``record_of``; ``companions`` are files that the settings name."""
    settled = record_of(files.raw, form, reader, deployment, series, neighbour)
    sources = provenance.hashes([*files.raw, *files.companions])
    made = provenance.origin("record read", sources) | {netcdf.SOURCES: json.dumps(sources)}
    netcdf.write_record(files.record, settled, attributes=made)
    say(describe_record(mooring, role, settled))


def record_of(
    raw: Sequence[str], form: str, reader: Settings, deployment: Settings, series: Mapping[str, Settings],
    neighbour: Settings | None = None,
) -> Record:  # fmt: skip
    """Return the record of one instrument.

    Args:
        deployment: arguments of ``deployment.apply_deployment``.
        series: covariates to add to the record: files, columns and unit by name.
        neighbour: whose pressure gives the depth: ``table`` with time and pressure, or ``raw``, ``form``, ``reader``
            and ``deployment``; with ``name`` and ``depths_m`` of ``deployment.follow_neighbour``.
    """
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
    mooring: str, files: Files, say: Say, *, place: Settings, rules: Settings, columns: Settings | None,
    compasses: Sequence[Settings], rotors: Sequence[bool],
) -> None:  # fmt: skip
    """Write the ``field``, and the ``pairs`` of the records or ``ready`` ones, also ``wide`` ones, further apart.

    Args:
        place: arguments of ``earthfield.field_along``.
        columns: headers or variables of the ready-made file by role, and ``scale``.
        compasses: arguments of ``reference_compass`` for each reference.
        rotors: whether each reference counts its speed by a mechanical rotor.
    """
    along = with_observatory_warnings(earthfield.field_along(**place), files.observatory)
    write_json(files.field, vars(along))
    along = earthfield.field_from_json(read_json(files.field))  # as every later stage reads it
    say(earthfield.describe_field(mooring, along))
    above = netcdf.read_record(files.record)
    if files.ready and columns is not None:
        rows = read_ready_pairs(Path(files.ready[0]), {role: columns[role] for role in PAIR_ROLES})
        matched = match_ready_pairs(rows, columns["scale"], above, along)
        pairs_by_rules = [replace(matched, compass=reference_compass("reference", along, magnetic=True))] * 2
        sources = provenance.hashes(files.ready)
        made = provenance.origin("ready-made pairs read", sources) | {netcdf.SOURCES: json.dumps(sources)}
    else:
        pairs_by_rules = _find_pairs(above, files.references, along, PairRules(**rules), compasses, rotors)
        # Named relative to the mooring's folder, so that the bytes of the file do not depend on its location.
        hashes = provenance.hashes([files.record, *files.references])
        made = provenance.origin("pairs found", {f"work/{Path(path).name}": known for path, known in hashes.items()})
    for path, pairs in zip((files.wide, files.pairs), pairs_by_rules, strict=True):
        netcdf.write_pairs(path, pairs, attributes=made)
    say(describe_pairs(mooring, pairs_by_rules[-1]))


def _find_pairs(
    above: Record, references: Sequence[str], along: EarthField, rules: PairRules, compasses: Sequence[Settings],
    rotors: Sequence[bool],
) -> list[Pairs]:  # fmt: skip
    """Find the pairs with all references by wider rules and by the rules themselves."""
    each = [[netcdf.read_record(path)] for path in references]
    known: list[Settings] = [
        {
            "compass": reference_compass(field=along, **keys),
            # A rotor counts from one record to the next (Aanderaa RCM): its speeds are of half an interval earlier.
            "speed_late_h": 0.5 * sampling_interval_s(record.time_s) / HOUR_S if rotor else 0.0,
        }
        for (record,), keys, rotor in zip(each, compasses, rotors, strict=True)
    ]
    each, known = each or [[]], known or [{}]
    clocks = [estimate_clock_offset(above, reference, rules) for reference in each]
    return [
        join_references(
            [
                replace(find_pairs(above, reference, along, by, clock, several=len(each) > 1), **also)
                for reference, clock, also in zip(each, clocks, known, strict=True)
            ],
            [Path(path).stem for path in references],
        )
        for by in (widen_rules(rules), rules)
    ]


def simulate(files: Files, say: Say, *, name: str, seed: int) -> None:
    """Write the ``raw`` files of a mooring, and the ``truth`` to a separate file."""
    from compasslib.demo import concealed, demonstration

    world = concealed if name in concealed.CASES else demonstration
    made = [*files.raw, files.truth]
    Path("raw").mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{name}", dir="raw") as temporary:
        folder = Path(temporary)
        world.write_mooring(name, folder / "raw", folder / files.truth, seed)
        if missing := [file for file in made if not (folder / file).is_file()]:
            advice, actual = "name the files as the simulation does", "one that it does not write"
            raise InputError(missing[0], f"a raw file of the simulation of {name}", actual, advice)
        for file in made:
            Path(file).parent.mkdir(parents=True, exist_ok=True)
            os.replace(folder / file, file)
    say(f"{name}: simulated raw files written; the truth stands apart in {files.truth}")
