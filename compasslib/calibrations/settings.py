"""Settings of a calibration, completed by the earth's field at its place and date."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def resolve_settings(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Add ``field`` and ``declination_deg`` to the keys of a YAML file, as all kinds require them.

    The field is a mapping of horizontal_nT, vertical_nT and declination_deg if latitude, longitude and date are given,
    else None. The declination is the number given, else that of the field, else None.

    Raises:
        InputError: the date lies outside the model of the earth's field.
    """
    given = settings.get("declination", "auto")
    by_model = given in (None, "auto")
    latitude, longitude, date_s = (settings.get(key) for key in ("latitude", "longitude", "date_s"))
    if latitude is None or longitude is None or date_s is None:
        return {**settings, "field": None, "declination_deg": None if by_model else given}
    from compasslib import earthfield  # imported late: only needed with a place

    at = date_s if by_model else earthfield.covered_by_igrf(date_s)
    declination, horizontal, vertical = (float(x[0]) for x in earthfield.igrf(latitude, longitude, at))
    field = {"horizontal_nT": horizontal, "vertical_nT": vertical, "declination_deg": declination}
    return {**settings, "field": field, "declination_deg": declination if by_model else given}
