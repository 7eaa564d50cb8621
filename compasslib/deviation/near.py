"""Sums of the likelihood without its zeros: few correct headings can have made a recorded one, pairs share a bin.

A compass's noise of 1 degree reaches a twentieth of the circle. Only those cells are laid out, as a list.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compasslib import angles

Floats = NDArray[np.floating]
Indices = NDArray[np.intp]

PAIRS_A_BLOCK = 8  # rows that are multiplied at once; a bin's last block is filled up


@dataclass(frozen=True)
class Near:
    """Which correct headings lie near which recorded ones; k of them."""

    row: Indices  # (k,) of the recorded heading
    column: Indices  # (k,) of the correct heading
    offset: Floats  # (k,) first side minus second, degrees


def nearby(recorded_deg: Floats, predicted_deg: Floats, reach_deg: float) -> Near:
    """Return all places where two sides differ by less than a reach.

    Args:
        recorded_deg: one side, (r,), degrees.
        predicted_deg: the other, (f,), degrees.
        reach_deg: at most 180 degrees.
    """
    recorded, predicted = angles.wrap360(recorded_deg), angles.wrap360(predicted_deg)
    order = np.argsort(predicted, kind="stable")
    ring = np.concatenate([predicted[order] + turn for turn in (-360.0, 0.0, 360.0)])
    begin, end = (np.searchsorted(ring, recorded + side) for side in (-reach_deg, reach_deg))
    count = end - begin
    row = np.repeat(np.arange(len(recorded)), count)
    at = np.arange(len(row)) + np.repeat(begin - np.cumsum(count) + count, count)
    return Near(row, np.tile(order, 3).take(at), recorded.take(row) - ring.take(at))


@dataclass(frozen=True)
class Blocks:
    """The rows of a matrix in groups of different lengths, laid out in blocks of one length."""

    rows: Floats  # (b, PAIRS_A_BLOCK, c), ones where a block is filled up
    place: Indices  # (n,) of each row
    group: Indices  # (b,) that each block belongs to
    first: Indices  # (g,) block of each group

    def times(self, vectors: Floats) -> Floats:
        """Return each row times its group's vector, (n,).

        Args:
            vectors: one a group, (g, c).
        """
        return np.asarray(np.matmul(self.rows, vectors[self.group][:, :, None]).ravel()[self.place])

    def summed(self, weights: Floats) -> Floats:
        """Return each group's sum of its rows, weighted, (g, c).

        Args:
            weights: of the rows, (n,).
        """
        laid = np.zeros(self.rows.shape[:2])
        laid.ravel()[self.place] = weights
        return np.add.reduceat(np.matmul(laid[:, None, :], self.rows)[:, 0, :], self.first, axis=0)


def blocks(matrix: Floats, begins: Indices) -> Blocks:
    """Lay out a matrix whose rows are sorted by group.

    Args:
        matrix: (n, c).
        begins: first row of each group, (g,).
    """
    count = np.diff(np.append(begins, len(matrix)))
    each = -(-count // PAIRS_A_BLOCK)
    first = np.cumsum(each) - each
    place = np.arange(len(matrix)) + np.repeat(first * PAIRS_A_BLOCK - begins, count)
    rows = np.ones((int(each.sum()) * PAIRS_A_BLOCK, matrix.shape[1]))
    rows[place] = matrix
    shape = (-1, PAIRS_A_BLOCK, matrix.shape[1])
    return Blocks(rows.reshape(shape), place, np.repeat(np.arange(len(count)), each), first)
