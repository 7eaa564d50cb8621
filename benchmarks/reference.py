"""False attribution of faults of the reference to the affected compass.

    python benchmarks/reference.py 40 1             moorings, seed
    python benchmarks/reference.py 40 1 --cores 1

Simulated years with one fault of the reference each: a deviation of its compass, a step of about 6 degrees or of 15
degrees, beams of unequal gain, a constant velocity. The exit status is 1 if more faults than the target allows are
attributed to the affected compass alone.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import targets

from compasslib import angles
from compasslib.archive import netcdf
from compasslib.demo.sealed import Wish
from compasslib.effects import SIDES
from compasslib.pipeline.process import process_mooring
from tests.world import draw

FAULTS = (
    ("reference_deviation", 3.0), ("reference_slip", 3.0), ("reference_slip", 7.5), ("reference_beams", 2.0),
    ("reference_bias", 2.0),
)  # fmt: skip
MOST = 0.05  # largest share of moorings whose fault is attributed to the affected compass alone


def measured(job: tuple[int, int]) -> dict:
    """Process one mooring; return its attribution and the errors of its headings."""
    seed, k = job
    effect, size = FAULTS[k % len(FAULTS)]
    with tempfile.TemporaryDirectory() as folder:
        one = draw.Sealed(f"R{k:03d}", {effect: size}, wish=Wish(wide=k // len(FAULTS) % 2 == 0), seed=seed)
        cruise, locked = draw.write_alone(one, Path(folder))
        results = process_mooring(cruise, one.name, Path(folder) / "results")
        found = json.loads((results / "diagnosis.json").read_text())
        product = netcdf.read_corrected(results / "corrected.nc")
        time_s, heading, *_ = np.load(locked / f"{one.name}.npy")
    at = np.searchsorted(time_s, product.record.time_s).clip(0, len(time_s) - 1)
    error = angles.difference(product.heading_corrected_deg, heading[at])
    known = np.isfinite(error) & (time_s[at] == product.record.time_s)
    sets = [[one["effect"], *one["alternatives"]] for one in found["findings"]]
    return {
        "fault": f"{effect} {size:g}°",
        "named": any(effect in names for names in sets),
        "alone": any({SIDES[name] for name in names} == {"compass"} for names in sets),
        "applied": any(one["applied"] for one in found["findings"]),
        "seen": bool(sets) or found["unexplained"] is not None,
        "rms": float(angles.rms(error[known])),
        "within": float(np.mean(np.abs(error[known]) < 1.96 * product.heading_uncertainty_deg[known])),
    }


def report(rows: Sequence[dict]) -> int:
    """Print the table and return the exit status."""
    targets.head("fault", "seen", "named with its side", "on the affected compass alone", "heading, rms", "within 95 %")
    for fault in [*dict.fromkeys(row["fault"] for row in rows), "all"]:
        some = [row for row in rows if fault in (row["fault"], "all")]
        counts = (targets.share_of(row[key] for row in some) for key in ("seen", "named", "alone"))
        rms, within = (np.mean([row[key] for row in some]) for key in ("rms", "within"))
        targets.line(fault, *counts, f"{rms:.2f}°", f"{within:.0%}")
    alone = targets.share("put on the affected compass alone", (row["alone"] for row in rows), most=MOST)
    return targets.report([alone])


def main() -> int:
    parser = targets.parser(__doc__, 40)
    parser.add_argument("--cores", type=int, default=2)
    asked = parser.parse_args()
    with ProcessPoolExecutor(asked.cores) as pool:
        return report(list(pool.map(measured, [(asked.seed, k) for k in range(asked.count)])))


if __name__ == "__main__":
    sys.exit(main())
