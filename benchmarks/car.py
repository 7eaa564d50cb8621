"""Headings of a car whose iron exceeds the earth's horizontal field, predicted from circles driven six minutes before.

    python benchmarks/car.py circles.mat drive.mat

The files are those of github.com/shrirag10/Robot-Sensing-Navigation (commit cbf6a311, LAB4; Apache License 2.0). The
exact compass is fitted to the circles and predicts the drive, each heading the one of both nearer to the course. The
truth is the course between the positions one second before and after, by GNSS.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from compasslib import angles, compass, earthfield
from compasslib.calibrations import platform
from compasslib.deviation.model import nearest_root
from compasslib.inference import kinds
from compasslib.inference.comparison import Options

PLACE = {"latitude": 42.34, "longitude": -71.09, "date": "2024-10-22"}
SLOWEST_M_S, HALF_S = 1.5, 0.25  # of a course; half of the time over which the axes are averaged


def headings(path: str, delay_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Read magnetic course and recorded heading at each position of a moving car, degrees.

    Args:
        delay_s: time by which the compass is later than the positions.
    """
    log = loadmat(path, squeeze_me=True, struct_as_record=False)
    axes, gnss = log["imu"], log["gps"]
    time_s, first = np.unique(gnss.timestamps, return_index=True)
    east, north = gnss.utm_easting[first], gnss.utm_northing[first]
    moved = np.append(True, (np.diff(east) != 0.0) | (np.diff(north) != 0.0))  # the receiver repeats positions
    time_s, east, north = time_s[moved], east[moved], north[moved]
    span_s, along = time_s[2:] - time_s[:-2], (east[2:] - east[:-2], north[2:] - north[:-2])
    moving = (np.hypot(*along) / span_s > SLOWEST_M_S) & (span_s < 2.5)
    at = time_s[1:-1] + delay_s
    moving &= (at > axes.timestamps[0] + 1.0) & (at < axes.timestamps[-1] - 1.0)
    edges = np.searchsorted(axes.timestamps, [at[moving] - HALF_S, at[moving] + HALF_S])
    x, y = (np.append(0.0, np.cumsum(each)) for each in (axes.magnetometer_x, axes.magnetometer_y))
    recorded = angles.direction(-(y[edges[1]] - y[edges[0]]), x[edges[1]] - x[edges[0]])
    declination, _, _ = earthfield.igrf(PLACE["latitude"], PLACE["longitude"], time_s[:1])
    return angles.wrap360(angles.direction(*along)[moving] - declination), recorded


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("circles")
    parser.add_argument("drive")
    asked = parser.parse_args()
    print("Delay of the compass, iron over the earth's field, A of the circles; drive: n, rms as recorded, rms, mean")
    for delay_s in (0.0, 0.4, 0.8, 1.2):
        correct, recorded = headings(asked.circles, delay_s)
        with tempfile.TemporaryDirectory() as folder:
            table = Path(folder) / "circles.csv"
            rows = np.column_stack([correct, recorded])
            np.savetxt(table, rows, "%.2f", ",", header="reference_deg,recorded_deg", comments="")
            fitted = platform.calibrate([table], {}).exact
            if not delay_s:
                print(kinds.diagnose("platform", [table], PLACE, Options()).log_line("circles"))
        correct, recorded = headings(asked.drive, delay_s)
        off = angles.difference(correct, nearest_root(compass.inverse(fitted, recorded), correct))
        before, known = angles.difference(correct, recorded), np.isfinite(off)
        print(
            f"{delay_s:.1f} s, {np.hypot(*fitted[1:3]):.2f}, {fitted[0] / angles.DEGREE:+.1f}°; {known.sum()} of "
            f"{len(off)}, {angles.rms(before):.1f}°, {angles.rms(off[known]):.1f}°, {np.mean(off[known]):+.1f}°"
        )


if __name__ == "__main__":
    main()
