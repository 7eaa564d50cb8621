"""A simulated bench for tests: headings set by the bench, recorded by a known compass, written as a calibration."""

from pathlib import Path

import numpy as np
import yaml

from compasslib import angles, compass
from compasslib.calibrations.platform import BenchReadings

MILD = (0.02, 0.15, 0.1, 0.03, -0.02)
FOLDED = (0.0, -1.1, 0.7, 0.02, -0.01)
BREST = {"latitude": 48.4, "longitude": -4.5, "date": "2022-09-29"}


def ring(n: int = 36) -> np.ndarray:
    """Get n settings evenly spaced over the circle, degrees."""
    return 360.0 / n * np.arange(n)


def readings(settings_deg=None, coefficients=MILD, *, noise_deg: float = 0.3, seed: int = 1) -> BenchReadings:
    """Simulate the noisy readings of an exact compass on a bench."""
    settings = ring() if settings_deg is None else np.asarray(settings_deg, dtype=float)
    noise = np.random.default_rng(seed).normal(0.0, noise_deg, len(settings))
    return BenchReadings(settings, angles.wrap360(compass.recorded_heading(coefficients, settings) + noise))


def write_table(path: Path, read: BenchReadings, names=("reference_deg", "recorded_deg")) -> Path:
    """Write readings as a CSV file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = [f"{a:.3f},{b:.3f}" for a, b in zip(read.reference_deg, read.recorded_deg, strict=True)]
    path.write_text("\n".join([",".join(names), *rows]) + "\n")
    return path


def write_calibration(folder: Path, name: str, read: BenchReadings, **keys: object) -> None:
    """Write a platform's table and its YAML file into a cruise folder."""
    write_table(folder / f"raw/cal/{name}.csv", read)
    file = folder / f"config/calibrations/{name}.yaml"
    file.parent.mkdir(parents=True, exist_ok=True)
    said = {"kind": "platform", "file": f"raw/cal/{name}.csv"} | BREST | keys
    file.write_text(yaml.safe_dump({key: value for key, value in said.items() if value is not None}))
