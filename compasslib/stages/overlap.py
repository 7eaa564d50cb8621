"""Find overlapping measurements: two records become the earth's field there and the pairs of nearly the same water."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from compasslib import earthfield
from compasslib.archive import netcdf, provenance
from compasslib.archive.files import read_json, write_json
from compasslib.calibrations import declination
from compasslib.preparation import overlap as rules_of_pairs
from compasslib.preparation import several


def overlap(
    mooring: str,
    *,
    upper: str,
    lower: Sequence[str],
    observatory: Sequence[str],
    field: str,
    pairs: str,
    wide: str,
    place: Mapping[str, Any],
    rules: Mapping[str, Any],
    say: Callable[[str], None],
) -> None:
    """Write the field along the deployment, the pairs by the rules, and those that may stand further apart.

    Args:
        upper: record of the instrument to correct.
        lower: records of the references, perhaps none.
        observatory: IAGA-2002 files of one observatory, perhaps none.
        place: arguments of ``earthfield.along_time``.

    Raises:
        InputError: an observatory's file cannot be read, or a date lies outside the model of the field.
    """
    along = declination.with_observatory_warnings(earthfield.along_time(**place), observatory, place)
    write_json(field, vars(along))
    along = earthfield.from_json(read_json(field))  # what every later stage reads
    say(earthfield.log_line(mooring, along))
    above, below = netcdf.read_record(upper), [netcdf.read_record(file) for file in lower]
    # Named from the mooring's own folder, so that the file is the same wherever that stands.
    made = provenance.origin("pairs found", [upper, *lower], within=Path(pairs).parent)
    asked = rules_of_pairs.Rules(**rules)
    each = [[one] for one in below] or [[]]
    clocks = [rules_of_pairs.clocks(above, one, asked) for one in each]
    for file, by in ((wide, rules_of_pairs.widened(asked)), (pairs, asked)):
        found = [rules_of_pairs.find(above, one, along, by, clock) for one, clock in zip(each, clocks, strict=True)]
        every = several.joined(found, [Path(one).stem for one in lower])
        netcdf.write_pairs(file, every, attributes=made)
    say(rules_of_pairs.log_line(mooring, every))
