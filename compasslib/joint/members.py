"""The records of one compass as the joint inference needs them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from compasslib.deviation.model import LETTERS
from compasslib.inference import sharing
from compasslib.inference.sharing import Effects
from compasslib.types import Floats


def _unknown() -> Floats:
    return np.zeros(0)


@dataclass(frozen=True)
class Member:
    """One deployment or calibration; without coefficients where its own pairs determine none."""

    name: str
    kind: str  # mooring, or the kind of a calibration
    sphere: str | None
    horizontal_nT: float
    vertical_nT: float
    coefficients: Floats  # (5,) A..E of the exact compass there
    covariance: Floats  # (5, 5)
    effects: Effects | None = None
    why: str = ""  # why it tells nothing, where it does not

    @property
    def tells(self) -> bool:
        """Whether its own recording determines the compass."""
        return bool(self.coefficients.size)


def of_mooring(content: Mapping[str, Any], sphere: str | None) -> Member:
    """Return a mooring's record by its summary."""
    told, place = content["told"], (content["horizontal_nT"], content["vertical_nT"])
    if told is None:
        return Member(content["name"], "mooring", sphere, *place, _unknown(), _unknown(), why=content["why"])
    effects = None if told["effects"] is None else sharing.from_json(told["effects"])
    found = np.array(told["coefficients"]), np.array(told["covariance"])
    return Member(content["name"], "mooring", sphere, *place, *found, effects)


def of_calibration(content: Mapping[str, Any], sphere: str | None) -> Member:
    """Return a calibration by its calibration.json; without coefficients where its headings do not determine them."""
    field, exact = content["place"]["field"] or {}, content["exact"]
    bare = Member(
        content["name"],
        content["kind"],
        sphere,
        field.get("horizontal_nT", np.nan),
        field.get("vertical_nT", np.nan),
        _unknown(),
        _unknown(),
        why=content["why"] or "its headings, or its place, do not determine the exact compass",
    )
    covariance = np.array([[np.nan]]) if exact is None else np.array(exact["covariance"], dtype=float)
    if not field or not np.isfinite(covariance).all():
        return bare
    found = np.array([exact["coefficients"][k] for k in LETTERS])
    return replace(bare, coefficients=found, covariance=covariance, why="")


def summary(name: str, field: tuple[float, float], told: Any, *, span_s: Sequence[float], why: str) -> dict[str, Any]:
    """Return what a mooring's record tells of its compass, as ``of_mooring`` takes it.

    Args:
        field: horizontal and vertical, nT, the mean of the deployment.
        told: ``sharing.Told``, None where it tells nothing.
        span_s: first and last pair, UTC seconds; empty without any.
        why: why it tells nothing.
    """
    return {
        "name": name,
        "horizontal_nT": field[0],
        "vertical_nT": field[1],
        "span_s": list(span_s),
        "told": None if told is None else told.to_json(),
        "why": why,
    }
