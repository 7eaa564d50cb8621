"""The writing of a certificate: what was calibrated where, coefficients, budget, and the table for the bridge."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from compasslib import angles
from compasslib.archive_calibrations import Page
from compasslib.calibration.result import LETTERS

LINE_IN = 0.131  # of a line of this writing
CURVE_IN, LEGEND_IN = 3.1, 0.7
LINE_CHARACTERS = 118
MODEL_CHARACTERS = 40
TABLE_COLUMNS = 3
UNKNOWN, SPACE = "–", " " * 8


@dataclass(frozen=True)
class Writing:
    """What a certificate says below its curve, in lines."""

    about: list[str]
    budget: list[str]
    table: list[str]
    notes: list[str]

    @property
    def height_in(self) -> float:
        """Return the height that it takes, inches."""
        return LINE_IN * (self.beside + len(self.table) + len(self.notes) + 4)

    @property
    def beside(self) -> int:
        """Return the lines of the part that stands in two columns."""
        return max(len(self.about), len(self.budget))


def writing(shown: Page) -> Writing:
    """Return what a certificate says.

    Args:
        shown: the calibration.
    """
    content = shown.content
    return Writing([*_about(content), "", *_coefficients(content)], _budget(content), _table(shown), _notes(content))


def write(axes: Axes, text: Writing) -> None:
    """Write a certificate's text into an empty panel of its height.

    Args:
        axes: the panel.
        text: what it says.
    """
    axes.set_axis_off()
    _put(axes, (0.0, 0), text.about)
    _put(axes, (0.52, 0), text.budget)
    _put(axes, (0.0, text.beside + 1), text.table)
    _put(axes, (0.0, text.beside + len(text.table) + 2), text.notes, mono=False)


def _put(axes: Axes, place: tuple[float, int], lines: list[str], *, mono: bool = True) -> None:
    """Write lines from a share of the width on, so many lines below the top."""
    across, down = place
    axes.annotate(
        "\n".join(lines),
        (across, 1.0),
        (0.0, -72.0 * LINE_IN * down),
        xycoords="axes fraction",
        textcoords="offset points",
        va="top",
        family="monospace" if mono else "sans-serif",
        fontsize=7.0,
        linespacing=1.35,
        annotation_clip=False,
    )


def _notes(content: Mapping[str, Any]) -> list[str]:
    extras = [content.get("constant_shift"), content.get("comparison")]
    said = [f"No curve: {sentence(content['why'])}"] if content["why"] else []
    said += [f"Note: {sentence(text)}" for text in content["warnings"]]
    said += [extra["text"] for extra in extras if extra and extra.get("text")]
    return [line for text in said for line in textwrap.wrap(text, LINE_CHARACTERS)]


def sentence(text: str) -> str:
    """Return a text with its full stop, whether or not it brings one.

    Args:
        text: a warning or a reason.
    """
    return text.rstrip(".") + "."


def _about(content: Mapping[str, Any]) -> list[str]:
    place, field = content["place"], content["place"]["field"]
    where = UNKNOWN if place["latitude"] is None else _position(place["latitude"], place["longitude"])
    strength = UNKNOWN if field is None else f"H {field['horizontal_nT']:.0f} nT, Z {field['vertical_nT']:.0f} nT"
    return [
        f"date        {place['date'] or UNKNOWN}",
        f"place       {where}",
        f"field       {strength}",
        f"readings    {content['n']} in {content['coverage']} of 36 sectors",
        f"model       {textwrap.shorten(content['model'], MODEL_CHARACTERS, placeholder=' …')}",
        f"residual    {_number(content['residual_rms_deg'], '.2f')}° rms",
    ]


def _position(latitude: float, longitude: float) -> str:
    east = float(angles.wrap180(longitude))
    north_south, east_west = ("N" if latitude >= 0 else "S"), ("E" if east >= 0 else "W")
    return f"{abs(latitude):.4f}° {north_south}, {abs(east):.4f}° {east_west}"


def _coefficients(content: Mapping[str, Any]) -> list[str]:
    letters = content["coefficients"]
    if not letters:
        return _exact(content["exact"])
    sigma = np.sqrt(np.diag(np.array(content["covariance"], dtype=float)))
    rows = [
        f"    {k}   {_number(letters[k], '+7.2f')}°  ± {_number(s, '.2f')}°"
        for k, s in zip(LETTERS, sigma, strict=True)
    ]
    return ["series in the recorded heading, ± standard", *rows]


def _exact(exact: Mapping[str, Any] | None) -> list[str]:
    if not exact:
        return ["coefficients: none"]
    sigma = np.sqrt(np.diag(np.array(exact["covariance"], dtype=float)))
    letters = exact["coefficients"]
    rows = [f"    {k}   {letters[k]:+8.4f}  ± {s:.4f}" for k, s in zip(LETTERS, sigma, strict=True)]
    return ["exact compass, ± standard", *rows]


def _budget(content: Mapping[str, Any]) -> list[str]:
    uncertainty = content["uncertainty"]
    rows = [
        f"  {name.removesuffix('_deg').replace('_', ' '):<18}{row['standard_deg']:6.2f}°"
        for name, row in uncertainty["rows"].items()
    ]
    ends = (("combined", "standard_deg"), ("expanded (k = 2)", "expanded_deg"))
    totals = [f"  {name:<18}{_number(uncertainty[key], '6.2f')}°" for name, key in ends]
    return ["standard uncertainties", *rows, "", *totals]


def _table(shown: Page) -> list[str]:
    table = shown.table
    if not np.isfinite(table.deviation_deg).any():
        return ["table of deviations: none"]
    rows = [
        f"{h:5.0f}° {_number(d, '+.2f'):>7}° {_number(s, '.2f'):>6}°"
        for h, d, s in zip(table.heading_deg, table.deviation_deg, table.sigma_deg, strict=True)
    ]
    high = -(-len(rows) // TABLE_COLUMNS)
    head = SPACE.join([f"{'head.':>6} {'dev.':>8} {'unc.':>7}"] * TABLE_COLUMNS)
    return [head, *(SPACE.join(rows[k::high]) for k in range(high))]


def _number(value: float | None, form: str) -> str:
    return UNKNOWN if value is None or not np.isfinite(value) else format(value, form)
