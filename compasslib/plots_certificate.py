"""The writing of a certificate: what was calibrated where, coefficients, budget, and the table for the bridge."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from compasslib.archive_calibrations import Page
from compasslib.calibration.result import LETTERS

HEIGHT_IN = 9.6
LINE = 0.0195  # of the panel's height
LINE_CHARACTERS = 118
TABLE_COLUMNS = 3
UNKNOWN = "–"


def write(axes: Axes, shown: Page) -> None:
    """Write the certificate's text into an empty panel.

    Args:
        axes: the panel.
        shown: the calibration.
    """
    axes.set_axis_off()
    content = shown.content
    left = [*_about(content), "", *_coefficients(content)]
    _put(axes, 0.0, 1.0, left)
    _put(axes, 0.52, 1.0, _budget(content))
    top = 1.0 - LINE * (max(len(left), len(_budget(content))) + 2)
    lines = _table(shown)
    _put(axes, 0.0, top, lines)
    said = ([f"No curve: {content['why']}."] if content["why"] else []) + [
        f"Note: {text}." for text in content["warnings"]
    ]
    said += [
        extra["text"]
        for extra in (content.get("constant_shift"), content.get("comparison"))
        if extra and extra.get("text")
    ]
    wrapped = [line for text in said for line in textwrap.wrap(text, LINE_CHARACTERS)]
    _put(axes, 0.0, top - LINE * (len(lines) + 1), wrapped, mono=False)


def _put(axes: Axes, x: float, y: float, lines: list[str], *, mono: bool = True) -> None:
    family = "monospace" if mono else "sans-serif"
    axes.text(x, y, "\n".join(lines), transform=axes.transAxes, va="top", family=family, fontsize=7.0, linespacing=1.35)


def _about(content: Mapping[str, Any]) -> list[str]:
    place, field = content["place"], content.get("field") or content["place"]["field"]
    where = UNKNOWN if place["latitude"] is None else f"{place['latitude']:.4f} N, {place['longitude']:.4f} E"
    strength = UNKNOWN if field is None else f"H {field['horizontal_nT']:.0f} nT, Z {field['vertical_nT']:.0f} nT"
    return [
        f"date        {place['date'] or UNKNOWN}",
        f"place       {where}",
        f"field       {strength}",
        f"readings    {content['n']} in {content['coverage']} of 36 sectors",
        f"model       {content['model']}",
        f"residual    {_number(content['residual_rms_deg'], '.2f')}° rms",
    ]


def _coefficients(content: Mapping[str, Any]) -> list[str]:
    letters = content["coefficients"]
    if not letters:
        return ["coefficients: none"]
    sigma = np.sqrt(np.diag(np.array(content["covariance"], dtype=float)))
    rows = [
        f"    {k}   {_number(letters[k], '+7.2f')}°  ± {_number(s, '.2f')}°"
        for k, s in zip(LETTERS, sigma, strict=True)
    ]
    return ["series in the recorded heading, ± standard", *rows]


def _budget(content: Mapping[str, Any]) -> list[str]:
    uncertainty = content["uncertainty"]
    rows = [
        f"  {name.removesuffix('_deg'):<18}{row['standard_deg']:6.2f}°" for name, row in uncertainty["rows"].items()
    ]
    ends = (("combined", "standard_deg"), ("expanded (k = 2)", "expanded_deg"))
    totals = [f"  {name:<18}{_number(uncertainty[key], '6.2f')}°" for name, key in ends]
    return ["standard uncertainties", *rows, "", *totals]


def _table(shown: Page) -> list[str]:
    table = shown.table
    if not table.heading_deg.size:
        return []
    rows = [
        f"{h:5.0f}°{_number(d, '+8.2f'):>8}°{_number(s, '6.2f'):>6}°"
        for h, d, s in zip(table.heading_deg, table.deviation_deg, table.sigma_deg, strict=True)
    ]
    high = -(-len(rows) // TABLE_COLUMNS)
    head = "  ".join([" head.   dev.   unc. "] * TABLE_COLUMNS)
    return [head, *("    ".join(rows[k::high]) for k in range(high))]


def _number(value: float | None, form: str) -> str:
    return UNKNOWN if value is None or not np.isfinite(value) else format(value, form)
