"""What the search for unmodelled effects found, of a mooring and of a calibration: where the residual shows it.

The residual is drawn along what drives it, before and after, with the curve of what was found between the two; then
what the same does on days that were not fitted, and for a calibration how well each effect does alone.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import NormalDist
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, MaxNLocator

from compasslib.core.types import Floats
from compasslib.plots.page import BLACK, CORRECTED, GREY, RECORDED, VERMILION, dates, degrees, empty, legend, page
from compasslib.search.wording import TURN, UNITS, UNITS_OF_CALIBRATIONS, plain, residuals

HOUR_S = 3600.0
MOST_PANELS, MOST_BARS = 6, 10
PANEL_IN, BAR_IN = 1.7, 0.17
NAMES = {
    "heading": "Recorded heading", "time": "", "separation": "Distance of the two layers",
    "speed": "Speed of the upper water", "hour_of_day": "Hour of the day, UTC",
}  # fmt: skip
NAMES_OF_CALIBRATIONS = {
    "heading": "Heading", "time": "Time since the begin (h)", "reading": "Number of the reading",
    "turn_rate": "Rate of turn",
}  # fmt: skip
BEFORE: dict[str, Any] = {"color": RECORDED, "marker": "o", "markersize": 3.0, "linestyle": ""}
AFTER: dict[str, Any] = {"color": CORRECTED, "marker": "s", "markersize": 3.0, "linestyle": ""}
EFFECT: dict[str, Any] = {"color": BLACK, "linewidth": 1.0}
BAND: dict[str, Any] = {"color": GREY, "alpha": 0.25, "linewidth": 0}


def of_mooring(path: str | Path, found: Mapping[str, Any]) -> None:
    """Draw a mooring's diagnosis.

    Args:
        found: content of diagnosis.json.
    """
    curves = residuals(found)[:MOST_PANELS]
    _draw(path, found, curves, (NAMES, UNITS), _simultaneous(sum(len(curve["centre"]) for curve in curves)))


def of_calibration(path: str | Path, found: Mapping[str, Any]) -> None:
    """Draw a calibration's diagnosis, and its hypotheses.

    Args:
        found: content of diagnosis.json.
    """
    curves = [_since_the_begin(curve) for curve in residuals(found)[:MOST_PANELS]]
    _draw(path, found, curves, (NAMES_OF_CALIBRATIONS, UNITS_OF_CALIBRATIONS), None)


def _draw(
    path: str | Path,
    found: Mapping[str, Any],
    curves: Sequence[Mapping[str, Any]],
    said: tuple[Mapping[str, str], Mapping[str, str]],
    reach: float | None,
) -> None:
    """Draw panel under panel.

    Args:
        said: names and units of the covariates.
        reach: of the band, standard errors; each curve's own where absent.
    """
    proven = [one for one in found["findings"] if one.get("heldout")]
    ranked = found.get("hypotheses", [])[:MOST_BARS] if reach is None else []
    heights = [PANEL_IN] * len(curves) + [0.5 + BAR_IN * len(rows) for rows in (proven, ranked) if rows]
    with page(path, sum(heights or [1.0]) + 0.4) as figure:
        panels = list(figure.subplots(max(len(heights), 1), 1, height_ratios=heights or None, squeeze=False)[:, 0])
        if not heights:
            empty(panels[0])
        for curve in curves:
            _residual(panels.pop(0), curve, _label(curve["covariate"], *said), reach)
        if proven:
            _held_out(panels.pop(0), proven)
        if ranked:
            _ranking(panels.pop(0), ranked, [one["effect"] for one in found["findings"]])
        legend(figure, _handles(found["findings"]) if curves or proven else [])


def _since_the_begin(curve: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return a curve whose times are hours since the first."""
    if curve["covariate"] != "time":
        return curve
    return {**curve, "centre": [(time - curve["centre"][0]) / HOUR_S for time in curve["centre"]]}


def _residual(axes: Axes, curve: Mapping[str, Any], label: str, reach: float | None) -> None:
    """Draw the binned residual before and after, what was found between them, and what noise alone may leave."""
    x, before, after, sigma = _columns(curve)
    covariate = curve["covariate"]
    if covariate == "time" and reach is not None:
        dates(axes, (x[0], x[-1]))
        x = x / 86400.0
    half = (reach or _simultaneous(len(x))) * sigma
    axes.fill_between(x, -half, half, **BAND)
    axes.axhline(0.0, color=GREY, linewidth=0.6)
    if np.any(before != after):
        axes.plot(x, x if covariate.startswith(TURN) else before - after, **EFFECT)
        axes.plot(x, before, **BEFORE)
    axes.plot(x, after, **AFTER)
    axes.set_ylabel("Residual (°)")
    axes.set_title(curve.get("compared", ""))
    if label:
        axes.set_xlabel(label)
    if covariate == "heading":
        degrees(axes.xaxis, (0.0, 360.0))


def _columns(curve: Mapping[str, Any]) -> tuple[Floats, ...]:
    return tuple(np.array(curve[key], dtype=float) for key in ("centre", "before_deg", "after_deg", "sigma_deg"))


def _label(covariate: str, names: Mapping[str, str], units: Mapping[str, str]) -> str:
    """Return what an axis is called: the covariate's name, and the unit that the sentences have, abbreviated."""
    if covariate.startswith(TURN):
        return f"Turn by {plain(covariate.removeprefix(TURN))} (°)"
    name = names.get(covariate, covariate.replace("_", " ").capitalize())
    unit = units.get(covariate, "").replace("degrees C", "°C").replace("degrees", "°")
    return f"{name} ({unit})" if unit else name


def _simultaneous(bins: int) -> float:
    """Return how many standard errors a band reaches that all bins of noise stay within, 95 times in 100 (Šidák)."""
    return NormalDist().inv_cdf(0.5 + 0.5 * 0.95 ** (1.0 / max(bins, 1)))


def _held_out(axes: Axes, findings: Sequence[Mapping[str, Any]]) -> None:
    """Draw the residual on days that were not fitted, without and with each finding."""
    place = np.arange(len(findings))[::-1]
    before, after = ([one["heldout"][f"rms_{key}_deg"] for one in findings] for key in ("before", "after"))
    axes.hlines(place, before, after, color=BLACK, linewidth=1.0)
    axes.plot(before, place, **BEFORE)
    axes.plot(after, place, **AFTER)
    axes.set_yticks(place, [_short(one) for one in findings])
    axes.set(ylim=(-0.7, len(findings) - 0.3), xlabel="Rms residual on held-out days (°)")
    axes.xaxis.set_major_locator(MaxNLocator(4))
    axes.margins(x=0.15)


def _short(finding: Mapping[str, Any]) -> str:
    """Return a finding's name in two short lines."""
    if composed := finding.get("composition"):
        return f"composed,\nby {composed['driver'].replace('_', ' ')}"
    return "\n".join(textwrap.wrap(plain(finding["effect"]), 14))


def _ranking(axes: Axes, ranked: Sequence[Mapping[str, Any]], named: Sequence[str]) -> None:
    """Draw how well each effect does alone; those that were named in the end stand out."""
    place = np.arange(len(ranked))[::-1]
    colours = [VERMILION if one["effect"] in named else GREY for one in ranked]
    axes.barh(place, [max(one["score"], 0.0) for one in ranked], color=colours, height=0.7)
    axes.set_xscale("symlog", linthresh=10.0)
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    axes.set_yticks(place, [plain(one["effect"]) for one in ranked])
    axes.set_xlabel("Log evidence alone")
    axes.set_xlim(0.0, max(10.0, 1.1 * max(one["score"] for one in ranked)))


def _handles(findings: Sequence[Mapping[str, Any]]) -> list[Any]:
    band = Patch(**BAND, label="noise alone, 95 %")
    if not any(one["effect"] != "large_deviation" for one in findings):
        return [Line2D([], [], **AFTER, label="residual of the fit"), band]
    return [
        Line2D([], [], **BEFORE, label="fit alone"),
        Line2D([], [], **AFTER, label="with what was found"),
        Line2D([], [], **EFFECT, label="what was found"),
        band,
    ]
