"""What other records of a compass tell of its coefficients, before a record's own pairs are looked at."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from compasslib.types import Floats


@dataclass(frozen=True)
class Prior:
    """A normal law of A..E; where its precision is 0 it tells nothing."""

    mean: Floats  # (5,)
    precision: Floats  # (5, 5)

    def to_json(self) -> dict[str, Any]:
        """Return it for deviation.json."""
        return {"mean": self.mean.tolist(), "precision": self.precision.tolist()}


def from_json(content: Mapping[str, Any] | None) -> Prior | None:
    """Return the prior that a deviation.json holds, None where it holds none."""
    return None if content is None else Prior(np.array(content["mean"]), np.array(content["precision"]))
