"""Join the records of one compass: what they share, which does not belong, what each may take from the others."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from compasslib.archive import netcdf
from compasslib.joint import content, members


def run(
    name: str,
    /,
    *,
    summaries: Sequence[str],
    calibrations: Sequence[str],
    spheres: Mapping[str, str | None],
    min_effect_deg: float,
    joined: str,
    diagnosis: str,
    say: Callable[[str], None],
) -> None:
    """Write compass.json and the diagnosis of the compass.

    Args:
        summaries: what each mooring's record tells, ``members.summary``.
        calibrations: calibration.json of its calibrations.
        spheres: by the names of moorings and calibrations.
        min_effect_deg: visible size of a shared effect below which it does not matter.
    """
    moored = [netcdf.read_json(path) for path in summaries]
    calibrated = [netcdf.read_json(path) for path in calibrations]
    records = [members.of_mooring(one, spheres[one["name"]]) for one in moored]
    records += [members.of_calibration(one, spheres[one["name"]]) for one in calibrated]
    page, found = content.joined(name, records, min_effect_deg)
    netcdf.write_json(joined, page)
    netcdf.write_json(diagnosis, found.to_json())
    say(content.log_line(page, found))
