"""Coverage of the stated uncertainties of bench calibrations, over many simulated benches.

    python benchmarks/calibrations.py                     1000 benches of each design
    python benchmarks/calibrations.py 200 7               200 of each by seed 7
    python benchmarks/calibrations.py --kind transfer     compasses calibrated at Brest and moored at 65 N
    python benchmarks/calibrations.py --kind object       safe distances of an object near the compass

For each design: the share of coefficients and of the table's deviations whose true value lies within 1.96 stated
standard uncertainties. The target is 93 to 97 %; the exit status is 1 if it is missed.

For moorings: the share of B and C at 65 N within 95 %, where hard and induced iron are drawn from the prior of the
transfer, and from that prior at fixed ratios.
"""

import sys
from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np
import targets
from targets import Measured

from compasslib import angles, compass
from compasslib.calibrations import platform
from compasslib.calibrations.platform import BenchReadings
from compasslib.calibrations.result import DIPOLE, SAFE_DEG, Calibration, changes_by_object, describe_object
from compasslib.deviation import model
from compasslib.deviation.model import FieldAtPlace
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
    return true, read(design, true, rng)


def read(design: Design, true: np.ndarray, rng: np.random.Generator) -> BenchReadings:
    """Simulate the readings of a compass of known coefficients."""
    intended = np.repeat(design.settings_deg + rng.uniform(0.0, 10.0), design.repeats)
    off = np.repeat(rng.normal(0.0, GRADUATION_DEG, len(design.settings_deg)), design.repeats)
    recorded = _recorded(design.truth, true, intended + off) + rng.normal(0.0, READING_DEG, len(intended))
    return BenchReadings(intended, angles.wrap360(recorded))


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
        made = platform.calibrate_readings(readings)
        for shares, z in zip(found.values(), misses(design, true, made), strict=True):
            known = np.abs(z[np.isfinite(z)])
            shares += [float(np.mean(known <= 1.96))] if known.size else []  # values of one bench are dependent
        models[made.model] += 1
    targets.line(design.name, ", ".join(f"{name} {n / benches:.0%}" for name, n in sorted(models.items())))
    return [
        targets.mean(f"{design.name}: {what} within 95 %", shares, **ALLOWED, percent=True)
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
        reads = {axis: BenchReadings(reference, each) for axis, each in zip(platform.AXES, recorded, strict=True)}
        axes, inside = platform.calibrate_axes(reads, ()).details["axes"], []
        for axis, each in zip(platform.AXES, true, strict=True):
            at = axes[axis]["table"]
            fitted = reference - np.polynomial.Polynomial(each)(reference)
            off = at["correction_deg"] - np.interp(at["recorded_deg"], fitted, reference - fitted)
            inside.append(np.abs(off) <= 1.96 * at["sigma_deg"])
        shares.append(float(np.mean(np.concatenate(inside))))
    return targets.mean(f"tilts, {steps} of each axis: within 95 %", shares, **ALLOWED, percent=True)


PLATFORM = Design("36, before a mooring", ring(36), "exact", 0.1)
BREST, ICELAND, MOORED = FieldAtPlace(21000.0, 43000.0), FieldAtPlace(13300.0, 50200.0), FieldAtPlace(11980.0, 52078.0)
RATIOS = (1 / 3, -1 / 3, 1.0, -1.0, -1.29, 3.0, -3.0)


IRON: dict[str, dict[str, Any]] = {
    "prior": {},
    "prior with a sphere": {"prior_nT": model.SPHERE_NT},
    **{f"induced over hard iron {ratio:+.2f}": {"ratio": ratio} for ratio in RATIOS},
    "calibrated at two dips": {"places": (BREST, ICELAND)},
}


def run_transfer(
    name: str,
    compasses: int,
    seed: int,
    *,
    prior_nT: float = model.IRON_NT,
    ratio: float | None = None,
    places: tuple[FieldAtPlace, ...] = (BREST,),
) -> Measured:
    """Calibrate compasses elsewhere and print the median width at the mooring; return the coverage of B and C there.

    Their iron is that of the prior; ``ratio`` is cZ/P at Brest, free if None.
    """
    rng, shares, widths = np.random.default_rng([seed, list(IRON).index(name)]), [], []
    for _ in range(compasses):
        hard, induced = prior_nT * rng.normal(size=(2, 2))
        if ratio is not None:  # the prior where induced iron is this multiple of hard iron
            hard = hard / np.hypot(1.0, ratio)
            induced = ratio * hard
        parts = np.array([0.01, *hard, *induced / BREST.vertical_nT, *rng.normal(0.0, 0.02, 2)])
        made = [platform.calibrate_readings(read(PLATFORM, model.iron_design(place) @ parts, rng)) for place in places]
        if not all(each.exact.size for each in made):
            continue  # such a calibration corrects no mooring
        known = [
            model.PlacedCoefficients(each.exact, each.exact_covariance, place)
            for each, place in zip(made, places, strict=True)
        ]
        moored = model.transfer_coefficients(known, MOORED, prior_nT)
        half = 1.96 * np.sqrt(np.diag(moored.covariance))
        shares.append(float(np.mean((np.abs(moored.coefficients - model.iron_design(MOORED) @ parts) <= half)[1:3])))
        widths.append(2.0 * half[1])
    targets.line(name, targets.middle(np.array(widths)))
    return targets.mean(f"{name}: within 95 %", shares, least=0.93, most=0.97 if ratio is None else 1.0, percent=True)


DISTANCES_M, MOMENT_DEG_M3, SIZE_M = (0.3, 0.4, 0.6, 0.9), 0.2, 0.1


def run_object(objects: int, seed: int) -> list[Measured]:
    """Calibrate a compass without and with a dipole at four distances; return the coverage of what is derived."""
    rng, inside = np.random.default_rng(seed), list[bool]()
    truth = (MOMENT_DEG_M3 / SAFE_DEG) ** (1.0 / DIPOLE)
    for _ in range(objects):
        own = np.array([0.0, *rng.normal(0.0, 0.05, 2), 0.0, 0.0])
        moment = MOMENT_DEG_M3 * angles.DEGREE * np.array(angles.sin_cos(rng.uniform(0.0, 360.0)))
        pages = []
        for distance in (np.inf, *DISTANCES_M):
            true = own + np.array([0.0, *moment / distance**DIPOLE, 0.0, 0.0])
            made = platform.calibrate_readings(read(PLATFORM, true, rng))
            letters = dict(zip("ABCDE", made.coefficients, strict=True))
            page = {"name": "", "coefficients": letters, "covariance": made.covariance}
            pages.append(page | {"object": {"distance_m": distance}})
        said = describe_object(changes_by_object(pages[0], pages[1:]), SIZE_M)
        if (safe := said["safe_distance_m"]) is not None:
            inside.append(safe["low"] <= truth <= safe["high"])
    return [
        targets.share("objects with a safe distance", np.arange(objects) < len(inside)),
        targets.share("safe distance within 95 %", np.array(inside), **ALLOWED),
    ]


def run_kind(kind: str, count: int, seed: int) -> list[Measured]:
    """Simulate all designs of one kind."""
    if kind == "object":
        return run_object(count, seed)
    if kind == "tilt":
        return [run_tilts(steps, count, seed) for steps in (9, 17)]
    if kind == "transfer":
        targets.head("iron", "width of the interval of B, median")
        return [run_transfer(name, count, seed, **iron) for name, iron in IRON.items()]
    targets.head("headings", "model used")
    return [one for design in DESIGNS for one in run(design, count, seed)]


if __name__ == "__main__":
    kinds = ("platform", "tilt", "transfer", "object")
    asked = targets.parser(__doc__, 1000, kinds).parse_args()
    chosen = kinds if asked.kind is None else (asked.kind,)
    sys.exit(targets.report([one for kind in chosen for one in run_kind(kind, asked.count, asked.seed)]))
