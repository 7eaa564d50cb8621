"""Which magnets to turn on which course, what remains then, and whether a compass may go to sea (MM section 7)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from compasslib import angles
from compasslib.calibrations.result import LETTERS, DeviationTable
from compasslib.deviation import von_appen
from compasslib.types import Floats

LIMIT_DEG, SHORT_M, LEAST_SPEED_KN = 4.0, 82.5, 7.0  # ISO 25862:2019, Annex G.1; MM section 7.3
TWO_SIGMA = 1.959964
LEFT_OUT = {"none": "", "B": "B", "C": "C", "both": "BC"}


@dataclass(frozen=True)
class Magnets:
    """What nullifies one coefficient."""

    letter: str
    lie: str  # longitudinal | transversal
    courses_deg: tuple[float, float]  # compass courses, either of which does
    settle_deg: tuple[float, float]  # what the compass must show then
    red_towards: str  # where the red (north-seeking) ends of magnets below or beside the compass point
    text: str


def table(coefficients: Floats, covariance: Floats, step_deg: float) -> DeviationTable:
    """Return the deviation table by recorded heading, north first.

    Args:
        coefficients: A..E, degrees, (5,).
        covariance: (5, 5).
        step_deg: between headings, commonly 10 or 15.
    """
    heading = np.arange(0.0, 360.0 - 1e-9, step_deg)
    columns = von_appen.design(heading)
    sigma = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", columns, covariance, columns), 0.0))
    return DeviationTable(heading, columns @ coefficients, sigma)


def magnets(letter: str, value_deg: float) -> Magnets:
    """Return how to nullify B or C (MM section 7.2, point 7).

    A positive B is a field towards the bow. Above or beside its middle a magnet's field runs against its red end, so
    red ends forward take it away; for C the same with starboard (Handbook of Magnetic Compass Adjustment).

    Args:
        letter: ``B`` or ``C``.
        value_deg: the coefficient, degrees.
    """
    b = letter == "B"
    courses = (90.0 - value_deg, 270.0 + value_deg) if b else (-value_deg, 180.0 + value_deg)
    first, second = (float(x) for x in angles.wrap360(courses))
    settle = (90.0, 270.0) if b else (0.0, 180.0)
    lie = "longitudinal" if b else "transversal"
    red = ("forward" if value_deg > 0 else "aft") if b else ("to starboard" if value_deg > 0 else "to port")
    text = (
        f"To nullify {letter} ({value_deg:+.1f}°): steer {first:05.1f}° (or {second:05.1f}°) by compass, read the "
        f"course over ground, keep it by the receiver, and turn the {lie} magnets, red ends {red}, until the compass "
        f"shows {settle[0]:03.0f}° (or {settle[1]:03.0f}°)."
    )
    return Magnets(letter, lie, (first, second), settle, red, text)


def plan(coefficients: Floats, step_deg: float) -> dict[str, Any]:
    """Return magnets for B and C and the table that each choice leaves (MM section 7.2, points 8 and 9).

    Args:
        coefficients: A..E, degrees, (5,).
    """
    remains, largest = {}, {}
    for choice, letters in LEFT_OUT.items():
        kept = coefficients * [letter not in letters for letter in LETTERS]
        remains[choice] = table(kept, np.zeros((5, 5)), step_deg).deviation_deg.tolist()
        largest[choice] = float(np.max(np.abs(remains[choice])))
    found = {letter: vars(magnets(letter, float(coefficients[LETTERS.index(letter)]))) for letter in "BC"}
    return {
        "magnets": found,
        "residual_table_deg": remains,
        "largest_deg": largest,
        "text": _advice(coefficients, largest),
    }


def verdict(found: DeviationTable, length_m: float | None, speed_kn: float | None) -> dict[str, Any]:
    """Return whether the deviations stay within 4 degrees (ISO 25862:2019, Annex G.1), with the conditions said.

    Args:
        length_m: of the vessel, where known.
        speed_kn: the median speed of the swing, where known.
    """
    size = np.abs(found.deviation_deg)
    surely, perhaps = size - TWO_SIGMA * found.sigma_deg > LIMIT_DEG, size + TWO_SIGMA * found.sigma_deg > LIMIT_DEG
    word = "exceeds" if surely.any() else "undecided" if perhaps.any() else "within"
    if length_m is not None and length_m >= SHORT_M:
        word = "not judged"
    worst = int(np.argmax(size))
    largest = f"largest {found.deviation_deg[worst]:+.1f}° ± {TWO_SIGMA * found.sigma_deg[worst]:.1f}° (95 %)"
    text = {
        "exceeds": f"A deviation exceeds 4°: {largest} on {found.heading_deg[worst]:03.0f}°.",
        "undecided": f"Whether every deviation is within 4° is not decided: {largest}.",
        "within": f"Every deviation is within 4°: {largest}.",
        "not judged": f"The limit of 4° is for ships under {SHORT_M} m; this one has {length_m} m. {largest}.",
    }[word]
    conditions = [_length(length_m), _speed(speed_kn)]
    return {
        "verdict": word,
        "largest_deg": float(found.deviation_deg[worst]),
        "on_deg": float(found.heading_deg[worst]),
        "conditions": [line for line in conditions if line],
        "text": text,
    }


def _advice(coefficients: Floats, largest: dict[str, float]) -> str:
    if largest["none"] <= LIMIT_DEG:
        return f"No deviation exceeds 4° (largest {largest['none']:.1f}°); nothing need be nullified."
    first = max("BC", key=lambda letter: abs(coefficients[LETTERS.index(letter)]))
    if largest[first] <= LIMIT_DEG:
        return f"Nullify {first}: the largest deviation falls from {largest['none']:.1f}° to {largest[first]:.1f}°."
    if largest["both"] <= LIMIT_DEG:
        return f"Nullify B and C: the largest deviation falls from {largest['none']:.1f}° to {largest['both']:.1f}°."
    return (
        f"With B and C nullified {largest['both']:.1f}° remain, more than 4°: soft iron beside the compass; "
        "only another place for the compass, or soft-iron correctors, take it away."
    )


def _length(length_m: float | None) -> str:
    return (
        f"The length of the ship is not given; the limit of 4° is for ships under {SHORT_M} m."
        if length_m is None
        else ""
    )


def _speed(speed_kn: float | None) -> str:
    if speed_kn is None:
        return "The speed is not known; the method asks for at least 7 kn."
    if speed_kn < LEAST_SPEED_KN:
        return f"The swing was made at {speed_kn:.1f} kn; the method asks for at least 7 kn."
    return ""
