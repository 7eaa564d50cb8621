"""Layout of the map of moorings: positions and mean currents before and after, in coordinates for a template."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from compasslib import angles
from compasslib.report import words

WIDTH, HEIGHT, MARGIN = 360.0, 300.0, (76.0, 12.0, 12.0, 38.0)  # margins: left, right, top, bottom
LEAST_DEG = 0.02  # minimum extent in latitude and longitude
TICKS = 3  # approximate number along each axis
STEPS = (1.0, 2.0, 5.0, 10.0)
ARROW = 44.0  # length of the largest mean current
LETTER, LINE = 6.6, 12.0  # width of a letter and height of a line of a label
DOT, ALONG = 4.0, (0.4, 0.7, 1.0)  # half-width kept free about a point, and positions of such points along a line
LABEL_OFFSETS = ((7.0, 4.0, "start"), (-7.0, 4.0, "end"), (0.0, -8.0, "middle"), (0.0, 17.0, "middle"))
ANCHORS = {"start": 0.0, "end": 1.0, "middle": 0.5}
Box = tuple[float, float, float, float]


@dataclass(frozen=True)
class Station:
    """One mooring on the map."""

    name: str
    latitude: float
    longitude: float
    corrected: bool = False
    recorded_mean: complex = complex("nan")  # east + i north, m/s
    corrected_mean: complex = complex("nan")
    stopped: bool = False  # without results


@dataclass(frozen=True)
class Label:
    """A text at a point of the drawing."""

    x: float
    y: float
    text: str
    anchor: str = "middle"  # start | middle | end


@dataclass(frozen=True)
class Mark:
    """A mooring in the drawing: its point, its mean currents as lines from it, and its label if there is room."""

    x: float
    y: float
    station: Station
    tips: tuple[tuple[str, float, float], ...]  # recorded or corrected, and the end of its line
    label: Label | None = None


@dataclass(frozen=True)
class Chart:
    """Elements of the map."""

    box: Box  # x, y, width, height
    marks: Sequence[Mark]
    across: Sequence[Label]  # ticks
    up: Sequence[Label]
    said: str  # description of the map
    arrow: tuple[float, str] | None  # length and text of the scale; None if no current is drawn


def chart(stations: Sequence[Station]) -> Chart | None:
    """Lay out the map of the moorings, with longitude scaled by the cosine of latitude; None without moorings."""
    if not stations:
        return None
    left, right, top, bottom = MARGIN
    middle = float(angles.mean([item.longitude for item in stations]))
    east = [float(angles.difference(item.longitude, middle)) for item in stations]
    north = [item.latitude for item in stations]
    shrink = max(float(angles.sin_cos((min(north) + max(north)) / 2.0)[1]), 0.05)
    wide, high = (max(max(x) - min(x), LEAST_DEG) * 1.5 for x in (east, north))
    scale = min((WIDTH - left - right) / (wide * shrink), (HEIGHT - top - bottom) / high)
    box = (left, top, WIDTH - left - right, HEIGHT - top - bottom)
    centre = ((min(east) + max(east)) / 2.0, (min(north) + max(north)) / 2.0)

    def x_of(degrees: float) -> float:
        return round(box[0] + box[2] / 2.0 + (degrees - centre[0]) * shrink * scale, 1)

    def y_of(degrees: float) -> float:
        return round(box[1] + box[3] / 2.0 - (degrees - centre[1]) * scale, 1)

    speeds = [abs(mean) for each in stations for mean in (each.recorded_mean, each.corrected_mean)]
    fastest = max(filter(math.isfinite, speeds), default=0.0)
    unit = _below(100.0 * fastest) if fastest else 0.0  # cm/s
    marks = []
    for item, degrees_east in zip(stations, east, strict=True):
        x, y = x_of(degrees_east), y_of(item.latitude)
        tips = tuple(
            (kind, round(x + ARROW * mean.real / fastest, 1), round(y - ARROW * mean.imag / fastest, 1))
            for kind, mean in (("recorded", item.recorded_mean), ("corrected", item.corrected_mean))
            if math.isfinite(abs(mean)) and fastest
        )
        marks.append(Mark(x, y, item, tips))
    half = (box[2] / (2.0 * shrink * scale), box[3] / (2.0 * scale))
    across = _ticks(centre[0] + middle, half[0], lambda d: x_of(d - middle), ("E", "W"))
    up = _ticks(centre[1], half[1], y_of, ("N", "S"))
    return Chart(
        box=box,
        marks=_labelled(marks, box),
        across=[Label(at, box[1] + box[3] + 14.0, text) for at, text in across],
        up=[Label(box[0] - 5.0, at + 4.0, text, "end") for at, text in up],
        said=f"Map of {words.plural(len(stations), 'mooring')}, the mean current of one bin drawn before and after.",
        arrow=(round(ARROW * unit / (100.0 * fastest), 1), f"{unit:g}{words.SPACE}cm/s") if fastest else None,
    )


def _below(value: float) -> float:
    """Round down to 1, 2, 5, 10, ..."""
    power = 10.0 ** math.floor(math.log10(value))
    return max(step * power for step in STEPS if step * power <= value * (1.0 + 1e-9))


def _ticks(
    centre: float, half: float, place: Callable[[float], float], sides: tuple[str, str]
) -> list[tuple[float, str]]:
    """Compute positions and labels of ticks at round degrees along an axis."""
    step = _below(2.0 * half / TICKS * 1.5)
    digits = max(-math.floor(math.log10(step)), 0)
    first = math.ceil((centre - half) / step)
    count = math.floor((centre + half) / step) - first + 1
    degrees = [(first + k) * step for k in range(count)]
    shown = [(d, float(angles.wrap180(d)) if sides[0] == "E" else d) for d in degrees]
    return [(place(d), f"{abs(said):.{digits}f}° {sides[said < 0]}") for d, said in shown]


def _labelled(marks: Sequence[Mark], box: Box) -> list[Mark]:
    """Label each mooring where the label overlaps no other label, point, line or edge; otherwise leave it out."""
    points = [(item.x, item.y) for item in marks]
    points += [
        (item.x + share * (x - item.x), item.y + share * (y - item.y))
        for item in marks
        for _, x, y in item.tips
        for share in ALONG
    ]
    taken = [(x - DOT, y - DOT, x + DOT, y + DOT) for x, y in points]
    left, top, wide, high = box
    result = []
    for item in marks:
        label, others = None, np.array(taken)
        for dx, dy, anchor in LABEL_OFFSETS:
            tried = Label(item.x + dx, item.y + dy, item.station.name, anchor)
            x0, y0, x1, y1 = _around(tried)
            inside = x0 >= left and y0 >= top and x1 <= left + wide and y1 <= top + high
            hits = (others[:, 0] < x1) & (others[:, 2] > x0) & (others[:, 1] < y1) & (others[:, 3] > y0)
            if inside and not hits.any():
                label = tried
                taken.append((x0, y0, x1, y1))
                break
        result.append(replace(item, label=label))
    return result


def _around(label: Label) -> Box:
    left = label.x - ANCHORS[label.anchor] * LETTER * len(label.text)
    return left, label.y - LINE + 3.0, left + LETTER * len(label.text), label.y + 3.0
