"""Likelihood of the pairs' directions given the recorded headings, smooth across the folds of the compass.

For each pair the observed heading d scatters about the unknown correct heading beta, and beta makes the compass record
gamma. Both are discretized:

    p(d | gamma) = [ sum_b G(gamma, b) pi(b) K(d, b) + e0 sum_b pi(b) K(d, b) ] / [ sum_b G(gamma, b) pi(b) + e0 ]

G is the compass's own noise about arg q(beta), pi the distribution of correct headings (locked by the wake), K the
scatter of directions: heavy-tailed, circular, wider for slower water. The sum includes all roots, which merge smoothly
at a fold; e0 makes a heading that the model cannot record uninformative instead of impossible. The likelihood is
conditional on gamma, and d appears on one side only, so noise of the lower direction cannot bias the slope.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from compasslib import angles, compass
from compasslib.deviation.model import ScatterNoise
from compasslib.deviation.series import series_design, series_deviation
from compasslib.types import Floats

CELLS = 120  # of the heading's distribution and of the scatter, 3 degrees each
CELL_DEG = 360.0 / CELLS
STUDENT_DOF = 5.0  # degrees of freedom of the scatter's tails
UNEXPLAINED_DENSITY = 1e-5  # e0, density per degree of recorded headings that the model does not explain

CELL_CENTRES = CELL_DEG * np.arange(CELLS)
Indices = NDArray[np.intp]


@dataclass(frozen=True)
class CurveForm:
    """A curve of the recorded against the correct heading, (f,) degrees, with five coefficients A..E."""

    recorded: Callable[[Floats, Floats], Floats]  # coefficients and correct headings -> recorded headings
    gradient: Callable[[Floats, Floats], Floats]  # the same -> derivative by the coefficients, (5, f) degrees per unit


EXACT = CurveForm(compass.recorded_heading, compass.gradient)
SERIES = CurveForm(  # Smith's series in the correct heading, gamma = beta - Delta(beta) (von Appen 2015, eq. 1)
    lambda coefficients, heading_deg: heading_deg - series_deviation(coefficients, heading_deg) / angles.DEGREE,
    lambda coefficients, heading_deg: -series_design(heading_deg).T / angles.DEGREE,
)


@dataclass(frozen=True)
class BinnedSample:
    """The pairs sorted by the bin of their recorded heading, as input of the likelihood."""

    row: Indices  # (n,) index of the occupied bin of each sample
    occupied: Indices  # the occupied bins
    scatter: RowBlocks  # (n, CELLS) K, by occupied bin
    order: Indices  # position of each row in the pairs
    form: CurveForm  # the curve to be fitted


@dataclass(frozen=True)
class HeadingGrid:
    """Fine headings on which the compass is evaluated, and their weights on the cells."""

    fine: int  # points over the circle, a multiple of CELLS

    @property
    def heading_deg(self) -> Floats:
        """Fine headings, degrees, which are also the centres of the recorded headings' bins."""
        return 360.0 / self.fine * np.arange(self.fine)

    def bin_of(self, recorded_deg: Floats) -> Indices:
        """Find the bin of recorded headings."""
        return np.rint(recorded_deg * self.fine / 360.0).astype(np.intp) % self.fine

    @cached_property
    def hats(self) -> Floats:
        """Cubic B-spline weights from the fine headings to the cells, (fine, CELLS): hats have kinks at every cell."""
        away = np.abs(angles.difference(self.heading_deg[:, None], CELL_CENTRES)) / CELL_DEG
        inner = 2.0 / 3.0 - away**2 + away**3 / 2.0
        outer = np.maximum(2.0 - away, 0.0) ** 3 / 6.0
        return np.where(away < 1.0, inner, outer)

    @cached_property
    def splines(self) -> tuple[Indices, Floats]:
        """The four cells that each fine heading contributes to, and its weights, (fine, 4) each."""
        cells = ((np.arange(self.fine) * CELLS // self.fine)[:, None] + np.arange(-1, 3)) % CELLS
        return cells, np.take_along_axis(self.hats, cells, axis=1)


COARSE, FINE = HeadingGrid(360), HeadingGrid(720)


def squared_chords(observed_deg: Floats) -> Floats:
    """Compute the squared chord between each observed heading and each cell's centre, (n, CELLS), square degrees."""
    # The sine of a difference by products: n and CELLS sines instead of n times CELLS.
    sine, cosine = angles.sin_cos(observed_deg[:, None] / 2.0)
    towards = angles.sin_cos(CELL_CENTRES / 2.0)
    return (2.0 / angles.DEGREE * (sine * towards[1] - cosine * towards[0])) ** 2


def scatter_density(squared_chord: Floats, width_deg: Floats, outliers: float) -> Floats:
    """Compute K, the density of the observed heading about each cell's centre, per degree, (n, CELLS)."""
    ratio = squared_chord / (STUDENT_DOF * width_deg[:, None] ** 2)
    ratio += 1.0
    np.reciprocal(ratio, out=ratio)
    density = ratio * ratio
    density *= ratio  # Student's t with STUDENT_DOF 5: the exponent is (5 + 1) / 2
    density *= (1.0 - outliers) / (density.sum(axis=1, keepdims=True) * CELL_DEG)
    density += outliers / 360.0
    return density


def bin_sample(
    recorded_deg: Floats, scatter_density: Floats, grid: HeadingGrid, form: CurveForm = EXACT
) -> BinnedSample:
    """Sort the pairs, and their K, (n, CELLS), by the recorded heading's bin."""
    bins = grid.bin_of(recorded_deg)
    order = np.argsort(bins, kind="stable")
    occupied, begins, row = np.unique(bins[order], return_index=True, return_inverse=True)
    return BinnedSample(row, occupied, block_rows(scatter_density[order], begins), order, form)


def normal_density(offset_deg: ArrayLike, sigma_deg: float) -> Floats:
    """Compute a normal density, as G of recorded minus predicted headings, per degree, in the shape of the offsets."""
    return np.exp(-0.5 * (np.asarray(offset_deg) / sigma_deg) ** 2) / (sigma_deg * np.sqrt(2.0 * np.pi))


def log_likelihood(parameters: Floats, data: BinnedSample, prior: Floats, grid: HeadingGrid) -> float:
    """Compute the log-likelihood for A..E and log(compass noise / degree), (6,), and pi on the cells.

    Args:
        parameters: A, B, C, D, E and the logarithm of the compass noise in degrees, (6,).
        prior: pi on the cells, (CELLS,), sums to 1.
    """
    return float(np.sum(pair_log_likelihoods(parameters, data, prior, grid)))


def pair_log_likelihoods(parameters: Floats, data: BinnedSample, prior: Floats, grid: HeadingGrid) -> Floats:
    """Compute each pair's log-likelihood, in the order of the pairs, (n,); arguments as for ``log_likelihood``."""
    parts, joint = _parts(parameters, data, prior, grid)
    result = np.empty(len(data.row))
    result[data.order] = np.log(joint) - np.log(parts.marginal[data.row])
    return result


def log_likelihood_and_gradient(
    parameters: Floats, data: BinnedSample, prior: Floats, grid: HeadingGrid
) -> tuple[float, Floats]:
    """Compute the log-likelihood and its gradient by A..E and log(compass noise), (6,); see ``log_likelihood``."""
    parts, joint = _parts(parameters, data, prior, grid)
    total = float(np.sum(np.log(joint) - np.log(parts.marginal[data.row])))
    pull = data.scatter.summed(1.0 / joint) - (np.bincount(data.row) / parts.marginal)[:, None]
    towards = np.sum(pull.take(parts.cell) * parts.share, axis=1)
    pull = towards * parts.offset / np.exp(2.0 * parameters[5])
    by_width = float(np.sum(pull * parts.offset) - np.sum(towards))
    return total, np.append(_form_slopes(parameters, data, grid, parts) @ pull, by_width)


def pair_scores(parameters: Floats, data: BinnedSample, prior: Floats, grid: HeadingGrid) -> Floats:
    """Compute each pair's gradient by A..E and log(compass noise), in the order of the pairs, (n, 6)."""
    parts, joint = _parts(parameters, data, prior, grid)
    pull = parts.offset / np.exp(2.0 * parameters[5])
    result = np.empty((len(data.row), 6))
    for j, by in enumerate([*_form_slopes(parameters, data, grid, parts) * pull, pull * parts.offset - 1.0]):
        moved = _sum_cells(parts.cell, parts.share * by[:, None], len(data.occupied))
        by_joint, by_marginal = data.scatter.times(moved) / joint, moved.sum(axis=1) / parts.marginal
        result[data.order, j] = by_joint - by_marginal[data.row]
    return result


def heading_occupancy(parameters: Floats, data: BinnedSample, prior: Floats, grid: HeadingGrid) -> Floats:
    """Sum the posterior distributions of the pairs' correct headings on the cells, (CELLS,)."""
    parts, joint = _parts(parameters, data, prior, grid)
    return np.asarray(np.sum(parts.given * data.scatter.summed(1.0 / joint), axis=0))


def heading_given_reading(
    parameters: Floats, recorded_deg: Floats, prior: Floats, grid: HeadingGrid, form: CurveForm
) -> Floats:
    """Compute the distribution of the correct heading on the cells for each recorded one, (n, CELLS)."""
    occupied, row = np.unique(grid.bin_of(recorded_deg), return_inverse=True)
    given = _laid_out(parameters, occupied, prior, grid, form).given
    return np.asarray((given / given.sum(axis=1, keepdims=True))[row])


@dataclass(frozen=True)
class _Layout:
    column: Indices  # (k,) index of fine correct headings near the recorded ones
    offset: Floats  # (k,) recorded minus predicted heading, degrees
    cell: Indices  # (k, 4) flat index of recorded heading and cell
    share: Floats  # (k, 4) prior times G times spline
    given: Floats  # (occupied, CELLS) joint density of recorded heading and cell
    marginal: Floats  # (occupied,)


def _parts(parameters: Floats, data: BinnedSample, prior: Floats, grid: HeadingGrid) -> tuple[_Layout, Floats]:
    """Compute the intermediate results, and each pair's joint density, (n,), in the order of the sample."""
    laid = _laid_out(parameters, data.occupied, prior, grid, data.form)
    return laid, data.scatter.times(laid.given)


def _laid_out(parameters: Floats, occupied: Indices, prior: Floats, grid: HeadingGrid, form: CurveForm) -> _Layout:
    """Place the headings near each occupied reading, with their prior and the density of the reading."""
    width = float(np.exp(parameters[5]))
    predicted = form.recorded(parameters[:5], grid.heading_deg)
    # Beyond eight widths the density is far below e0.
    row, column, offset = nearby_headings(grid.heading_deg[occupied], predicted, min(8.0 * width, 180.0))
    cells, weights = grid.splines
    prior_fine = grid.hats @ prior
    # take() copies whole rows and needs a third of the time of indexing with brackets.
    density = normal_density(offset, width) * (prior_fine / prior_fine.sum()).take(column)
    cell = (row * CELLS)[:, None] + cells.take(column, axis=0)
    share = density[:, None] * weights.take(column, axis=0)
    given = _sum_cells(cell, share, len(occupied)) + UNEXPLAINED_DENSITY * prior
    return _Layout(column, offset, cell, share, given, given.sum(axis=1))


def _sum_cells(cell: Indices, share: Floats, rows: int) -> Floats:
    return np.bincount(cell.ravel(), share.ravel(), rows * CELLS).astype(float, copy=False).reshape(rows, CELLS)


def _form_slopes(parameters: Floats, data: BinnedSample, grid: HeadingGrid, parts: _Layout) -> Floats:
    """Compute minus the derivative of the nearby offsets by A..E, (5, k) degrees."""
    return data.form.gradient(parameters[:5], grid.heading_deg).T.take(parts.column, axis=0).T


def scatter_widths(noise: ScatterNoise, upper_speed: Floats, lower_speed: Floats) -> Floats:
    """Compute the width of each pair's scatter, at most a full turn, (n,) degrees."""
    return np.minimum(noise.width_deg(np.maximum(upper_speed, 1e-3), np.maximum(lower_speed, 1e-3)), 360.0)


# Sparse sums: pairs share a bin, and only a few correct headings can produce a recorded one. Compass noise of 1 degree
# reaches a twentieth of the circle, and only the cells within reach are stored, as a list.


ROWS_PER_BLOCK = 8  # for speed; results do not depend on it


def nearby_headings(recorded_deg: Floats, predicted_deg: Floats, reach_deg: float) -> tuple[Indices, Indices, Floats]:
    """Pair recorded, (r,), and predicted headings, (f,), within a reach: indices of both, difference, (k,)."""
    recorded, predicted = angles.wrap360(recorded_deg), angles.wrap360(predicted_deg)
    order = np.argsort(predicted, kind="stable")
    ring = np.concatenate([predicted[order] + turn for turn in (-360.0, 0.0, 360.0)])
    begin, end = (np.searchsorted(ring, recorded + side) for side in (-reach_deg, reach_deg))
    count = end - begin
    row = np.repeat(np.arange(len(recorded)), count)
    at = np.arange(len(row)) + np.repeat(begin - np.cumsum(count) + count, count)
    return row, np.tile(order, 3).take(at), recorded.take(row) - ring.take(at)


@dataclass(frozen=True)
class RowBlocks:
    """The rows of a matrix in groups of different lengths, padded to blocks of equal length."""

    rows: Floats  # (b, ROWS_PER_BLOCK, c), padded with ones
    place: Indices  # (n,) position of each row
    group: Indices  # (b,) group of each block
    first: Indices  # (g,) first block of each group

    def times(self, vectors: Floats) -> Floats:
        """Multiply each row by the vector of its group, vectors (g, c), result (n,)."""
        return np.asarray(np.matmul(self.rows, vectors[self.group][:, :, None]).ravel()[self.place])

    def summed(self, weights: Floats) -> Floats:
        """Sum the rows of each group with weights, (n,); result (g, c)."""
        laid = np.zeros(self.rows.shape[:2])
        laid.ravel()[self.place] = weights
        return np.add.reduceat(np.matmul(laid[:, None, :], self.rows)[:, 0, :], self.first, axis=0)


def block_rows(matrix: Floats, begins: Indices) -> RowBlocks:
    """Divide a matrix whose rows are sorted by group, which begin at rows (g,), into blocks."""
    count = np.diff(np.append(begins, len(matrix)))
    each = -(-count // ROWS_PER_BLOCK)
    first = np.cumsum(each) - each
    place = np.arange(len(matrix)) + np.repeat(first * ROWS_PER_BLOCK - begins, count)
    rows = np.ones((int(each.sum()), ROWS_PER_BLOCK, matrix.shape[1]))
    rows.reshape(-1, matrix.shape[1])[place] = matrix
    return RowBlocks(rows, place, np.repeat(np.arange(len(count)), each), first)
