"""Stretches of a record whose corrected headings may be wrong by more than the fit's own uncertainty."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np

from compasslib.records import stamp
from compasslib.types import Bools, Floats

KNOWS_NOTHING_DEG = 360.0 / np.sqrt(12.0)  # standard deviation of a heading that may be anything


@dataclass(frozen=True)
class Doubt:
    """A stretch of time whose headings are flagged doubtful."""

    from_s: float  # first and last instant, UTC seconds; -inf and inf: the whole record
    to_s: float
    sigma_deg: float  # standard deviation of the error that is suspected
    why: str

    def to_json(self) -> dict[str, Any]:
        """Return it for deviation.json; the ends of a whole record are null."""
        ends = {"from": self.from_s, "to": self.to_s}
        return {name: stamp(when) if np.isfinite(when) else None for name, when in ends.items()} | {
            "sigma_deg": self.sigma_deg,
            "why": self.why,
        }


def whole_record(sigma_deg: float, why: str) -> Doubt:
    """Doubt every heading of a record."""
    return Doubt(-np.inf, np.inf, sigma_deg, why)


def from_json(content: Sequence[Mapping[str, Any]]) -> tuple[Doubt, ...]:
    """Return the doubts that a deviation.json lists."""

    def instant(text: str | None, absent: float) -> float:
        return absent if text is None else datetime.fromisoformat(text).timestamp()

    return tuple(
        Doubt(instant(item["from"], -np.inf), instant(item["to"], np.inf), item["sigma_deg"], item["why"])
        for item in content
    )


def along_time(doubts: Sequence[Doubt], time_s: Floats) -> tuple[Bools, Floats]:
    """Return which samples are doubted, and the standard deviation that the doubts add to each, (n,) degrees each."""
    doubted, variance = np.zeros(time_s.shape, dtype=bool), np.zeros(time_s.shape)
    for doubt in doubts:
        inside = (time_s >= doubt.from_s) & (time_s <= doubt.to_s)
        doubted |= inside
        variance[inside] += doubt.sigma_deg**2
    return doubted, np.minimum(np.sqrt(variance), KNOWS_NOTHING_DEG)
