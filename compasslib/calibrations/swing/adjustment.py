"""Coefficients from the eight principal courses: Moncunill Marimon et al. 2023 (MM), J. Navigation. In degrees.

A pseudo-deviation is the course over ground minus the compass course. A, D and E derived from it are free of set and
drift of the water except for second-order terms; B and C contain these in full. One visual reference removes them
across its heading, two references 60 to 120 degrees apart or speeds on opposite courses entirely.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from compasslib import angles
from compasslib.calibrations.result import LETTERS, DeviationTable
from compasslib.deviation.series import series_design, series_deviation
from compasslib.statistics.resampling import NORMAL_95
from compasslib.types import Floats

POINTS = ("N", "NE", "E", "SE", "S", "SW", "W", "NW")
LIMIT_DEG = 4.0  # ISO 25862:2019, Annex G.1; MM section 7.3
LONGEST_M = 82.5  # ships to which the limit applies
LEAST_KN = 7.0  # of a swing, MM section 7.3
LIE = {"B": "longitudinal", "C": "transversal"}  # orientation of the magnets
# By cardinal course: heading, coefficient that magnets change, its sign in the deviation, and that of E; MM (2) to (5).
CARDINAL = {
    "N": (0.0, "C", 1.0, 1.0),
    "E": (90.0, "B", 1.0, -1.0),
    "S": (180.0, "C", -1.0, 1.0),
    "W": (270.0, "B", -1.0, -1.0),
}


def mean_by_point(values: ArrayLike, course_deg: ArrayLike, recorded_deg: ArrayLike) -> dict[str, float]:
    """Average values on each of the eight points, by course or compass, whichever lies closer; NaN where absent."""
    headings = np.asarray(course_deg), np.asarray(recorded_deg)
    steered = min(headings, key=lambda x: angles.rms(x - 45.0 * np.rint(x / 45.0)))
    nearest, values = np.rint(steered / 45.0).astype(int) % len(POINTS), np.asarray(values, dtype=float)
    on_point = {point: values[nearest == k] for k, point in enumerate(POINTS)}
    return {point: float(np.mean(on)) if len(on) else float("nan") for point, on in on_point.items()}


def pseudo_deviations(course_deg: ArrayLike, recorded_deg: ArrayLike) -> dict[str, float]:
    """Average course minus compass on each of the eight points, NaN where none was steered."""
    return mean_by_point(angles.difference(course_deg, recorded_deg), course_deg, recorded_deg)


def principal_coefficients(psi: Mapping[str, float], declination_deg: float) -> dict[str, Any]:
    """Compute A, B bar, C bar, D and E from pseudo-deviations, MM (39), (44) to (50); NaN where a course is missing.

    D is the mean over the steered quadrants, which is (47) for all four. MM print 0.707 for the sine of 45 degrees.
    """
    n, ne, e, se, s, sw, w, nw = (psi[point] for point in POINTS)
    a_bar, b_bar, c_bar = (n + e + s + w) / 4.0, (e - w) / 2.0, (n - s) / 2.0
    along, across = 0.707 * (b_bar + c_bar), 0.707 * (b_bar - c_bar)
    quadrants = {"NE": ne - a_bar - along, "SE": a_bar + across - se}
    quadrants |= {"SW": sw - a_bar + along, "NW": a_bar - across - nw}
    steered = [d for d in quadrants.values() if np.isfinite(d)]
    return {
        "A_bar": a_bar,
        "A": a_bar - declination_deg,
        "B_bar": b_bar,
        "C_bar": c_bar,
        "D": float(np.mean(steered)) if steered else float("nan"),
        "E": (n + s - e - w) / 4.0,
        "D_from": quadrants,
    }


def error_bound_deg(ratio: float) -> float:
    """Bound the error of D and E for a ratio of drift to ship's speed, MM (37), (43) and Table 1."""
    return 0.5 / angles.DEGREE * ratio**2


def set_and_drift_terms(ratio: float, set_deg: float) -> dict[str, float]:
    """Compute the corrections of the coefficients for set and drift, MM (22), (37) and (43).

    B = B bar + x, C = C bar - y, E = E bar + xy, D = D bar - (x2 - y2)/2. The ratio is that of drift to the ship's
    speed; the set is the magnetic direction towards which the water flows.
    """
    (sine, cosine), (sine2, cosine2) = angles.sin_cos(set_deg), angles.sin_cos(2.0 * set_deg)
    first, second = ratio / angles.DEGREE, error_bound_deg(ratio)
    terms = {"x": first * cosine, "y": first * sine, "E": second * sine2, "D": second * cosine2}
    return {name: float(value) for name, value in terms.items()}


def residual_b_and_c(
    principal: Mapping[str, Any],
    marks: Sequence[tuple[float, float]],  # recorded heading and deviation
    drift_ratio: float,  # largest; 0 where courses are not over ground
    speed_kn: Mapping[str, float] | None,  # over ground, by point
) -> dict[str, Any]:
    """Correct B bar and C bar for the water by one mark, by two and by the speeds on opposite courses, where given."""
    residual: dict[str, Any] = {}
    if not np.isfinite([principal[k] for k in ("A", "D", "E", "B_bar", "C_bar")]).all():
        return residual
    bars = principal["B_bar"], principal["C_bar"]
    if marks:
        residual["one_heading"] = residual_by_lushnikov(principal, bars, *marks[0])
    if len(marks) > 1:
        residual["two_headings"] = residual_from_two_headings(principal, marks[0], marks[1])
    if marks and drift_ratio and "B" not in residual.get("two_headings", {}):
        residual["one_heading"]["drift"] = drift_in_one_heading(drift_ratio, sum(marks[0]))
    n, e, s, w = (speed_kn[point] if speed_kn else np.nan for point in "NESW")
    if np.isfinite([n, e, s, w]).all():
        x, y = (n - s) / (n + s) / angles.DEGREE, (e - w) / (e + w) / angles.DEGREE  # MM (22)
        residual["opposite_courses"] = {"B": bars[0] + x, "C": bars[1] - y}
    return residual


def residual_from_two_headings(
    known: Mapping[str, float], first: tuple[float, float], second: tuple[float, float]
) -> dict[str, Any]:
    """Solve for residual B and C from known A, D, E and (course, deviation) on two headings (MM section 6)."""
    apart = abs(float(angles.difference(first[0], second[0])))
    if not 60.0 <= apart <= 120.0:
        return {"why": f"the two headings are {apart:.0f} degrees apart, 60 to 120 are needed: steer for another mark"}
    eta1, eta2 = (_semicircular_part(known, *each) for each in (first, second))
    (sine1, cosine1), (sine2, cosine2) = np.array([angles.sin_cos(each[0]) for each in (first, second)])
    across = float(angles.sin_cos(first[0] - second[0])[0])
    return {"B": (eta1 * cosine2 - eta2 * cosine1) / across, "C": (eta2 * sine1 - eta1 * sine2) / across}


def residual_by_lushnikov(
    known: Mapping[str, float], bars: tuple[float, float], compass_deg: float, deviation_deg: float
) -> dict[str, Any]:
    """Compute residual B and C from A, D, E, (B bar, C bar) and one visual reference, MM (54) to (60)."""
    sine, cosine = (float(x) for x in angles.sin_cos(compass_deg + deviation_deg))
    across = _semicircular_part(known, compass_deg + deviation_deg, deviation_deg)
    along = bars[0] * cosine - bars[1] * sine
    return {"B": across * sine + along * cosine, "C": across * cosine - along * sine}


def _semicircular_part(known: Mapping[str, float], course_deg: float, deviation_deg: float) -> float:
    sine2, cosine2 = angles.sin_cos(2.0 * course_deg)
    return deviation_deg - known["A"] - known["D"] * float(sine2) - known["E"] * float(cosine2)


def drift_in_one_heading(ratio: float, heading_deg: float) -> dict[str, Any]:
    """Describe the error of Lushnikov's B and C due to an unknown drift of at most ``ratio``, which MM do not mention.

    Step (60) takes the component along the heading from B bar and C bar: the error of (B, C) is
    -57.3 (d/S) cos(set - heading) along (cos heading, -sin heading), so the deviation errs most 90 degrees off it.
    """
    sine, cosine = (float(x) for x in angles.sin_cos(heading_deg))
    largest, worst = ratio / angles.DEGREE, angles.wrap360([heading_deg + 90.0, heading_deg - 90.0])
    text = (
        f"B and C by one mark hold the drift of the water: up to {largest:.1f}° ({largest / 2.0:.1f}° standard) along "
        f"({cosine:+.2f} B, {-sine:+.2f} C). It errs the deviation most on {worst[0]:03.0f}° and {worst[1]:03.0f}° and "
        f"not on {angles.wrap360(heading_deg):03.0f}°. Head for a second mark 60 to 120° away, or log the speed over "
        "ground on opposite courses at one engine speed"
    )
    return {"largest_deg": largest, "text": text}


def directive_force(coefficients: Floats, heading_deg: Floats) -> Floats:
    """Compute the relative directive force, H' cos(deviation) over lambda H, by magnetic heading, MM (53)."""
    (sine, cosine), (sine2, cosine2) = angles.sin_cos(heading_deg), angles.sin_cos(2.0 * heading_deg)
    _, b, c, d, e = coefficients * angles.DEGREE
    return 1.0 + b * cosine - c * sine + d * cosine2 - e * sine2


def deviation_table(coefficients: Floats, covariance: Floats, step_deg: float) -> DeviationTable:
    """Tabulate the deviation of A..E (5,) and its sigma by recorded heading, north first."""
    heading = np.arange(0.0, 360.0 - 1e-9, step_deg)
    columns = series_design(heading)
    sigma = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", columns, covariance, columns), 0.0))
    return DeviationTable(heading, columns @ coefficients, sigma)


def verdict(table: DeviationTable, length_m: float | None, speed_kn: float | None) -> dict[str, Any]:
    """Assess whether deviations stay within 4 degrees (ISO 25862:2019, Annex G.1), and list conditions not verified."""
    size, half = np.abs(table.deviation_deg), NORMAL_95 * table.sigma_deg
    worst = int(np.argmax(size))
    value, on = float(table.deviation_deg[worst]), float(table.heading_deg[worst])
    largest = f"largest {value:+.1f}° ± {half[worst]:.1f}° (95 %)"
    if length_m is not None and length_m >= LONGEST_M:
        word, text = "not judged", f"The limit of 4° is for ships under 82.5 m; this one has {length_m} m. {largest}."
    elif (size - half > LIMIT_DEG).any():
        word, text = "exceeds", f"A deviation exceeds 4°: {largest} on {on:03.0f}°."
    elif (size + half > LIMIT_DEG).any():
        word, text = "undecided", f"Whether every deviation is within 4° is not decided: {largest}."
    else:
        word, text = "within", f"Every deviation is within 4°: {largest}."
    conditions = []
    if length_m is None:
        conditions.append("The length of the ship is not given; the limit of 4° is for ships under 82.5 m.")
    if speed_kn is None:
        conditions.append("The speed is not known; the method asks for at least 7 kn.")
    elif speed_kn < LEAST_KN:
        conditions.append(f"The swing was made at {speed_kn:.1f} kn; the method asks for at least 7 kn.")
    return {"verdict": word, "largest_deg": value, "on_deg": on, "conditions": conditions, "text": text}


def plan_magnets(coefficients: Floats, heading_deg: Floats) -> dict[str, Any]:
    """Plan magnets for B and C, with the largest deviation that each choice leaves (MM section 7.2, points 8 and 9)."""
    largest = {}
    for choice, letters in {"none": "", "B": "B", "C": "C", "both": "BC"}.items():
        remaining = series_deviation(coefficients * [letter not in letters for letter in LETTERS], heading_deg)
        largest[choice] = float(np.max(np.abs(remaining)))
    b, c = coefficients[1:3].tolist()
    first, falls = "B" if abs(b) >= abs(c) else "C", f"the largest deviation falls from {largest['none']:.1f}°"
    if largest["none"] <= LIMIT_DEG:
        text = f"No deviation exceeds 4° (largest {largest['none']:.1f}°); nothing need be nullified."
    elif largest[first] <= LIMIT_DEG:
        text = f"Nullify {first}: {falls} to {largest[first]:.1f}°."
    elif largest["both"] <= LIMIT_DEG:
        text = f"Nullify B and C: {falls} to {largest['both']:.1f}°."
    else:
        text = (
            f"With B and C nullified {largest['both']:.1f}° remain, more than 4°: soft iron near the compass; "
            "only another place for the compass, or soft-iron correctors, take it away."
        )
    magnets = {letter: {"text": nullifying(letter, value)} for letter, value in (("B", b), ("C", c))}
    return {"magnets": magnets, "largest_deg": largest, "text": text}


def nullifying(letter: str, value_deg: float) -> str:
    """Describe how to nullify B or C (MM section 7.2, point 7).

    A positive B is a field towards the bow. Above or beside the middle of a magnet, its field opposes the direction
    of the red end: red ends forward cancel B, to starboard a positive C (Handbook of Magnetic Compass Adjustment).
    """
    if letter == "B":
        courses, settle, ends = (90.0 - value_deg, 270.0 + value_deg), (90.0, 270.0), ("forward", "aft")
    else:
        courses, settle, ends = (-value_deg, 180.0 + value_deg), (0.0, 180.0), ("to starboard", "to port")
    red, (first, second) = ends[value_deg <= 0], angles.wrap360(courses)
    return (
        f"To nullify {letter} ({value_deg:+.1f}°): steer {first:05.1f}° (or {second:05.1f}°) by compass, read the "
        f"course over ground, keep it by the receiver, and turn the {LIE[letter]} magnets, red ends {red}, until the "
        f"compass shows {settle[0]:03.0f}° (or {settle[1]:03.0f}°)."
    )


def adjust(
    coefficients: Floats, first: tuple[str, str] = ("E", "N"), water_deg: tuple[float, float] = (0.0, 0.0)
) -> list[dict[str, Any]]:
    """Simulate the adjustment: nullify on two cardinal courses, halve on their opposites, MM (6) to (34)."""
    letters = dict(zip(LETTERS, (float(k) for k in coefficients), strict=True))
    drift = {"B": -water_deg[0], "C": water_deg[1]}  # in the pseudo-deviation, MM (23) to (26), first order
    opposite, steps = dict(zip("NESW", "SWNE", strict=True)), []
    for course, share in [(c, 1.0) for c in first] + [(opposite[c], 0.5) for c in first]:
        heading, letter, sign, of_e = CARDINAL[course]
        before = letters["A"] + sign * (letters[letter] + drift[letter]) + of_e * letters["E"]
        letters[letter] -= sign * share * before
        shown = float(angles.wrap360(heading - before + share * before))
        what = "nullify it" if share == 1.0 else "take half of it away"
        text = (
            f"On {course} the compass is off by {before:+.1f}°; {what}: turn the {LIE[letter]} magnets until it "
            f"shows {shown:05.1f}°."
        )
        step = {"course": course, "magnets": LIE[letter], "before_deg": before, "after_deg": (1.0 - share) * before}
        steps.append(step | {"B": letters["B"], "C": letters["C"], "shows_deg": shown, "text": text})
    return steps
