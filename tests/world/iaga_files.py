"""IAGA-2002 files and quiet series for tests, with a crustal offset, a daily variation and noise."""

from pathlib import Path

import numpy as np

from compasslib import earthfield
from compasslib.records import FieldSeries

LATITUDE, LONGITUDE = 55.3, -3.2
HOUR_S, DAY_S = 3600.0, 86400.0
START_S = float(np.datetime64("2003-03-01", "s").astype(float))
ROCKS_DEG = 0.2


def series(days: int, *, step_s: float = HOUR_S, seed: int = 0, swing_deg: float = 0.07) -> FieldSeries:
    """Simulate a quiet series: IGRF, crustal offset, daily variation, and noise with a memory of two hours."""
    rng = np.random.default_rng(seed)
    time_s = START_S + step_s * (np.arange(int(days * DAY_S / step_s)) + 0.5)
    keep = np.exp(-step_s / (2 * HOUR_S))
    noise = np.zeros(len(time_s))
    for k, kick in enumerate(rng.normal(0.0, 0.02 * np.sqrt(1 - keep**2), len(time_s))):
        noise[k] = keep * noise[k - 1] + kick
    daily = -swing_deg * np.sin(2 * np.pi * time_s / DAY_S)
    field = earthfield.field_along(LATITUDE, LONGITUDE, time_s[0], time_s[-1])
    declination = earthfield.declination_at(field, time_s) + ROCKS_DEG + daily + noise
    level = np.full(len(time_s), 17000.0)
    return FieldSeries(time_s, declination, level, 2.7 * level, "Made", LATITUDE, LONGITUDE, 100.0)


def header(
    letters: str,
    *,
    code: str = "MDE",
    place: bool = True,
    kind: str = "Variation",
    at: tuple[float, float] = (LATITUDE, LONGITUDE),
) -> list[str]:
    """Compose the header lines, padded as in the format; ``at`` is the latitude and longitude."""
    words = {
        "Format": "IAGA-2002", "Source of Data": "made", "Station Name": "Made", "IAGA CODE": code,
        "Geodetic Latitude": f"{at[0]:.3f}" if place else "",
        "Geodetic Longitude": f"{at[1] % 360.0:.3f}" if place else "",
        "Elevation": "100" if place else "", "Reported": letters, "Sensor Orientation": "", "Digital Sampling": "",
        "Data Interval Type": "", "Data Type": kind,
    }  # fmt: skip
    lines = [f" {label:<23}{word:<45}|" for label, word in words.items()]
    names = "".join(f"{code + letter:>10}" for letter in letters)
    return [*lines, f" {'# a comment with a date 2003-03-01':<68}|", f"DATE       TIME         DOY{names}   |"]


def rows(made: FieldSeries, letters: str) -> list[str]:
    """Format one row per time; values and elements missing from the series are 99999."""
    turn = np.deg2rad(made.declination_deg)
    h = made.horizontal_nT
    known = {
        "D": 60.0 * made.declination_deg, "H": h, "X": h * np.cos(turn), "Y": h * np.sin(turn), "Z": made.vertical_nT,
        "F": np.hypot(h, made.vertical_nT), "I": 60.0 * np.rad2deg(np.arctan2(made.vertical_nT, h)),
    }  # fmt: skip
    columns = [np.nan_to_num(known.get(x, np.full(len(made), 99999.0)), nan=99999.0) for x in letters]
    stamps = made.time_s.astype("datetime64[s]")
    day = (stamps.astype("datetime64[D]") - stamps.astype("datetime64[Y]").astype("datetime64[D]")).astype(int) + 1
    texts = [str(stamp).replace("T", " ") for stamp in stamps]
    return [
        f"{text}.000 {d:03d}    " + " ".join(f"{value:9.2f}" for value in values)
        for text, d, *values in zip(texts, day, *columns, strict=True)
    ]


def write(path: Path, made: FieldSeries, letters: str = "XYZF", **words) -> Path:
    """Write a series as an IAGA-2002 file."""
    lines = header(letters, at=(made.latitude, made.longitude), **words)
    path.write_text("\n".join([*lines, *rows(made, letters)]) + "\n")
    return path
