"""Skill of the prediction of the current between two instruments, on real profiles with one bin as the reference.

    python benchmarks/water.py                 cross-flow noise, and the error of fitted headings
    python benchmarks/water.py --cores 1

One bin of a real moored profile is the reference; the affected instrument is the bins beyond a gap, rotated by a
simulated compass near iron. The bins of one instrument share their compass, so both differ by the water only. The
reference bin is not used in the prediction. Needs ../shared/data, and reports if it is absent.
"""

import argparse
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import targets
from runs import DATA

from compasslib import angles, compass, readers
from compasslib.deviation import fit_deviation
from compasslib.deviation.average import average_with_none
from compasslib.deviation.model import nearest_root
from compasslib.preparation.deployment import apply_deployment
from compasslib.preparation.pairs import PairRules, find_pairs, mean_of_nearest_bins
from compasslib.preparation.water import predict_water, usable_velocities
from compasslib.records import EarthField, Record

DEPTHS, GAPS = range(8), (1, 2, 4)  # bins used as the reference, and cells between it and the nearest affected bin
IRON = {
    "none": (0.0, 0.0, 0.0, 0.0, 0.0),
    "weak": (0.0, 0.2, -0.1, 0.02, 0.01),
    "strong": (0.02, -0.5, 0.4, 0.03, -0.02),
    "two-valued": (0.0, -1.1, 0.7, 0.02, -0.01),
}
SLOWEST_M_S = 0.02
FILES = {"eh2": "pd0/eh2_20060530_20060717_0007m.000", "papa": "moored/papa_node59p1.npz"}


@dataclass(frozen=True)
class Case:
    """One bin of one record as the reference."""

    record: str
    depth: int
    gap: int


@cache
def profile(name: str) -> Record:
    """Read a real moored profile, with its depth set constant."""
    if name == "eh2":
        record = readers.read("pd0", [DATA / FILES["eh2"]], {})
        span = {"start_s": record.time_s[0], "end_s": record.time_s[-1], "latitude": 47.6}
        record = apply_deployment(record, **span, water_depth=45.5, nominal_depth=7.0)
        return replace(record, depth_m=np.full(len(record.time_s), 7.0), direction_reference="magnetic")
    file = np.load(DATA / FILES["papa"])
    velocity = file["vel"].astype(float)
    n, bins = velocity.shape[:2]
    flat, usable = np.full(n, np.nan), np.isfinite(velocity[:, :, :2]).all(axis=2)
    return Record(
        time_s=file["time"].astype("datetime64[s]").astype(float),
        east=velocity[:, :, 0],
        north=velocity[:, :, 1],
        bin_range_m=np.tile(30.0 + 20.0 * np.arange(bins), (n, 1)),
        heading_deg=file["heading"],
        pitch_deg=file["pitch"],
        roll_deg=file["roll"],
        pressure_dbar=flat,
        depth_m=np.full(n, 490.0),
        temperature_c=file["temperature"],
        supply_voltage=flat,
        quality=np.where(usable, 1, 9).astype(np.int8),
        heading_quality=np.ones(n, dtype=np.int8),
    )


def bins_of(record: Record, which: slice) -> Record:
    """Select some bins of a record."""
    columns = {name: getattr(record, name)[:, which] for name in ("east", "north", "bin_range_m", "quality")}
    return replace(record, **columns)


def seen_by(record: Record, coefficients: tuple[float, ...]) -> Record:
    """Simulate a record by a compass near iron: another heading, and velocities rotated by its error."""
    recorded = compass.recorded_heading(coefficients, record.heading_deg)
    turn = angles.difference(recorded, record.heading_deg)[:, None]
    east, north = angles.turn(record.east, record.north, turn)
    return replace(record, east=east, north=north, heading_deg=recorded, serial_number=None)


def across(record: Record, depth: int, gap: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Compute cross-flow errors of mean and prediction, (n,) m/s, NaN if slow or bad, and the stated error, m/s.

    Args:
        depth: bin used as the reference.
        gap: cells between it and the nearest bin of the affected instrument.
    """
    trusted, top = bins_of(record, slice(depth, depth + 1)), bins_of(record, slice(depth + gap, None))
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


def fall(record: Record, depth: int, gap: int) -> tuple[float, float, float]:
    """Compute the reduction of cross-flow noise by the prediction, percent, and its stated and true rms, m/s."""
    *off, expected = across(record, depth, gap)
    before, after = (float(np.sqrt(np.nanmean(x**2))) for x in off)
    return 100.0 * (1.0 - after / before), expected, after


def as_trusted(record: Record, depth: int) -> Record:
    """Convert one bin of a record to a point meter at its depth."""
    one = bins_of(record, slice(depth, depth + 1))
    return replace(one, depth_m=one.bin_depth_m()[:, 0], bin_range_m=0.0 * one.bin_range_m, serial_number=None)


def heading_error(case: Case) -> list[tuple[str, float, float, float, float]]:
    """Compute rms heading errors in degrees for each iron, and the error of A over its σ.

    Errors are those of the fit without and with the prediction, and of its average with a compass without deviation.
    """
    record = profile(case.record)
    trusted = as_trusted(record, case.depth)
    field = EarthField(record.time_s[[0, -1]], np.zeros(2), *np.full((2, 2), 12000.0), np.zeros(2))
    result = []
    for name, coefficients in IRON.items():
        top = seen_by(bins_of(record, slice(case.depth + case.gap, None)), coefficients)
        rules = (PairRules(max_metres=1000.0, predict=predict) for predict in (False, True))
        plain, fit = (fit_deviation("exact", find_pairs(top, [trusted], field, each)) for each in rules)
        errors = []
        for used in (plain, fit, average_with_none(fit)[0]):
            heading = nearest_root(compass.inverse(used.coefficients, top.heading_deg), record.heading_deg)
            errors.append(angles.rms(angles.difference(heading, record.heading_deg)[np.isfinite(heading)]))
        off = fit.coefficients[0] - coefficients[0]
        result.append((name, *errors, float(off / np.sqrt(fit.covariance[0, 0]))))
    return result


def cases() -> Iterator[Case]:
    """Yield the cases whose record is available."""
    for record, gaps in (("eh2", GAPS), ("papa", (1, 2))):
        if not (DATA / FILES[record]).exists():
            print(f"not measured: {FILES[record]} is not in {DATA}")
            continue
        yield from (Case(record, depth, gap) for gap in gaps for depth in DEPTHS)


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--cores", type=int, default=2)
    asked = parser.parse_args()
    every = list(cases())
    if not every:
        sys.exit(0)
    reduced = [fall(profile(one.record), one.depth, one.gap) for one in every]
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
        middles = (targets.middle(values, fewest=len(DEPTHS)) for values in (falls, stated, ratio))
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
