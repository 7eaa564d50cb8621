"""Coverage of magnetometer calibrations with known iron, and results of two real logs.

    python benchmarks/magnetometer.py [DRAWS]     400 draws per scenario by default; about six minutes

Real logs are read from ../shared/data/magnetometer, if available.
"""

from __future__ import annotations

import sys
import tempfile
from collections import defaultdict
from pathlib import Path

import numpy as np
import targets
from runs import DATA

from compasslib.calibrations import magnetometer
from compasslib.calibrations.magnetometer import ellipsoid
from compasslib.deviation.series import series_design
from tests.world import iron

REAL = DATA / "magnetometer"
SCENARIOS = {
    "over the sphere, white noise 1 %": {"n": 1500},
    "over the sphere, red noise 1 %, memory 0.9": {"n": 1500, "memory": 0.9},
    "over the sphere, white noise 5 %": {"n": 1500, "noise": 0.05},
    "over the sphere, tilts logged, red noise 1 %": {"n": 1500, "memory": 0.8, "tilts": True},
    "level, tilts logged, red noise 1 %, memory 0.9": {"n": 2000, "memory": 0.9, "level": True, "tilts": True},
    "level, x and y alone, white noise 1 %": {"n": 1000, "level": True, "tilt_deg": 0.0},
    "level, x and y alone, red noise 1 %, memory 0.9": {"n": 2000, "level": True, "tilt_deg": 0.0, "memory": 0.9},
}


def calibrated(rng, folder: Path, *, n, noise=0.01, memory=0.0, level=False, tilts=False, tilt_deg=4.0):
    """Simulate and calibrate one log; return truth and calibration."""
    true = iron.some(rng)
    if level:  # without vertical iron, which cannot be determined and has a row of its own in the budget
        true = iron.Iron(true.soft, true.hard * [1.0, 1.0, 0.0], true.dip_deg)
        true.soft[2, :] = true.soft[:, 2] = [0.0, 0.0, np.mean(np.diag(true.soft)[:2])]
    motion = iron.level_motion(rng, n, tilt_deg=tilt_deg) if level else iron.tumble(rng, n)
    x, y, z = iron.readings(rng, true, motion, noise=noise, memory=memory).T
    columns = {"x": x, "y": y} | ({} if level and not tilts else {"z": z})
    columns |= {"pitch_deg": motion[:, 1], "roll_deg": motion[:, 2]} if tilts else {}
    horizontal, vertical = true.level
    field = {"horizontal_nT": 100.0 * horizontal, "vertical_nT": 100.0 * vertical, "declination_deg": 0.0}
    path = iron.write(folder / "log.csv", **columns)
    return true, magnetometer.calibrate([path], {"field": field})


def wrapped(angle_deg):
    return angle_deg - 360.0 * np.round(angle_deg / 360.0)


def errors(true, found):
    """Compute errors over stated sigma for each kind of parameter."""
    k = 2 if found.details["field_is"] == "horizontal" else 3
    upper = np.triu_indices(k)
    soft = true.soft / np.mean(np.diag(true.soft)[:k])
    values = {
        "hard iron": (found.details["hard_iron"], found.details["hard_iron_sigma"], true.hard, slice(0, k)),
        "soft iron": (found.details["soft_iron"], found.details["soft_iron_sigma"], soft, upper),
    }
    z = {
        name: (np.array(v, dtype=float)[i] - t[i]) / np.array(s, dtype=float)[i]
        for name, (v, s, t, i) in values.items()
    }
    off = found.table.deviation_deg - true.deviation(found.table.heading_deg)
    grid = np.arange(0.0, 360.0, 5.0)
    known = np.linalg.lstsq(series_design(grid), true.deviation(grid), rcond=None)[0]
    series = (found.coefficients - known)[1:] / np.sqrt(np.diag(found.covariance))[1:]  # A is zero by convention
    return z | {"heading": wrapped(off) / found.table.sigma_deg, "series": series}


def within(what: str, *z: np.ndarray) -> targets.Measured:
    """Compute the share inside the 95 % interval with its target, with an interval over draws.

    Args:
        z: errors in their own standard errors, one array per draw; in a single array each value is a draw.
    """
    draws = z[0] if len(z) == 1 else z
    shares = [float(np.mean(np.abs(one) < 1.96)) for one in draws]
    return targets.mean(f"inside 95 %: {what}", shares, least=0.93, most=0.97, unit=" %", times=100.0)


def coverage(draws: int) -> list[targets.Measured]:
    """Print coverage by scenario, and return it with its targets."""
    lines: list[targets.Measured] = []
    print(f"\nShare of truths inside the 95 % interval, {draws} draws")
    targets.head("scenario", "hard iron", "soft iron", "heading every 10°", "B to E", "model", "refused")
    with tempfile.TemporaryDirectory() as folder:
        for name, settings in SCENARIOS.items():
            rng, z, models, refused = np.random.default_rng(20), defaultdict(list), defaultdict(int), 0
            for _ in range(draws):
                true, found = calibrated(rng, Path(folder), **settings)
                models[found.model] += 1
                refused += found.table is None
                for kind, value in {} if found.table is None else errors(true, found).items():
                    z[kind].append(value)
            lines += [within(f"{name}, {kind}", *v) for kind, v in z.items()]
            shares = [f"{100 * np.mean(np.abs(np.concatenate(v)) < 1.96):.1f} %" for v in z.values()]
            chosen = max(models, key=lambda k: models[k])
            targets.line(name, *shares, f"{chosen} {models[chosen]} of {draws}", refused)
    return lines


def mounting(draws: int) -> list[targets.Measured]:
    """Compute coverage of the three mounting angles of a magnetometer, with tilts and a correct heading logged."""
    rng, z = np.random.default_rng(8), []
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(draws):
            true, motion = iron.some(rng), iron.tumble(rng, 1500)
            askew = iron.turned(3.0 * rng.normal(size=(1, 3)))[0]
            turned = iron.Iron(true.soft @ askew, true.hard, true.dip_deg)
            x, y, sensor_z = iron.readings(rng, turned, motion, noise=0.005, memory=0.8).T
            heading, pitch, roll = (motion + 0.2 * rng.normal(size=motion.shape)).T
            columns = {"x": x, "y": y, "z": sensor_z, "pitch_deg": pitch, "roll_deg": roll}
            path = iron.write(Path(folder) / "log.csv", **columns, heading_deg=heading % 360.0)
            found = magnetometer.calibrate([path], {}).details["misalignment_deg"]
            back = np.rad2deg([askew[1, 2] - askew[2, 1], askew[2, 0] - askew[0, 2], askew[0, 1] - askew[1, 0]]) / 2.0
            z.append([(angle["value"] - b) / angle["sigma"] for angle, b in zip(found.values(), back, strict=True)])
    names = ("forward", "starboard", "vertical")
    return [within(f"mounting of 3° rms about {name}", col) for name, col in zip(names, np.array(z).T, strict=True)]


def bias(draws: int) -> None:
    """Print the mean error over its standard error, with and without adjustment for the noise."""
    print(
        "\nMean error over its standard error, 9 parameters of the ellipsoid: rms and largest; 1 and about 2.5 expected"
    )
    targets.head("noise", "plain algebraic fit", "adjusted")
    for noise in (0.01, 0.03, 0.1):
        rng, plain, adjusted = np.random.default_rng(7), [], []
        true = iron.some(rng)
        root = np.linalg.inv(true.soft)
        polar = _symmetric(root)
        truth = np.concatenate([true.hard / iron.FIELD, [polar[p] for p in ellipsoid.PLACES.values()]])
        for _ in range(draws):
            field = iron.readings(rng, true, iron.tumble(rng, 1000), noise=noise) / iron.FIELD
            data = ellipsoid.ScaledReadings(field, np.zeros_like(field))
            for kept, how in ((plain, False), (adjusted, True)):
                kept.append(ellipsoid.solve(ellipsoid.ELLIPSOID, data, truth[:3], adjusted=how)[0] - truth)
        cells = []
        for kept in (plain, adjusted):
            off = np.array(kept)
            z = np.abs(off.mean(axis=0)) / (off.std(axis=0) / np.sqrt(draws))
            share = np.max(np.abs(off.mean(axis=0)) / off.std(axis=0))
            cells.append(f"{np.sqrt(np.mean(z**2)):.1f}, {z.max():.1f} (bias at most {share:.2f} σ of one fit)")
        targets.line(f"{100 * noise:.0f} %", *cells)


def _symmetric(root: np.ndarray) -> np.ndarray:
    """Compute the symmetric root of G^T G, which is all that an ellipsoid determines."""
    values, vectors = np.linalg.eigh(root.T @ root)
    return (vectors * np.sqrt(values)) @ vectors.T


def real() -> None:
    path = REAL / "signature500.csv"
    if not path.exists():
        print("no ../shared/data/magnetometer")
        return
    found = magnetometer.calibrate([path], {})
    before = found.details["harmonics_percent"]["before"]
    print("Signature500:", found.details["axes"], "| model", found.model)
    deviation = np.rad2deg(before["first"] / 100.0)
    print(f"  horizontal modulus, one cycle {before['first']:.2f} % ({deviation:.2f}°; published 22.6 %, 12.9°)")
    print(f"  two cycles {before['second']:.2f} % (published 1.1 %, under 1.3 %)")
    print("  modulus residual, %:", found.details["modulus_residual_percent"])
    print("  harmonics after, %:", found.details["harmonics_percent"]["after"])
    print(f"  A..E {np.round(found.coefficients, 2)}°, undetermined: {', '.join(found.details['undetermined'])}")
    print(f"  z offset: {found.details['undetermined_why']['z offset']}")
    found = magnetometer.calibrate([REAL / "hmc5883l_sphere.csv"], {})
    print(
        "HMC5883L: model",
        found.model,
        "| held-out rms, %:",
        {k: round(v, 3) for k, v in found.details["scores"].items()},
    )
    print(f"  modulus residual {found.details['modulus_residual_percent']['after']:.4f} % (published 0.46 %)")
    print(f"  undetermined: {', '.join(found.details['undetermined'])}; why: {found.why}")
    only = magnetometer.calibrate([REAL / "signature500.csv"], {"columns": {"x": "ax", "y": "ay", "z": "az"}})
    print("Accelerometer's columns:", only.why)


if __name__ == "__main__":
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 400
    real()
    bias(count)
    sys.exit(targets.report([*mounting(count), *coverage(count)]))
