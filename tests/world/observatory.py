"""Writer of hourly means of a magnetic observatory in IAGA-2002, the format of the data centres."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from compasslib.demo.water import Floats

HEAD = (
    ("Format", "IAGA-2002"), ("Source of Data", "simulated"), ("Station Name", "Nowhere"), ("IAGA CODE", "NWH"),
    ("Geodetic Latitude", "{latitude:.3f}"), ("Geodetic Longitude", "{longitude:.3f}"), ("Elevation", "10"),
    ("Reported", "XYZF"), ("Sensor Orientation", "HDZ"), ("Digital Sampling", "1 second"),
    ("Data Interval Type", "60-minute (00-59)"), ("Data Type", "definitive"),
)  # fmt: skip


def write(path: Path, time_s: Floats, field: tuple[Floats, Floats, Floats], place_deg: tuple[float, float]) -> None:
    """Write the field at an observatory as one file.

    Args:
        time_s: UTC seconds, an hour apart, (n,).
        field: declination, degrees east, horizontal and vertical field, nT, (n,) each.
        place_deg: latitude north and longitude east.
    """
    declination, horizontal, vertical = field
    north, east = horizontal * np.cos(np.deg2rad(declination)), horizontal * np.sin(np.deg2rad(declination))
    place = {"latitude": place_deg[0], "longitude": place_deg[1] % 360.0}
    lines = [f" {key:<23}{value.format(**place):<45}|" for key, value in HEAD]
    lines.append(f"{'DATE       TIME         DOY     NWHX      NWHY      NWHZ      NWHF':<69}|")
    stamps = time_s.astype("datetime64[s]")
    days = (stamps.astype("datetime64[D]") - stamps.astype("datetime64[Y]")).astype(int) + 1
    modulus = np.sqrt(horizontal**2 + vertical**2)
    texts = np.char.replace(np.datetime_as_string(stamps, unit="ms"), "T", " ").tolist()
    columns = (x.tolist() for x in (days, north, east, vertical, modulus))
    rows = zip(texts, *columns, strict=True)
    lines += ["{} {:03d}    {:9.2f} {:9.2f} {:9.2f} {:9.2f}".format(*row) for row in rows]
    path.write_text("\n".join(lines) + "\n")
