"""Read one instrument: from its raw export to its record inside the deployment."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from compasslib import readers
from compasslib.archive import netcdf, provenance
from compasslib.preparation.deployment import add_covariates, add_field_strength, apply_deployment, describe_record
from compasslib.records import Record


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
) -> None:
    """Write the record of one instrument.

    Args:
        raw: raw files of the instrument, in order.
        companions: other files that the settings name.
        form: a format of ``readers.FORMATS``.
        reader: keys of the mooring's YAML file that are arguments of the reader.
        deployment: arguments of ``deployment.apply_deployment``.
        series: covariates to add to the record: files, columns and unit by name.

    Raises:
        InputError: a raw file cannot be read.
    """
    settled = record_of(raw, form, reader, deployment, series)
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
) -> Record:
    """Return the record of one instrument; arguments and errors as for ``read``."""
    read = readers.read(form, [Path(file) for file in raw], reader)
    return add_covariates(add_field_strength(apply_deployment(read, **deployment)), series)
