"""Shares of velocities flagged in real records by each quality test: by default, and if a test that is off is made.

    python benchmarks/quality.py [FOLDER]   the folder of recordings, by default ../shared/data

The records are those of benchmarks/proof/records, and are not part of the project.
"""

import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import targets
from runs import DATA

from benchmarks.proof.world.records import Described, described
from compasslib import readers
from compasslib.preparation.deployment import apply_deployment
from compasslib.preparation.quality import MAKERS
from compasslib.records import PROBABLY_GOOD, Record

OFF = ({"echo_jump": 30.0}, {"spike": 7.0}, {"spike": 10.0}, {"error_velocity": 0.3}, {"correlation": 100.0})


def read(one: Described, quality: dict[str, Any]) -> Record:
    """Read a record by its description, with thresholds of the quality tests."""
    keys = one.keys
    start_s, end_s = (
        datetime.fromisoformat(str(keys[end])).replace(tzinfo=UTC).timestamp() for end in ("start", "end")
    )
    raw = readers.read(keys["format"], [one.data / keys["files"]], keys.get("settings", {}))
    return apply_deployment(
        raw, start_s=start_s, end_s=end_s, water_depth=keys["water_depth"], latitude=keys["latitude"],
        nominal_depth=keys["depth"], quality=quality,
    )  # fmt: skip


def show(one: Described) -> None:
    """Print the rows of a record: usable share before, by default, and with each test that is off by default."""
    makers = dict(MAKERS.get(one.keys["format"], {}))
    for name, limits in (("none", {}), ("default", makers), *((str(off), makers | off) for off in OFF)):
        record = read(one, limits)
        usable = np.mean(record.quality <= PROBABLY_GOOD)
        headings = np.mean(record.heading_quality <= PROBABLY_GOOD)
        name = ", ".join(f"{key} {value:g}" for key, value in limits.items() if value != makers.get(key)) or name
        targets.line(one.name, name, f"{100 * usable:.3f}", f"{100 * headings:.1f}")


if __name__ == "__main__":
    thresholds = "thresholds besides percent good, speed, tilt"
    targets.head("record", thresholds, "velocities usable (%)", "headings usable (%)")
    for each in described(Path(sys.argv[1]) if sys.argv[1:] else DATA):
        show(each)
