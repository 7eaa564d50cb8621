"""Coverage of the stated uncertainties of bench calibrations, over many simulated benches.

    python benchmarks/calibrations.py             1000 benches of each design
    python benchmarks/calibrations.py 200 7       200 of each by seed 7

For each design: the share of coefficients and of the table's deviations whose true value lies within 1.96 stated
standard uncertainties. The target is 93 to 97 %; the exit status is 1 if it is missed.
"""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import dataclass

import numpy as np
import targets
from targets import Measured

from compasslib import angles, compass
from compasslib.calibrations import platform, tilt
from compasslib.calibrations.platform import BenchReadings
from compasslib.calibrations.result import Calibration
from compasslib.calibrations.tilt import AxisReadings
from compasslib.deviation.series import series_deviation

GRADUATION_DEG, READING_DEG = 0.26, 0.4  # standard errors of each setting of the bench, and of each reading
TILT_DEG = 0.15  # standard error of a tilt and its reading
ALLOWED = {"least": 0.93, "most": 0.97}


@dataclass(frozen=True)
class Design:
    """Settings of the bench, and type and size of the deviation."""

    name: str
    settings_deg: np.ndarray
    truth: str  # smith | exact
    strength: float  # of the semicircular part: degrees, or relative to the horizontal field
    repeats: int = 1
    quadrantal: float = 0.15  # relative to the strength


def ring(n: int) -> np.ndarray:
    """Compute n equidistant settings over the full circle, degrees."""
    return 360.0 / n * np.arange(n)


DESIGNS = (
    Design("36, series", ring(36), "smith", 5.0),
    Design("36, series, 15 degrees", ring(36), "smith", 15.0),
    Design("36, iron of 0.1 H", ring(36), "exact", 0.1),
    Design("36, iron of 0.3 H", ring(36), "exact", 0.3),
    Design("36, iron of 0.6 H", ring(36), "exact", 0.6),
    Design("24, iron of 0.2 H", ring(24), "exact", 0.2),
    Design("24, iron of 1.4 H, two-valued", ring(24), "exact", 1.4, quadrantal=0.05),
    Design("16, series", ring(16), "smith", 8.0),
    Design("16, iron of 0.3 H", ring(16), "exact", 0.3),
    Design("12 read 5 times, series", ring(12), "smith", 8.0, repeats=5),
    Design("8, series", ring(8), "smith", 5.0),
    Design("8, iron of 0.15 H", ring(8), "exact", 0.15),
    Design("6, series", ring(6), "smith", 5.0),
    Design("24 over 240 degrees, series", 10.0 * np.arange(24), "smith", 5.0),
    Design("4, one cycle", ring(4), "smith", 5.0, quadrantal=0.0),
    Design("5, one cycle", ring(5), "smith", 5.0, quadrantal=0.0),
)


def bench(design: Design, rng: np.random.Generator) -> tuple[np.ndarray, BenchReadings]:
    """Simulate a bench; return true coefficients and readings."""
    direction = rng.uniform(0.0, 360.0)
    semicircular = design.strength * np.array(angles.sin_cos(direction))
    rest = design.strength * design.quadrantal * rng.normal(size=3)
    true = np.array([rest[0], *semicircular, *rest[1:]])
    intended = np.repeat(design.settings_deg + rng.uniform(0.0, 10.0), design.repeats)
    off = np.repeat(rng.normal(0.0, GRADUATION_DEG, len(design.settings_deg)), design.repeats)
    recorded = _recorded(design.truth, true, intended + off) + rng.normal(0.0, READING_DEG, len(intended))
    return true, BenchReadings(intended, angles.wrap360(recorded))


def _recorded(truth: str, true: np.ndarray, correct_deg: np.ndarray) -> np.ndarray:
    if truth == "exact":
        return compass.recorded_heading(true, correct_deg)
    recorded = correct_deg
    for _ in range(200):  # the series has the recorded heading as its argument
        recorded = correct_deg - series_deviation(true, recorded)
    return recorded


def deviation(truth: str, true: np.ndarray, recorded_deg: np.ndarray) -> np.ndarray:
    """Compute the true deviation at recorded headings, degrees, NaN where it is not unique."""
    if truth == "smith":
        return series_deviation(true, recorded_deg)
    roots = compass.inverse(true, recorded_deg)
    return np.where(np.isfinite(roots[:, 1]), np.nan, angles.difference(roots[:, 0], recorded_deg))


def misses(design: Design, true: np.ndarray, made: Calibration) -> tuple[np.ndarray, np.ndarray]:
    """Compute errors of coefficients and of the table over their stated standard uncertainties."""
    found = (made.coefficients, made.covariance) if design.truth == "smith" else (made.exact, made.exact_covariance)
    coefficients = (found[0] - true) / np.sqrt(np.diag(found[1])) if found[0].size else np.full(5, np.nan)
    if made.table is None:
        return coefficients, np.full(36, np.nan)
    off = angles.wrap180(made.table.deviation_deg - deviation(design.truth, true, made.table.heading_deg))
    return coefficients, off / made.table.sigma_deg


def run(design: Design, benches: int, seed: int) -> list[Measured]:
    """Simulate one design and print the models that were used; return coverage with its target."""
    rng = np.random.default_rng([seed, DESIGNS.index(design)])
    found: dict[str, list[float]] = {"coefficients": [], "table": []}
    models = Counter[str]()
    for _ in range(benches):
        true, readings = bench(design, rng)
        made = platform.calibrate_readings("platform", readings)
        for shares, z in zip(found.values(), misses(design, true, made), strict=True):
            known = np.abs(z[np.isfinite(z)])
            shares += [float(np.mean(known <= 1.96))] if known.size else []  # values of one bench are dependent
        models[made.model] += 1
    targets.line(design.name, ", ".join(f"{name} {n / benches:.0%}" for name, n in sorted(models.items())))
    return [
        targets.mean(f"{design.name}: {what} within 95 %", shares, **ALLOWED, unit=" %", times=100.0)
        for what, shares in found.items()
        if shares
    ]


def run_tilts(steps: int, platforms: int, seed: int) -> Measured:
    """Simulate a tilt sensor with random offset, gain and curvature at a number of tilts of each axis."""
    rng, reference, shares = np.random.default_rng([seed, steps]), np.linspace(-20.0, 20.0, steps), []
    for _ in range(platforms):
        true = rng.normal(size=(2, 3)) * [0.5, 0.02, rng.choice([0.0, 0.001])]
        recorded = reference - np.array([np.polynomial.Polynomial(each)(reference) for each in true])
        recorded += rng.normal(0.0, TILT_DEG, recorded.shape)
        reads = {axis: AxisReadings(reference, each, 0.0) for axis, each in zip(tilt.AXES, recorded, strict=True)}
        axes, inside = tilt.calibrate_axes(reads, ()).details["axes"], []
        for axis, each in zip(tilt.AXES, true, strict=True):
            at = axes[axis]["table"]
            fitted = reference - np.polynomial.Polynomial(each)(reference)
            off = at["correction_deg"] - np.interp(at["recorded_deg"], fitted, reference - fitted)
            inside.append(np.abs(off) <= 1.96 * at["sigma_deg"])
        shares.append(float(np.mean(np.concatenate(inside))))
    return targets.mean(f"tilts, {steps} of each axis: within 95 %", shares, **ALLOWED, unit=" %", times=100.0)


def main(benches: int = 1000, seed: int = 2007) -> int:
    """Print the tables of all designs; return 1 if any target is missed."""
    targets.head("headings", "model used")
    lines = [one for design in DESIGNS for one in run(design, benches, seed)]
    return targets.report([*lines, *(run_tilts(steps, benches, seed) for steps in (9, 17))])


if __name__ == "__main__":
    sys.exit(main(*(int(argument) for argument in sys.argv[1:3])))
