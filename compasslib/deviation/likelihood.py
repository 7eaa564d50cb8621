"""The likelihood of the overlap's directions given the recorded headings, smooth across the folds of the compass.

For each pair the observed heading d scatters about the unknown correct heading beta, and beta must make the compass
record gamma. Both are written on grids:

    p(d | gamma) = [ sum_b G(gamma, b) pi(b) K(d, b) + e0 sum_b pi(b) K(d, b) ] / [ sum_b G(gamma, b) pi(b) + e0 ]

G is the compass's own noise about arg q(beta), pi the distribution of correct headings (the wake locks them), K the
scatter of directions: heavy-tailed, circular, wider for slower water. All roots are in the sum by themselves and meet
smoothly at a fold; e0 lets a heading that the model cannot record count as uninformative instead of impossible. gamma
is conditioned on and d stands on one side only, so that the noise of the lower direction cannot bias the slope.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.deviation.forms import EXACT, Form
from compasslib.deviation.model import Noise

Floats = NDArray[np.floating]

CELLS = 120  # of the heading's distribution and of the scatter, 3 degrees each
CELL_DEG = 360.0 / CELLS
FREEDOM = 5.0  # degrees of freedom of the scatter's tails
UNPREDICTED = 1e-5  # e0, density per degree of recorded headings that the model does not explain

CELL_CENTRES = CELL_DEG * np.arange(CELLS)


@dataclass(frozen=True)
class Sample:
    """The pairs as the likelihood needs them, in order of the recorded heading's bin."""

    bin: NDArray[np.intp]  # (n,) recorded heading's bin
    begins: NDArray[np.intp]  # first sample of each occupied bin
    occupied: NDArray[np.intp]  # the occupied bins
    scatter: Floats  # (n, CELLS) K
    order: NDArray[np.intp]  # position of each row in the pairs
    form: Form = EXACT  # the curve that is held against them


@dataclass(frozen=True)
class Grid:
    """Fine headings on which the compass is evaluated, and how they share out on the cells."""

    fine: int  # points over the circle, a multiple of CELLS

    @property
    def heading_deg(self) -> Floats:
        """Fine headings, also the centres of the recorded headings' bins."""
        return 360.0 / self.fine * np.arange(self.fine)

    def bin_of(self, recorded_deg: Floats) -> NDArray[np.intp]:
        """Return the bin of recorded headings."""
        return np.rint(recorded_deg * self.fine / 360.0).astype(np.intp) % self.fine

    def hats(self) -> Floats:
        """Return cubic B-spline weights from the fine headings to the cells, (fine, CELLS).

        Splines instead of linear hats: kinks every cell would make the likelihood rough where it is flat.
        """
        away = np.abs(angles.difference(self.heading_deg[:, None], CELL_CENTRES)) / CELL_DEG
        inner = 2.0 / 3.0 - away**2 + away**3 / 2.0
        outer = np.maximum(2.0 - away, 0.0) ** 3 / 6.0
        return np.where(away < 1.0, inner, outer)


COARSE, FINE = Grid(360), Grid(720)


def squared_chords(observed_deg: Floats) -> Floats:
    """Return the squared chord between each observed heading and each cell's centre, (n, CELLS), square degrees.

    Args:
        observed_deg: observed headings, (n,), degrees.
    """
    return angles.chord(observed_deg[:, None] - CELL_CENTRES) ** 2


def scatter(squared_chord: Floats, width_deg: Floats, outliers: float) -> Floats:
    """Return K, the density of the observed heading about each cell's centre, per degree, (n, CELLS).

    Args:
        squared_chord: of the observed headings, (n, CELLS), square degrees.
        width_deg: width for each of them, (n,), degrees.
        outliers: share that says nothing.
    """
    base = 1.0 + squared_chord / (FREEDOM * width_deg[:, None] ** 2)
    density = 1.0 / (base * base * base)  # Student's t with FREEDOM 5: the power is (5 + 1) / 2
    density *= (1.0 - outliers) / (density.sum(axis=1, keepdims=True) * CELL_DEG)
    density += outliers / 360.0
    return density


def sample(recorded_deg: Floats, scatter_density: Floats, grid: Grid, form: Form = EXACT) -> Sample:
    """Return the pairs sorted by the recorded heading's bin.

    Args:
        recorded_deg: recorded headings, (n,), degrees.
        scatter_density: K, (n, CELLS).
        grid: the grid of recorded headings.
        form: the curve that is held against them.
    """
    bins = grid.bin_of(recorded_deg)
    order = np.argsort(bins, kind="stable")
    occupied, begins = np.unique(bins[order], return_index=True)
    return Sample(bins[order], begins, occupied, scatter_density[order], order, form)


def compass_noise(offset_deg: Floats, compass_deg: float) -> Floats:
    """Return G, the density of recorded headings about what the curve predicts, per degree, of the offsets' shape.

    Args:
        offset_deg: recorded minus predicted heading, degrees.
        compass_deg: noise of the recorded heading, degrees.
    """
    return np.exp(-0.5 * (offset_deg / compass_deg) ** 2) / (compass_deg * np.sqrt(2.0 * np.pi))


def value(parameters: Floats, data: Sample, prior: Floats, grid: Grid) -> float:
    """Return the log-likelihood.

    Args:
        parameters: A, B, C, D, E and the logarithm of the compass noise in degrees, (6,).
        data: the pairs.
        prior: pi on the cells, (CELLS,), sums to 1.
        grid: the grid that the sample was sorted on.
    """
    return float(np.sum(values(parameters, data, prior, grid)))


def values(parameters: Floats, data: Sample, prior: Floats, grid: Grid) -> Floats:
    """Return each pair's log-likelihood, in the order of the pairs, (n,).

    Args:
        parameters: A, B, C, D, E and the logarithm of the compass noise in degrees, (6,).
        data: the pairs.
        prior: pi on the cells, (CELLS,), sums to 1.
        grid: the grid that the sample was sorted on.
    """
    parts = _parts(parameters, data, prior, grid)
    result = np.empty(len(data.bin))
    result[data.order] = np.log(parts.joint) - np.log(parts.marginal[parts.row])
    return result


def value_and_gradient(parameters: Floats, data: Sample, prior: Floats, grid: Grid) -> tuple[float, Floats]:
    """Return the log-likelihood and its gradient by A..E and log(compass noise).

    Args:
        parameters: A, B, C, D, E and the logarithm of the compass noise in degrees, (6,).
        data: the pairs.
        prior: pi on the cells, (CELLS,), sums to 1.
        grid: the grid that the sample was sorted on.
    """
    parts = _parts(parameters, data, prior, grid)
    total = float(np.sum(np.log(parts.joint) - np.log(parts.marginal[parts.row])))
    weighted = data.scatter / parts.joint[:, None]
    towards = np.add.reduceat(weighted, data.begins, axis=0) @ parts.hats.T  # (occupied, fine)
    count = np.diff(np.append(data.begins, len(data.bin)))
    towards -= (count / parts.marginal)[:, None]
    towards *= parts.prior_fine * parts.density
    pull = towards * parts.offset / np.exp(2.0 * parameters[5])
    by_width = float(np.sum(pull * parts.offset) - np.sum(towards))
    return total, np.append(_contracted(data.form.slopes(parameters[:5], parts.bins, grid.heading_deg), pull), by_width)


def scores(parameters: Floats, data: Sample, prior: Floats, grid: Grid) -> Floats:
    """Return each pair's gradient by A..E, in the order of the pairs, (n, 5).

    Args:
        parameters: A, B, C, D, E and the logarithm of the compass noise in degrees, (6,).
        data: the pairs.
        prior: pi on the cells, (CELLS,), sums to 1.
        grid: the grid that the sample was sorted on.
    """
    parts = _parts(parameters, data, prior, grid)
    slopes = data.form.slopes(parameters[:5], parts.bins, grid.heading_deg)
    weight = parts.prior_fine * parts.density * parts.offset / np.exp(2.0 * parameters[5])
    result = np.empty((len(data.bin), 5))
    for j in range(5):
        moved = weight * slopes[j]
        joint = np.einsum("nc,nc->n", (moved @ parts.hats)[parts.row], data.scatter)
        result[data.order, j] = joint / parts.joint - (moved.sum(axis=1) / parts.marginal)[parts.row]
    return result


def responsibilities(parameters: Floats, data: Sample, prior: Floats, grid: Grid) -> Floats:
    """Return the posterior of each pair's correct heading on the cells, sorted as the sample, (n, CELLS).

    Args:
        parameters: A, B, C, D, E and the logarithm of the compass noise in degrees, (6,).
        data: the pairs.
        prior: pi on the cells, (CELLS,), sums to 1.
        grid: the grid that the sample was sorted on.
    """
    parts = _parts(parameters, data, prior, grid)
    posterior = parts.given[parts.row] * data.scatter
    return posterior / posterior.sum(axis=1, keepdims=True)


@dataclass(frozen=True)
class _Parts:
    bins: Floats  # (occupied,) recorded headings, degrees
    density: Floats  # G (occupied, fine)
    offset: Floats  # (occupied, fine) degrees
    prior_fine: Floats  # pi on the fine grid
    hats: Floats
    given: Floats  # (occupied, CELLS) joint density of recorded heading and cell
    row: NDArray[np.intp]  # (n,) row of each sample
    joint: Floats  # (n,)
    marginal: Floats  # (occupied,)


def _parts(parameters: Floats, data: Sample, prior: Floats, grid: Grid) -> _Parts:
    hats = _HATS[grid.fine]
    prior_fine = hats @ prior
    prior_fine = prior_fine / prior_fine.sum()
    bins = grid.heading_deg[data.occupied]
    offset = data.form.offset(parameters[:5], bins, grid.heading_deg)
    density = compass_noise(offset, float(np.exp(parameters[5])))
    given = (density * prior_fine) @ hats + UNPREDICTED * prior
    row = np.repeat(np.arange(len(data.begins)), np.diff(np.append(data.begins, len(data.bin))))
    joint = np.einsum("nc,nc->n", given[row], data.scatter)
    return _Parts(bins, density, offset, prior_fine, hats, given, row, joint, given.sum(axis=1))


def _contracted(slopes: Floats, pull: Floats) -> Floats:
    """Return sum over both axes of slopes times pull, (5,), the axis that the slopes do not have summed first.

    A compass that is stuck has one recorded heading, so that the other axis tells nothing of which one is missing.
    """
    if slopes.shape[2] == 1:
        return np.asarray(slopes[:, :, 0] @ pull.sum(axis=1))
    return np.asarray(slopes[:, 0, :] @ pull.sum(axis=0))


_HATS = {grid.fine: grid.hats() for grid in (COARSE, FINE)}


def widths(noise: Noise, upper_speed: Floats, lower_speed: Floats) -> Floats:
    """Return the scatter's width of each pair, never over a full turn, degrees.

    Args:
        noise: the scatter.
        upper_speed: m/s, (n,).
        lower_speed: m/s, (n,).
    """
    return np.minimum(noise.width_deg(np.maximum(upper_speed, 1e-3), np.maximum(lower_speed, 1e-3)), 360.0)
