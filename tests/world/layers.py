"""Layered currents, recorded by a profile whose compass stands near iron and by a reference cell below it."""

import numpy as np

from compasslib import angles, compass
from compasslib.deviation import fit_deviation
from compasslib.deviation.likelihood import CELLS
from compasslib.deviation.model import DeviationFit, nearest_root
from compasslib.preparation.pairs import PairRules
from compasslib.records import EarthField, Pairs, Record
from tests.world.pairs import red_from_rest
from tests.world.sea import MILD, plain_record

HOURS, CELL_M, BINS = 3000, 4.0, 12
FIELD = EarthField(np.array([0.0, 2e9]), np.zeros(2), *(np.ones((3, 2)) * 12000.0))
ALL_NEAR = PairRules(max_metres=1000.0)


def layers(seed: int, *, noise_m_s: float = 0.01, bins: int = BINS + 2) -> np.ndarray:
    """Simulate layered currents, (hours, bins), starting at the reference: a common flow and smooth shears."""
    rng = np.random.default_rng(seed)
    common = 0.1 + 0.15 * (red_from_rest(rng, HOURS, 30, 1.0) + 1j * red_from_rest(rng, HOURS, 30, 1.0))
    z = np.arange(bins)
    waves = [(red_from_rest(rng, HOURS, 6, 0.03) + 1j * red_from_rest(rng, HOURS, 6, 0.03)) for _ in range(8)]
    shapes = [np.cos(2 * np.pi * z / length + phase) for length, phase in rng.uniform((12, 0), (40, 6.28), (8, 2))]
    noise = noise_m_s * (rng.normal(size=(HOURS, bins)) + 1j * rng.normal(size=(HOURS, bins)))
    return common[:, None] + np.sum([w[:, None] * s for w, s in zip(waves, shapes, strict=True)], axis=0) + noise


def instrument(flow: np.ndarray, first_m: float, *, heading_deg: np.ndarray, depth: float = 100.0) -> Record:
    level = {"pitch_deg": 0.0 * heading_deg, "roll_deg": 0.0 * heading_deg, "looks_up": True}
    time_s, ranges_m = 1.19e9 + 3600.0 * np.arange(len(flow)), first_m + CELL_M * np.arange(flow.shape[1])
    return plain_record(time_s, flow, ranges_m, heading_deg=heading_deg, depth_m=np.full(len(flow), depth), **level)


def seen(coefficients, flow: np.ndarray, seed: int = 1) -> tuple[Record, Record, np.ndarray]:
    """Simulate the affected profile of a compass near iron, the reference cell below, and the correct headings."""
    heading = angles.wrap360(np.cumsum(np.random.default_rng(seed).normal(0.0, 25.0, len(flow))))
    recorded = compass.recorded_heading(coefficients, heading)
    turned = flow[:, 2:] * np.exp(-1j * np.deg2rad(angles.difference(recorded, heading)))[:, None]
    top = instrument(turned, CELL_M, heading_deg=recorded)
    return top, instrument(flow[:, :1], -CELL_M, heading_deg=heading), heading


def error_deg(pairs: Pairs, top: Record, heading: np.ndarray, coefficients=MILD) -> float:
    """Compute the rms heading error of a fit started at the true coefficients, to test the water and not the search."""
    near = DeviationFit("exact", 0, np.array(coefficients), heading_density=np.full(CELLS, 1.0 / CELLS))
    fit = fit_deviation("exact", pairs, near)
    found = nearest_root(compass.inverse(fit.coefficients, top.heading_deg), heading)
    return angles.rms(angles.difference(found, heading)[np.isfinite(found)])
