"""Skill of the prediction of the current between two instruments, on real profiles with one bin as the reference.

    python benchmarks/water.py                 cross-flow noise, and the error of fitted headings
    python benchmarks/water.py --cores 1

One bin of a real moored profile is the reference; the affected instrument is the bins beyond a gap, rotated by a
simulated compass near iron. The bins of one instrument share their compass, so both differ by the water only. The
reference bin is not used in the prediction. Needs ../shared/data, and reports if it is absent.
"""

import argparse
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import real
import targets

from compasslib import angles, compass
from compasslib.deviation import fit_deviation
from compasslib.deviation.average import average_with_none
from compasslib.deviation.model import nearest_root
from compasslib.preparation.pairs import PairRules, find_pairs, mean_of_nearest_bins
from compasslib.preparation.water import predict_water, usable_velocities
from compasslib.records import EarthField, Record

GAPS = {"eh2": (1, 2, 4), "papa": (1, 2)}  # cells between the reference bin and the nearest affected bin
IRON = {
    "none": (0.0, 0.0, 0.0, 0.0, 0.0),
    "weak": (0.0, 0.2, -0.1, 0.02, 0.01),
    "strong": (0.02, -0.5, 0.4, 0.03, -0.02),
    "two-valued": (0.0, -1.1, 0.7, 0.02, -0.01),
}
SLOWEST_M_S = 0.02


class Case(NamedTuple):
    """One bin of one record as the reference, and cells between it and the nearest bin of the affected instrument."""

    record: str
    depth: int
    gap: int


def seen_by(record: Record, coefficients: tuple[float, ...]) -> Record:
    """Simulate a record by a compass near iron: another heading, and velocities rotated by its error."""
    recorded = compass.recorded_heading(coefficients, record.heading_deg)
    turn = angles.difference(recorded, record.heading_deg)[:, None]
    east, north = angles.turn(record.east, record.north, turn)
    return replace(record, east=east, north=north, heading_deg=recorded, serial_number=None)


def across(case: Case) -> tuple[np.ndarray, np.ndarray, float]:
    """Compute cross-flow errors of mean and prediction, (n,) m/s, NaN if slow or bad, and the stated error, m/s."""
    record = real.profile(case.record)
    trusted = real.bins_of(record, slice(case.depth, case.depth + 1))
    top = real.bins_of(record, slice(case.depth + case.gap, None))
    plain, _ = mean_of_nearest_bins(top, np.zeros(len(top.time_s)), 2)
    found = predict_water(top, trusted.bin_depth_m()[:, 0], 2)
    assert found is not None
    truth = trusted.east[:, 0] + 1j * trusted.north[:, 0]
    known = np.isfinite(truth * plain * found.velocity) & usable_velocities(trusted)[:, 0]
    fast = known & (np.abs(truth) > SLOWEST_M_S)
    with np.errstate(invalid="ignore", divide="ignore"):
        off = [np.imag((one - truth) * np.conj(truth) / np.abs(truth)) for one in (plain, found.velocity)]
    before, after = (np.where(fast, x, np.nan) for x in off)
    return before, after, found.expected_m_s


def fall(case: Case) -> tuple[float, float, float]:
    """Compute the reduction of cross-flow noise by the prediction, percent, and its stated and true rms, m/s."""
    *off, expected = across(case)
    before, after = (float(np.sqrt(np.nanmean(x**2))) for x in off)
    return 100.0 * (1.0 - after / before), expected, after


def heading_error(case: Case) -> list[tuple[str, float, float, float, float]]:
    """Compute rms heading errors in degrees for each iron, and the error of A over its σ.

    Errors are those of the fit without and with the prediction, and of its average with a compass without deviation.
    """
    record = real.profile(case.record)
    trusted = real.as_trusted(record, case.depth)
    field = EarthField(record.time_s[[0, -1]], np.zeros(2), *np.full((2, 2), 12000.0), np.zeros(2))
    result = []
    for name, coefficients in IRON.items():
        top = seen_by(real.bins_of(record, slice(case.depth + case.gap, None)), coefficients)
        rules = (PairRules(max_metres=1000.0, predict=predict) for predict in (False, True))
        plain, fit = (fit_deviation("exact", find_pairs(top, [trusted], field, each)) for each in rules)
        errors = []
        for used in (plain, fit, average_with_none(fit)[0]):
            heading = nearest_root(compass.inverse(used.coefficients, top.heading_deg), record.heading_deg)
            errors.append(angles.rms(angles.difference(heading, record.heading_deg)[np.isfinite(heading)]))
        off = fit.coefficients[0] - coefficients[0]
        result.append((name, *errors, float(off / np.sqrt(fit.covariance[0, 0]))))
    return result


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--cores", type=int, default=2)
    asked = parser.parse_args()
    there = [record for record in GAPS if record in real.available()]
    print(f"not measured: {[*GAPS.keys() - there]} not in {real.DATA}" if len(there) < len(GAPS) else "", end="")
    every = [Case(record, depth, gap) for record in there for gap in GAPS[record] for depth in real.DEPTHS]
    if not every:
        sys.exit(0)
    reduced = [fall(one) for one in every]
    with ProcessPoolExecutor(asked.cores) as pool:
        errors = list(pool.map(heading_error, every))
    targets.head("record", "gap, cells", "noise across the flow falls, %", "stated / real rms",
                 "ratio of heading errors", "worst", "A off, over its σ, rms")  # fmt: skip
    for record, gap in dict.fromkeys((one.record, one.gap) for one in every):
        some = [k for k, one in enumerate(every) if (one.record, one.gap) == (record, gap)]
        falls = np.array([reduced[k][0] for k in some])
        stated = np.array([reduced[k][1] / reduced[k][2] for k in some])
        ratio = np.array([after / before for k in some for _, before, after, *_ in errors[k]])
        sure = float(np.sqrt(np.mean([off**2 for k in some for *_, off in errors[k]])))
        middles = (targets.middle(values, fewest=len(real.DEPTHS)) for values in (falls, stated, ratio))
        targets.line(record, gap, *middles, f"{ratio.max():.2f}", f"{sure:.2f}")
    ratio = np.array([after / before for one in errors for _, before, after, *_ in one])
    print(f"\nAll: ratio of the errors of the fitted headings {targets.middle(ratio)}, worst {ratio.max():.2f}")
    error = "error of the headings without the prediction, median, °"
    targets.head("iron", error, "with it", "averaged with no deviation")
    for name in IRON:
        each = np.array([found[:3] for one in errors for iron, *found in one if iron == name])
        targets.line(name, *(f"{value:.2f}" for value in np.median(each, axis=0)))


if __name__ == "__main__":
    main()
