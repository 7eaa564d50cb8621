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


@dataclass(frozen=True)
class AffectedHeadings:
    """Corrected headings of an affected instrument at n samples, and the parts of their error."""

    name: str
    time_s: Floats
    used: Bools  # (n,) whether velocities of the sample go into the grid
    heading_deg: Floats
    sigma_deg: Floats  # all but declination and the reference's compass
    probability: Floats  # of the branch
    columns_deg: Floats  # (n, p) by the coefficients of the compass, per unit normal
    doubted_deg: Floats  # (n,) standard deviation of what is suspected, within sigma_deg
    unexplained_deg: float  # standard deviation of what was seen and not corrected, within sigma_deg
    veer_deg: float  # of the mean current between the depths, where the coefficients' covariance does not hold it
    weights: (
        Floats  # (r,) share of each reference in the pairs behind the coefficients; zero where they are of no pairs
    )


@dataclass(frozen=True)
class _Decomposition:
    """The heading error of one affected instrument along t times."""

    names: tuple[str, ...]
    modes: Floats  # (k, t) radians per unit normal
    random: Floats  # (t,) radians
    memory_s: float


def heading_errors(
    affected: Sequence[AffectedHeadings],
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
    constants = {"declination": declination_deg}
    constants |= {f"compass of {r.name}": r.sigma_deg for r in references[: MAX_REFERENCES - 1]}
    if others := references[MAX_REFERENCES - 1 :]:
        name = "compass of " + " and ".join(r.name for r in others)
        constants[name] = max(r.sigma_deg for r in others)
    count = (MAX_MODES - len(constants)) // len(affected)
    parts = [_decompose(each, axes, max_gap_s, count) for each in affected]
    constant = np.repeat(np.array(list(constants.values()))[:, None] * angles.DEGREE, len(axes.time_s), axis=1)
    named = [(part.names, f" of {each.name}" * (len(parts) > 1)) for part, each in zip(parts, affected, strict=True)]
    shares = _shares(affected, references, len(constants), [len(part.modes) for part in parts])
    return HeadingErrors(
        (*constants, *(f"{name}{suffix}" for names, suffix in named for name in names)),
        np.concatenate([constant, *(part.modes for part in parts)]),
        np.array([part.random for part in parts]),
        max(part.memory_s for part in parts),
        shares,
    )


def _decompose(affected: AffectedHeadings, axes: Axes, max_gap_s: float, count: int) -> _Decomposition:
    """Decompose the heading error of one instrument into modes, at most ``count``, and a random part."""
    samples = len(affected.time_s)
    by_time = {"veer": np.full(samples, affected.veer_deg), "unexplained": np.full(samples, affected.unexplained_deg)}
    by_time |= {"doubts": affected.doubted_deg}
    by_time = {name: series for name, series in by_time.items() if np.any(series > 0.0)}
    columns, name = affected.columns_deg, "coefficients"
    within = np.sum(columns**2, axis=1)
    within += sum((series**2 for key, series in by_time.items() if key != "veer"), np.zeros(samples))
    if len(by_time) + 2 > count:  # several instruments share the modes
        columns, name, by_time = np.column_stack([columns, *by_time.values()]), "errors", {}
    leading, left = compress(columns, count - len(by_time))
    random = np.maximum(affected.sigma_deg**2 - within, 0.0) + left
    undecided = (affected.probability > 0.0) & (affected.probability < MIN_PROBABILITY)
    random = np.where(undecided, np.inf, random)  # either of two headings: no normal error
    columns = np.column_stack([*by_time.values(), leading, random]) if samples else np.zeros((0, len(by_time) + 1))
    columns = np.where((affected.used & np.isfinite(affected.heading_deg))[:, None], columns, np.nan)
    finite = np.where(np.isinf(columns), HOPELESS, columns)
    along = average_slots(finite, affected.time_s, axes, max_gap_s).T * angles.DEGREE
    variance = along[-1] * angles.DEGREE
    step_s = float(np.median(np.diff(affected.time_s))) if samples > 1 else axes.step_s
    return _Decomposition(
        (*by_time, *(f"{name} {k + 1}" for k in range(leading.shape[1]))),
        along[:-1],
        np.where(np.isfinite(variance), np.sqrt(np.where(variance > 100.0, np.nan, variance)), np.nan),
        memory_of(affected.heading_deg, step_s),
    )


def _shares(
    affected: Sequence[AffectedHeadings], references: Sequence[ReferenceCompass], constants: int, modes: Sequence[int]
) -> Floats:
    """Return the share of each mode in the heading error of each instrument, affected ones first.

    Args:
        constants: number of modes that are the declination's and the references' compasses.
        modes: number of modes of each affected instrument, which follow them.
    """
    shares = np.zeros((len(affected) + len(references), constants + sum(modes)))
    of_reference = [1 + min(k, MAX_REFERENCES - 1) for k in range(len(references))]
    magnetic = np.array([r.magnetic for r in references], dtype=float)
    ends = constants + np.cumsum([0, *modes])
    for k, each in enumerate(affected):
        shares[k, ends[k] : ends[k + 1]] = 1.0
        shares[k, 0] = each.weights @ magnetic if np.any(each.weights) else 1.0
        np.add.at(shares[k], of_reference, each.weights)
    for k, mode in enumerate(of_reference):
        shares[len(affected) + k, mode] = 1.0
        shares[len(affected) + k, 0] = magnetic[k]
    return shares
