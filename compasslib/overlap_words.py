"""What pairs give away of a mistake: one record twice, speeds of another unit, no pair at all and why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.errors import InputError
from compasslib.records import PROBABLY_GOOD, Pairs, Record

Floats = NDArray[np.floating]
Bools = NDArray[np.bool_]

MOST_IDENTICAL, ENOUGH = 0.5, 30  # share and number of pairs with equal speeds beyond which two instruments are one
EQUAL_M_S = 1e-6  # single precision's last digit of a slow current
SPEEDS_APART = 5.0  # ratio of median speeds beyond that of any two depths 20 m apart
SLOWEST = 0.25  # of the pairs, whose directions are left out
CLEARER = 1.8  # times less spread than the directions as told, than the flow and than the headings themselves
# Signs of the recorded direction and of the heading in a sum that would be constant.
OTHER_FRAMES = {
    (-1, 1): "turned back by the heading",
    (-1, -1): "turned by the heading",
    (1, -1): "mirrored and turned by the heading",
    (1, -2): "mirrored about the heading",
    (1, 0): "mirrored",
}
NOISE_M_S = 0.01  # below this a profiler's hourly velocity is noise


def checked(pairs: Pairs, upper: Record, trusted: Sequence[Record]) -> Pairs:
    """Return pairs with sentences on what is wrong with them; none of them where both records are the same.

    Args:
        pairs: overlapping measurements.
        upper: the compromised instrument inside the deployment.
        trusted: the trusted one, or nothing.

    Raises:
        InputError: both carry one serial number, or the velocities of one are in another frame than told.
    """
    _refuse_one_instrument(upper, trusted)
    if not len(pairs):
        return replace(pairs, warnings=tuple(_absent(upper, trusted)))
    _refuse_other_frame(pairs)
    speeds = [np.median(np.hypot(e, n)) for e, n in _velocities(pairs)]
    notes = []
    if not 1.0 / SPEEDS_APART < speeds[0] / speeds[1] < SPEEDS_APART:
        notes.append(
            f"median speeds of the pairs are {speeds[0]:.3g} and {speeds[1]:.3g} m/s: check the unit and scale of both"
        )
    if min(speeds) < NOISE_M_S:
        notes.append(f"half of the pairs are slower than {min(speeds):.2g} m/s: their directions are noise")
    return replace(pairs, warnings=pairs.warnings + tuple(notes))


def _refuse_other_frame(pairs: Pairs) -> None:
    """Refuse directions that agree with the trusted ones only when the heading is added, taken away or mirrored.

    No iron does that: a compass that goes round shows its deviation about the true heading. Where the water runs one
    way, or the compass hardly turns, nothing can be told.
    """
    slower = np.min([np.hypot(east, north) for east, north in _velocities(pairs)], axis=0)
    fast = slower >= np.quantile(slower, SLOWEST)
    upper, lower = (angles.direction(east, north)[fast] for east, north in _velocities(pairs))
    heading = pairs.heading_deg[fast]
    plain = min(_spread(lower - upper), _spread(lower), _spread(heading))
    others = {(sign, k): _spread(lower + sign * upper + k * heading) for sign, k in OTHER_FRAMES}
    best = min(others, key=lambda which: others[which])
    if len(heading) >= ENOUGH and others[best] * CLEARER < plain:
        found = f"directions that agree with the trusted ones only where they are {OTHER_FRAMES[best]}"
        advice = "check coordinates (EX), orientation, and east and north of both instruments"
        raise InputError("compromised instrument", expected="velocities as told", found=found, advice=advice)


def _spread(angle_deg: Floats) -> float:
    """Return the standard deviation of angles that lie about one direction normally, radians."""
    length = min(max(float(angles.resultant_length(angle_deg)), 1e-12), 1.0)
    return float(np.sqrt(-2.0 * np.log(length)))


def _refuse_one_instrument(upper: Record, trusted: Sequence[Record]) -> None:
    if any(upper.serial_number and upper.serial_number == each.serial_number for each in trusted):
        expected, found = "two instruments", f"serial number {upper.serial_number} in the files of both"
        raise InputError("compromised and reference", expected=expected, found=found, advice="correct files of one")


def identical(pairs: Pairs) -> str:
    """Return why the two instruments of pairs are one, nothing where their velocities are not the same.

    Args:
        pairs: overlapping measurements.
    """
    upper, lower = (np.hypot(east, north) for east, north in _velocities(pairs))
    if len(pairs) < ENOUGH or np.ptp(upper) == 0.0:
        return ""
    if float(np.mean(np.abs(upper - lower) < EQUAL_M_S)) <= MOST_IDENTICAL:
        return ""
    return "the two instruments recorded the same velocities: one recording was given twice, and no pair counts"


def _velocities(pairs: Pairs) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats]]:
    return (pairs.upper_east, pairs.upper_north), (pairs.lower_east, pairs.lower_north)


def _absent(upper: Record, trusted: Sequence[Record]) -> list[str]:
    """Say why there is no pair."""
    if not trusted:
        return []
    reasons = [
        f"the {name} instrument {why}"
        for name, why in zip(
            ("compromised", "trusted"),
            (_unusable(upper, heading=True), _unusable(trusted[0], heading=False)),
            strict=True,
        )
        if why
    ]
    if reasons:
        return reasons
    if upper.time_s[0] > trusted[0].time_s[-1] or trusted[0].time_s[0] > upper.time_s[-1]:
        return ["the two records do not overlap in time"]
    depths = [float(np.nanmedian(record.depth_m)) for record in (upper, trusted[0])]
    return [
        f"no two velocities are near enough in time and depth (instruments at {depths[0]:.0f} and {depths[1]:.0f} m)"
    ]


def _unusable(record: Record, *, heading: bool) -> str:
    if not len(record.time_s):
        return "has no sample inside the deployment"
    if not ((record.quality <= PROBABLY_GOOD) & np.isfinite(record.east + record.north)).any():
        return "has no usable velocity"
    if not (np.nan_to_num(record.east).any() or np.nan_to_num(record.north).any()):
        return "has velocities of zero only"
    if heading and not (np.isfinite(record.heading_deg) & (record.heading_quality <= PROBABLY_GOOD)).any():
        return "has no usable heading: is it the one with the compass to correct?"
    if not np.isfinite(record.depth_m).any():
        return "has no depth"
    return ""
