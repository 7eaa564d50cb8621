"""Coverage of the stated uncertainties of a swing: simulated swings with known truth, and one real log.

Headings: one reading each on 8, 16 or 36 headings, or on five and towards a mark, with set and drift. Logs: 14 to 40
minutes at one sample per second, on legs or in slow circles, with wander of the helm, a receiver that smooths and lags,
varying speed, outliers, and changing drift; with and without the ship's speed log. The declination is given with an
error. The same seed draws the same swings.
"""

from __future__ import annotations

import argparse
import csv
import sys
import tempfile
from pathlib import Path

import numpy as np
import targets
from runs import DATA

from compasslib import angles
from compasslib.calibrations import swing
from compasslib.deviation.series import series_deviation

KINDS = ("5 headings and a mark", "8 headings", "16 headings", "36 headings", "log", "log and ship's log")
ALLOWED = {"least": 0.93, "most": 0.97}
TRUTH_SIGMA = np.array([1.0, 5.0, 5.0, 2.0, 1.0])
DECLINATION_DEG, DECLINATION_SIGMA_DEG = 3.0, 0.4
WIDEST_DRIFT_KN, OUTLIERS = 1.0, 0.004
TABLE_DEG = np.arange(0.0, 360.0, 10.0)
REAL = DATA / "swing/2010-11-03.Taiohae.nmea"
Row = dict[str, np.ndarray]


def disc(rng: np.random.Generator, radius: float) -> complex:
    """Draw a vector, east + i north, uniform over a disc."""
    return radius * np.sqrt(rng.uniform()) * np.exp(2j * np.pi * rng.uniform())


def alike(rng: np.random.Generator, n: int, memory_s: float) -> np.ndarray:
    """Draw first-order autoregressive noise of unit variance and given memory, one value per second."""
    keep, out = np.exp(-1.0 / memory_s), rng.normal(size=n)
    for k in range(1, n):
        out[k] = keep * out[k - 1] + np.sqrt(1.0 - keep**2) * out[k]
    return out


def swell(rng: np.random.Generator, n: int, period_s: float) -> np.ndarray:
    """Draw noise of unit variance that oscillates with a period, as the wander of a helmsman."""
    turn = np.exp(-1.0 / (2.0 * period_s) + 2j * np.pi / period_s)
    state, out = complex(*rng.normal(size=2)), np.empty(n)
    for k in range(n):
        state = turn * state + np.sqrt(1.0 - abs(turn) ** 2) * complex(*rng.normal(size=2))
        out[k] = state.real
    return out


def smoothed(x: np.ndarray, memory_s: float) -> np.ndarray:
    """Smooth a series as a receiver does, by an exponential filter."""
    out, keep = x.copy(), np.exp(-1.0 / memory_s)
    for k in range(1, len(x)):
        out[k] = keep * out[k - 1] + (1.0 - keep) * x[k]
    return out


def recorded(truth: np.ndarray, heading: np.ndarray) -> np.ndarray:
    """Compute the recorded heading of a compass whose deviation is a series in the recorded heading."""
    gamma = heading.copy()
    for _ in range(60):
        gamma = heading - series_deviation(truth, gamma)
    return gamma


def headings(rng: np.random.Generator, n: int, truth: np.ndarray) -> Row:
    """Draw readings on n headings at nearly constant or varying speed."""
    beta = angles.wrap360(np.append(90.0 * np.arange(4), 45.0) if n == 5 else 360.0 * np.arange(n) / n)
    beta = angles.wrap360(beta + rng.normal(0.0, 2.0, n))
    speed = rng.uniform(6.0, 9.0) + rng.choice([0.1, 1.0]) * rng.normal(size=n)
    ground = speed * np.exp(1j * np.deg2rad(90.0 - beta - DECLINATION_DEG)) + disc(rng, WIDEST_DRIFT_KN)
    course = angles.direction(ground.real, ground.imag) + rng.normal(0.0, 0.7, n)
    gamma = recorded(truth, beta) + rng.normal(0.0, 0.7, n)
    return {"compass_deg": angles.wrap360(gamma), "cog_deg": angles.wrap360(course), "speed_kn": np.abs(ground)}


def plan(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Draw heading (unwrapped) and speed along a swing, one value per second."""
    if rng.uniform() < 0.5:
        rate = rng.uniform(0.4, 0.9)
        once = int(360.0 / rate * rng.uniform(1.0, 1.5))
        turn = np.concatenate([np.full(once, rate), np.full(once, -rate)])
        speed = rng.uniform(3.5, 5.0) + rng.uniform(1.0, 2.0) * np.sin(np.arange(2 * once) / rng.uniform(60, 200))
        return rng.uniform(0, 360) + np.cumsum(turn), speed
    legs = rng.permutation(int(rng.integers(8, 13)))
    beta, speed, at = [], [], 0.0
    for leg in legs * (360.0 / len(legs)):
        off = float(angles.difference(leg, at))
        seconds = max(int(abs(off) / rng.uniform(2.0, 4.0)), 1)
        stay = int(rng.integers(80, 150))
        beta.append(np.append(np.linspace(at, at + off, seconds), np.full(stay, at + off)))
        speed.append(np.full(len(beta[-1]), rng.uniform(3.0, 7.0)))
        at += off
    return np.concatenate(beta), smoothed(np.concatenate(speed), 20.0)


def log(rng: np.random.Generator, truth: np.ndarray, with_log: bool) -> Row:
    """Draw a log with one sample per second."""
    beta, speed = plan(rng)
    n = len(beta)
    beta = beta + rng.uniform(1.5, 3.0) * swell(rng, n, rng.uniform(15.0, 40.0))
    lasted = np.linspace(-0.5, 0.5, n)
    change = rng.normal(size=2) @ [1.0, 1j] * WIDEST_DRIFT_KN / 2.0 * n / 10800.0
    water = disc(rng, WIDEST_DRIFT_KN) + change * lasted
    leeway = rng.uniform(1.0, 2.0) * alike(rng, n, rng.uniform(15.0, 60.0))
    through = speed * np.exp(1j * np.deg2rad(90.0 - beta - leeway - DECLINATION_DEG))
    noise = 0.1 * (alike(rng, n, 10.0) + 1j * alike(rng, n, 10.0))
    ground = smoothed(through + water + noise, rng.uniform(2.0, 5.0))
    course = np.rint(angles.direction(ground.real, ground.imag))
    course = np.where(rng.uniform(size=n) < OUTLIERS, course + rng.uniform(-90.0, 90.0, n), course)
    gamma = np.rint(recorded(truth, beta) + rng.normal(0.0, 0.5, n))
    times = np.datetime64("2021-05-24T11:00:00") + np.arange(n).astype("timedelta64[s]")
    columns = {"compass_deg": angles.wrap360(gamma), "cog_deg": angles.wrap360(course)}
    columns |= {"speed_kn": np.round(np.abs(ground), 1), "time_utc": times}
    if with_log:
        columns["water_speed_kn"] = np.round(speed * rng.normal(1.0, 0.05) + 0.1 * alike(rng, n, 5.0), 1)
    return columns


def measured(index: int, seed: int, folder: Path) -> dict[str, object]:
    """Draw one swing, calibrate it, and compute its errors in stated standard deviations."""
    kind = KINDS[index % len(KINDS)]
    rng = np.random.default_rng((seed, index))
    truth = rng.normal(0.0, TRUTH_SIGMA)
    rows = headings(rng, int(kind.split()[0]), truth) if "headings" in kind else log(rng, truth, "ship" in kind)
    path = folder / "swing.csv"
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(rows)
        writer.writerows(zip(*([str(x) for x in column] for column in rows.values()), strict=True))
    marks = {}
    if "mark" in kind:
        towards = rng.uniform(0.0, 90.0)  # in the quadrant of the fifth course
        shown = float(angles.wrap360(recorded(truth, np.array([towards]))[0] + rng.normal()))
        marks = {"visual": [{"compass_deg": shown, "true_deg": towards + DECLINATION_DEG}]}
    given = marks | {"declination_deg": DECLINATION_DEG + rng.normal(0.0, DECLINATION_SIGMA_DEG)}
    found = swing.calibrate([path], {**given, "declination_sigma_deg": DECLINATION_SIGMA_DEG})
    if found.why:
        return {"kind": kind, "why": found.why}
    off = (found.coefficients - truth) / np.sqrt(np.diag(found.covariance))
    table = (found.table.deviation_deg - series_deviation(truth, TABLE_DEG)) / found.table.sigma_deg
    return {
        "kind": kind,
        "off": off,
        "table": table,
        "error": found.coefficients - truth,
        "sigma": np.sqrt(np.diag(found.covariance)),
        "separable": bool(found.details["drift"]["separable"]),
        "n": found.n,
        "effective": found.details["n_effective"],
    }


def report(results: list[dict[str, object]]) -> list[targets.Measured]:
    """Print coverage by kind, and return it with intervals over swings."""
    lines = []
    targets.head(
        "kind", "told", "% of A, B, C, D, E within 95 %", "rms error A..E (°)", "stated (°)", "water told", "n_eff"
    )
    for kind in (*KINDS, "all"):
        mine = [r for r in results if kind in ("all", r["kind"])]
        told = [r for r in mine if "off" in r]
        if not told:
            continue
        off, error, sigma, table = (np.stack([r[key] for r in told]) for key in ("off", "error", "sigma", "table"))
        size, stated = (" ".join(f"{x:.2f}" for x in np.sqrt(np.mean(y**2, axis=0))) for y in (error, sigma))
        letters = " ".join(f"{100 * x:.1f}" for x in np.mean(np.abs(off) <= 1.96, axis=0))
        water = targets.share_of(r["separable"] for r in told)
        effective = f"{np.median([r['effective'] for r in told]):.0f} of {np.median([r['n'] for r in told]):.0f}"
        targets.line(kind, f"{len(told)} of {len(mine)}", letters, size, stated, water, effective)
        for what, z in (("coefficients", off), ("table", table)):
            inside = np.mean(np.abs(z) <= 1.96, axis=1)
            wanted = ALLOWED if kind == "all" else {}
            lines.append(targets.mean(f"{kind}: {what} within 95 %", inside, **wanted, unit=" %", times=100.0))
    return lines


def real() -> str:
    """Describe the result of the real log with and without the ship's speed log."""
    if not REAL.exists():
        return f"no {REAL.name}: the real log is left out"
    lines = []
    for name, withhold in (("Taiohae", []), ("Taiohae without the ship's log", ["water_speed_kn"])):
        found = swing.calibrate([REAL], {"format": "nmea0183", "withhold": withhold})
        letters = " ".join(f"{k} {x:+.2f}" for k, x in zip("ABCDE", found.coefficients, strict=True))
        lines += [
            f"{name}: {letters}; residual {found.residual_rms_deg:.2f}°",
            f"{name}: {found.details['drift']['text']}",
        ]
        lines += [f"{name}: budget: {s.name} {s.standard_deg:.2f}" for s in found.sources]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--swings", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=2024)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        results = [measured(k, given.seed, Path(folder)) for k in range(given.swings)]
    status = targets.report(report(results))
    print(real())
    sys.exit(status)


if __name__ == "__main__":
    main()
