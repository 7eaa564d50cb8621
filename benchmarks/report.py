"""Size of the report and its loading time in a browser, for few and for many moorings.

    python benchmarks/report.py                      after make run; needs Chromium
    python benchmarks/report.py --picture docs/report.png

The moorings of the demonstration cruise are repeated to reach the number. Times are medians of five page loads.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from dataclasses import replace
from itertools import cycle, islice
from pathlib import Path
from statistics import median

PROJECT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(PROJECT / "tests"))

import browser  # noqa: E402

from compasslib import report  # noqa: E402
from compasslib.config.cruise import load_cruise  # noqa: E402
from compasslib.report import chart  # noqa: E402
from compasslib.stages import settings  # noqa: E402

COUNTS, OPENINGS = (7, 50, 200), 5
PAINTED = "performance.getEntriesByName('first-contentful-paint')[0].startTime"


def repeated(made: report.Report, count: int) -> report.Report:
    """Repeat the moorings of a report up to a number, each repetition 0.1 degrees farther east."""
    rounds = zip(islice(cycle(made.moorings.sections), count), range(count), strict=False)
    sections = [replace(one, name=f"{one.name}.{k}", anchor=f"{one.anchor}.{k}") for one, k in rounds]
    stations = [
        replace(mark.station, name=one.name, longitude=mark.station.longitude + 0.1 * (k // len(made.map.marks)))
        for k, (mark, one) in enumerate(zip(islice(cycle(made.map.marks), count), sections, strict=True))
    ]
    cells = [replace(one, cells=(one.name, *one.cells[1:])) for one in sections]
    return replace(made, moorings=replace(made.moorings, sections=cells), map=chart.chart(stations))


def main() -> None:
    """Print a line per number of moorings, or write a picture of the top of the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--picture", type=Path, help="write a picture of the page instead")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, browser.chromium(Path(folder) / "profile") as chromium:
        if asked.picture:
            chromium.open(PROJECT / "results/report.html", 1200, 1500)
            chromium.picture(asked.picture, whole=False)
            return
        print("moorings   size, MB   first paint, ms   loaded, ms   written, s")
        for count in COUNTS:
            print(measured(chromium, Path(folder) / f"{count}.html", count))


def measured(chromium: browser.Page, path: Path, count: int) -> str:
    """Measure the report of a number of moorings and format the line of the table."""
    report.MAX_SECTIONS, most = (0 if count > report.MAX_SECTIONS else report.MAX_SECTIONS), report.MAX_SECTIONS
    begin = time.perf_counter()
    described = settings.report(load_cruise(PROJECT))["moorings"]
    made = report.gather(PROJECT / "results", attributes={}, moorings=described, calibrations=[])
    report.MAX_SECTIONS = most
    report.write(path, repeated(made, count))
    written = time.perf_counter() - begin
    times = [opened(chromium, path) for _ in range(OPENINGS)]
    paint, loaded = (median(column) for column in zip(*times, strict=True))
    return f"{count:8d} {path.stat().st_size / 1e6:10.1f} {paint:17.0f} {loaded:12.0f} {written:12.1f}"


def opened(chromium: browser.Page, path: Path) -> tuple[float, float]:
    """Load a page and return the times of first paint and of complete loading, milliseconds."""
    chromium.open(path)
    chromium.ask("new Promise(done => requestAnimationFrame(() => setTimeout(done, 50)))")
    return chromium.ask(PAINTED), chromium.ask("performance.timing.loadEventEnd - performance.timing.navigationStart")


if __name__ == "__main__":
    main()
