"""WinADCP text exports of series, modelled on exports quoted by other programs that read them."""

from datetime import datetime, timedelta

import numpy as np

START = datetime(2015, 8, 29, 20, 7, 17)
BINS, ROWS = 4, 50
RNG = np.random.default_rng(8)
CURRENTS = RNG.integers(-800, 800, (2, ROWS, BINS))  # east and north, mm/s
HEADINGS = np.round(RNG.uniform(0.0, 359.9, ROWS), 1)
FIRST, SIZE = 39.73, 32.0


def export(names: tuple[str, str] = ("Eas", "Nor"), bad: int = -32768, orientation: str | None = "Up") -> str:
    """Compose an export; the velocity in the last bin of the second row is bad."""
    head = ["Ens", "YR", "MO", "DA", "HH", "MM", "SS", "HH", "Pit", "Rol", "Hea", "Tem", "Dep"]
    head += ["Ori"] * (orientation is not None) + ["BIT", "Bat"]
    units = ["", "", "", "", "", "", "", "", "deg", "deg", "deg", "degC", "m"] + [""] * (len(head) - 13)
    unit = ["mm/s", "mm/s" if names[1] == "Nor" else "deg"]
    bins = [str(k + 1) for k in range(BINS)] * 2
    lines = [
        "",
        r'"C:\data\DPL3_034.000"',
        '"Workhorse Sentinel"',
        "",
        "Pings/Ens = \t120",
        "Time/Ping = 00:05.00",
        "First Ensemble Date = 15/08/29",
        "First Ensemble Time = 20:07:17.17",
        "Ensemble Interval (s) = 3600",
        f"1st Bin Range (m) = {FIRST}",
        f"Bin Size (m) = \t{SIZE:g}",
        "",
        "\t".join([*head, *(name for name in names for _ in range(BINS))]),
        "\t".join([*units, *(u for u in unit for _ in range(BINS))]),
        "\t".join([*[""] * len(head), *bins]),
    ]
    east, north = CURRENTS.astype(float)
    polar = np.hypot(east, north), np.degrees(np.arctan2(east, north)) % 360.0
    values = (east, north) if names[0] == "Eas" else polar
    for i in range(ROWS):
        when = START + timedelta(hours=i)
        clock = (when.month, when.day, when.hour, when.minute, when.second, 17)
        cells = [str(i + 1), f"{when:%y}", *(f"{x:g}" for x in clock)]
        cells += ["1.20", "-0.40", f"{HEADINGS[i]:.2f}", "7.30", "45.0"]
        cells += [orientation or ""] * (orientation is not None) + ["0", "160"]
        for component in values:
            shown = [f"{x:.3f}".rstrip("0").rstrip(".") for x in component[i]]
            cells += [*shown[:-1], str(bad)] if i == 1 else shown
        lines.append("\t".join(cells))
    return "\r\n".join(lines) + "\r\n"
