"""What to turn and how far: magnets by the courses of a swing, and spheres for D and E.

Moncunill Marimon et al. 2023 (MM), (6) to (9), (16), (17) and (27) to (30), for the magnets. The field of a sphere of
soft iron of high permeability in a field F is (a/r)^3 (3 (F n) n - F), a its radius, at the distance r along n.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from compasslib import angles
from compasslib.calibrations.result import LETTERS
from compasslib.calibrations.swing.adjustment import LIMIT_DEG
from compasslib.types import Floats

# Of each cardinal course the letter that magnets change, its sign in the deviation, and that of E; MM (2) to (5).
CARDINAL = {"N": ("C", 1.0, 1.0), "E": ("B", 1.0, -1.0), "S": ("C", -1.0, 1.0), "W": ("B", -1.0, -1.0)}
COURSE_DEG = {"N": 0.0, "E": 90.0, "S": 180.0, "W": 270.0}
OPPOSITE = {"N": "S", "S": "N", "E": "W", "W": "E"}
MAGNETS = {"B": "longitudinal", "C": "transversal"}
MIN_QUADRANTAL_DEG = 0.5  # D and E that spheres are worth placing for
SPHERE_MM = 180.0  # diameter of the spheres of an ordinary binnacle


def adjust(
    coefficients: Floats, first: tuple[str, str] = ("E", "N"), water_deg: tuple[float, float] = (0.0, 0.0)
) -> list[dict[str, Any]]:
    """Simulate the adjustment on four cardinal courses: nullify on the first two, halve on their opposites.

    What is left of B and C is the drift of the water, x and -y: A, D and E do not change.

    Args:
        coefficients: A to E before, degrees, (5,).
        first: the two courses on which the compass is set to the course.
        water_deg: x and y of MM (22).

    Returns:
        A step each: course, magnets, pseudo-deviation less declination before and after, B and C after, text.
    """
    letters = dict(zip(LETTERS, (float(k) for k in coefficients), strict=True))
    drift = {"B": -water_deg[0], "C": water_deg[1]}  # in the pseudo-deviation, MM (23) to (26), first order
    steps = []
    for course, share in [(c, 1.0) for c in first] + [(OPPOSITE[c], 0.5) for c in first]:
        letter, sign, of_e = CARDINAL[course]
        before = letters["A"] + sign * (letters[letter] + drift[letter]) + of_e * letters["E"]
        letters[letter] -= sign * share * before
        shown = angles.wrap360(COURSE_DEG[course] - before + share * before)
        what = "nullify it" if share == 1.0 else "take half of it away"
        text = (
            f"On {course} the compass is off by {before:+.1f}°; {what}: turn the {MAGNETS[letter]} magnets until it "
            f"shows {shown:05.1f}°."
        )
        step = {"course": course, "magnets": MAGNETS[letter], "before_deg": before, "after_deg": (1.0 - share) * before}
        steps.append(step | {"B": letters["B"], "C": letters["C"], "shows_deg": float(shown), "text": text})
    return steps


def magnet_field(value_deg: float, horizontal_nT: float) -> float:
    """Compute the field towards the bow that nullifies B, or towards starboard that nullifies C, nT over lambda."""
    return -float(angles.sin_cos(value_deg)[0]) * horizontal_nT


def spheres(d_deg: float, e_deg: float, diameter_mm: float = SPHERE_MM) -> dict[str, float] | None:
    """Place two spheres of soft iron that nullify D and E; None where both are small.

    3 (a/r)^3 = lambda sqrt(D^2 + E^2), with lambda, 0.8 to 1 aboard, taken as 1: its tenth is 3.5 % of the distance.
    The line of their centres stands athwartships for positive D, slewed clockwise by half of the angle of (D, E).
    """
    d, e = (float(sine) for sine in angles.sin_cos([d_deg, e_deg])[0])
    size = float(np.hypot(d, e))
    if size < MIN_QUADRANTAL_DEG * angles.DEGREE:
        return None
    slew = float(angles.wrap180(angles.direction(e, d))) / 2.0
    distance = diameter_mm / 2.0 * (3.0 / size) ** (1.0 / 3.0)
    return {"slew_deg": slew, "distance_mm": distance, "diameter_mm": diameter_mm}


def plan(coefficients: Floats, largest_deg: float, horizontal_nT: float | None) -> dict[str, Any]:
    """Plan the adjustment of a compass: magnets course by course, their fields, spheres.

    Args:
        coefficients: A to E, degrees, (5,).
        largest_deg: deviation; up to 4 degrees nothing need be adjusted, and no text advises it.
        horizontal_nT: the earth's, None where it is unknown.
    """
    letters, steps = dict(zip(LETTERS, coefficients.tolist(), strict=True)), adjust(coefficients)
    placed = spheres(letters["D"], letters["E"])
    fields = {k: magnet_field(letters[k], horizontal_nT) for k in "BC"} if horizontal_nT is not None else None
    content = {"steps": steps, "field_nT": fields, "spheres": placed}
    if largest_deg <= LIMIT_DEG:
        return content
    sentences = [step["text"] for step in steps]
    if fields:
        forward, starboard = fields["B"], fields["C"]
        sentences.append(
            f"The magnets make {abs(forward):.0f} nT towards the {'bow' if forward > 0 else 'stern'} and "
            f"{abs(starboard):.0f} nT towards {'starboard' if starboard > 0 else 'port'}, times lambda."
        )
    if placed:
        sense = "clockwise" if placed["slew_deg"] >= 0 else "anticlockwise"
        sentences.append(
            f"D {letters['D']:+.1f}° and E {letters['E']:+.1f}° are nullified by two soft-iron spheres of "
            f"{placed['diameter_mm']:.0f} mm, centres {placed['distance_mm']:.0f} mm from the compass, their line "
            f"{abs(placed['slew_deg']):.0f}° {sense} of athwartships."
        )
    return content | {"text": " ".join(sentences)}
