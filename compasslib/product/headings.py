"""The heading error of a mooring's instruments along the times of the grid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from compasslib import angles
from compasslib.deviation.correction import MIN_PROBABILITY
from compasslib.product.cells import Axes
from compasslib.product.errors import MAX_MODES, MAX_REFERENCES, HeadingErrors, compress, memory_of
from compasslib.product.grid import average_slots
from compasslib.types import Bools, Floats

HOPELESS = 1e8  # variance in square degrees, marks a heading whose error has none


@dataclass(frozen=True)
class ReferenceCompass:
    """What a reference's directions rest on."""

    name: str
    sigma_deg: float  # of a constant error
    magnetic: bool  # whether its directions were turned by the declination of the mooring
    weight: float  # share of the pairs


@dataclass(frozen=True)
class AffectedHeadings:
    """Corrected headings of the affected instrument at n samples, and the parts of their error."""

    time_s: Floats
    used: Bools  # (n,) whether velocities of the sample go into the grid
    heading_deg: Floats
    sigma_deg: Floats  # all but declination and the reference's compass
    probability: Floats  # of the branch
    columns_deg: Floats  # (n, p) by the coefficients of the compass, per unit normal
    doubted_deg: Floats  # (n,) standard deviation of what is suspected, within sigma_deg
    unexplained_deg: float  # standard deviation of what was seen and not corrected, within sigma_deg
    veer_deg: float  # of the mean current between the depths, where the coefficients' covariance does not hold it
    of_pairs: bool  # whether the coefficients come from pairs with the references


def heading_errors(
    affected: AffectedHeadings,
    references: Sequence[ReferenceCompass],
    axes: Axes,
    max_gap_s: float,
    declination_deg: float,
) -> HeadingErrors:
    """Decompose the heading errors of a mooring into modes along time and a random part.

    The covariance of a fit holds the mean veer between the depths and the water's scatter. It does not hold a constant
    error of the reference's compass, which passes into the coefficient A, nor that of the declination, by which
    affected and reference velocities are turned alike.

    Args:
        declination_deg: standard deviation of the declination.
    """
    samples = len(affected.time_s)
    constants = {"declination": declination_deg}
    constants |= {f"compass of {r.name}": r.sigma_deg for r in references[: MAX_REFERENCES - 1]}
    if others := references[MAX_REFERENCES - 1 :]:
        name = "compass of " + " and ".join(r.name for r in others)
        constants[name] = max(r.sigma_deg for r in others)
    by_time = {"veer": np.full(samples, affected.veer_deg), "unexplained": np.full(samples, affected.unexplained_deg)}
    by_time |= {"doubts": affected.doubted_deg}
    by_time = {name: series for name, series in by_time.items() if np.any(series > 0.0)}
    leading, left = compress(affected.columns_deg, MAX_MODES - len(constants) - len(by_time))
    within = np.sum(affected.columns_deg**2, axis=1)
    within += sum((series**2 for name, series in by_time.items() if name != "veer"), np.zeros(samples))
    random = np.maximum(affected.sigma_deg**2 - within, 0.0) + left
    undecided = (affected.probability > 0.0) & (affected.probability < MIN_PROBABILITY)
    random = np.where(undecided, np.inf, random)  # either of two headings: no normal error
    columns = np.column_stack([*by_time.values(), leading, random]) if samples else np.zeros((0, len(by_time) + 1))
    columns = np.where((affected.used & np.isfinite(affected.heading_deg))[:, None], columns, np.nan)
    finite = np.where(np.isinf(columns), HOPELESS, columns)
    along = average_slots(finite, affected.time_s, axes, max_gap_s).T * angles.DEGREE
    variance = along[-1] * angles.DEGREE
    count = len(axes.time_s)
    known = np.isfinite(variance)
    constant = np.repeat(np.array(list(constants.values()))[:, None] * angles.DEGREE, count, axis=1)
    step_s = float(np.median(np.diff(affected.time_s))) if samples > 1 else axes.step_s
    names = (*constants, *by_time, *(f"coefficients {k + 1}" for k in range(leading.shape[1])))
    return HeadingErrors(
        names,
        np.concatenate([constant, along[:-1]]),
        np.where(known, np.sqrt(np.where(variance > 100.0, np.nan, variance)), np.nan),
        memory_of(affected.heading_deg, step_s),
        _shares(affected, references, names),
    )


def _shares(affected: AffectedHeadings, references: Sequence[ReferenceCompass], names: Sequence[str]) -> Floats:
    """Return the share of each mode in the heading error of each instrument, the affected one first."""
    shares = np.zeros((1 + len(references), len(names)))
    shares[0] = 1.0
    weights = np.array([r.weight for r in references]) * affected.of_pairs
    modes = [1 + min(k, MAX_REFERENCES - 1) for k in range(len(references))]
    shares[0, 1 : 1 + min(len(references), MAX_REFERENCES)] = 0.0
    for k, (reference, mode) in enumerate(zip(references, modes, strict=True)):
        shares[0, mode] += weights[k]
        shares[1 + k, mode] = 1.0
        shares[1 + k, 0] = float(reference.magnetic)
    if affected.of_pairs and references:
        shares[0, 0] = float(np.sum(weights * [r.magnetic for r in references]))
    return shares
