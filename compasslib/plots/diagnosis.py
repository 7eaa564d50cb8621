"""Figures of a diagnosis: residuals by covariate, sizes of the effects on held-out days, heading errors."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import NormalDist
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from compasslib.inference import wording
from compasslib.plots import page
from compasslib.statistics.resampling import NORMAL_95
from compasslib.types import DAY_S, HOUR_S, Floats

NAMES = {
    "heading": "Recorded heading", "time": "", "separation": "Distance of the two layers",
    "speed": "Speed of the upper current", "hour_of_day": "Hour of the day, UTC",
    "reference_heading": "Heading of the reference instrument",
}  # fmt: skip
NAMES_OF_CALIBRATIONS = {
    "heading": "Heading", "time": "Time since the start (h)", "reading": "Number of the reading",
    "turn_rate": "Rate of turn",
}  # fmt: skip
BEFORE: dict[str, Any] = {"color": page.RECORDED, "marker": "o", "markersize": 3.0, "linestyle": ""}
AFTER: dict[str, Any] = {"color": page.CORRECTED, "marker": "s", "markersize": 3.0, "linestyle": ""}
EFFECT: dict[str, Any] = {"color": page.BLACK, "linewidth": 1.0}
DATE: dict[str, Any] = {"color": page.BLACK, "linestyle": ":", "linewidth": 1.0}
SIZES: tuple[tuple[dict[str, Any], str], ...] = (
    ({"color": page.BLACK, "marker": "|", "markersize": 7.0, "linestyle": ""}, "size on held-out days, 95 %"),
    ({"color": page.BLACK, "marker": "o", "markersize": 5.0, "mfc": "none", "linestyle": ""}, "as other days predict"),
    ({"color": page.VERMILION, "marker": "D", "markersize": 4.0, "linestyle": ""}, "heading error without it"),
)
NOISE: dict[str, Any] = {"color": page.GREY, "alpha": 0.25, "linewidth": 0}


def count_outside(diagnosis: Mapping[str, Any]) -> tuple[int, int, int]:
    """Count the bins that are drawn, and those outside the range of noise without and with the identified effects."""
    curves = _shown(diagnosis)
    bins = np.concatenate([np.stack(_columns(curve)[1:]) for curve in curves], axis=1)
    outside = np.abs(bins[:2]) > _band_sigmas(curves) * bins[2]
    return outside.shape[1], int(outside[0].sum()), int(outside[1].sum())


def _shown(diagnosis: Mapping[str, Any], most: int = 6) -> list[Mapping[str, Any]]:
    return wording.displayed_residuals(diagnosis)[:most]


def draw_diagnosis(path: str | Path, diagnosis: Mapping[str, Any], *, dated: bool) -> None:
    """Draw the content of diagnosis.json, of a mooring if it is ``dated``, else of a calibration, in hours."""
    said = (NAMES, wording.UNITS) if dated else (NAMES_OF_CALIBRATIONS, wording.UNITS_OF_CALIBRATIONS)
    curves = _shown(diagnosis)
    proven = [entry for entry in diagnosis["findings"] if entry.get("heldout")]
    short = page.Rows([_short(entry) for entry in proven])
    heights = [1.9] * len(curves) + [0.6 + short.height_in] * bool(proven)
    with page.create(path, sum(heights or [1.0]) + 0.4) as figure:
        panels = list(figure.subplots(max(len(heights), 1), 1, height_ratios=heights or None, squeeze=False)[:, 0])
        if not heights:
            page.empty(panels[0], words="no effect identified")
        marked: list[Line2D] = []
        for curve in curves:
            axes = panels.pop(0)
            _residual(axes, curve, _label(curve["covariate"], *said), _band_sigmas(curves), dated=dated)
            _follow(axes, curve, proven)
            if _along_time(curve) and dated:  # mark when effects begin or end within the record
                low, high = axes.get_xlim()
                texts = {(x.get("when") or {}).get(end) for x in diagnosis["findings"] for end in ("from", "to")}
                days = [np.datetime64(text.removesuffix("Z"), "s").astype(float) / DAY_S for text in texts if text]
                marked += [axes.axvline(day, **DATE) for day in days if 0.02 < (day - low) / (high - low) < 0.98]
        sized = [entry for entry in proven if entry["heldout"].get("amplitude_deg")]
        if proven:
            (_sizes if len(sized) == len(proven) else _held_out)(panels.pop(0), proven, short)
        handles = [page.line("residual of the fit", **AFTER)]
        if diagnosis["findings"]:
            handles = [page.line("without correction", **BEFORE)]
            handles.append(page.line("with correction", **AFTER))
            handles += [page.line("identified effect", **EFFECT)] if curves else []
        handles += [page.line("date of the change", **DATE)] if marked else []
        noise = [Patch(**NOISE, label="95 % range of noise")] if curves else []
        if any(entry["heldout"].get("slope") for entry in proven):
            noise.append(Patch(**page.SHADE, label="slope of held-out days, 95 %"))
        of_sizes = [page.line(label, **look) for look, label in SIZES] if proven and sized == proven else []
        page.legend(figure, [*handles, *noise, *of_sizes] if curves or proven else [])


def _along_time(curve: Mapping[str, Any]) -> bool:
    return curve["covariate"] == "time" or curve["covariate"].startswith(wording.SIZE_PREFIX)


def _residual(axes: Axes, curve: Mapping[str, Any], label: str, reach: float, *, dated: bool) -> None:
    """Draw the binned residual without and with correction, the correction, and the range of noise, cut at gaps."""
    x, before, after, sigma = _columns(curve)
    covariate = curve["covariate"]
    if _along_time(curve) and dated:
        page.dates(axes, (x[0], x[-1]))
        x = x / DAY_S
    elif covariate == "time":
        x = (x - x[0]) / HOUR_S
    half, step = reach * sigma, np.diff(x)
    # A bin extends half-way to its neighbours, and less far into a gap.
    reached, edge = np.minimum(step, page.GAP * np.median(step)) / 2.0, np.median(step) / 2.0
    low, high = x - np.insert(reached, 0, edge), x + np.append(reached, edge)
    axes.bar(low, 2.0 * half, high - low, -half, align="edge", **NOISE)
    if hidden := len(curve["centre"]) - len(x):
        text = f"{hidden} uncertain bin{'s' * (hidden > 1)} not shown"
        axes.annotate(text, (1.0, 0.0), xycoords="axes fraction", ha="right", va="bottom", fontsize=6.5)
    largest = max(float(np.max(np.abs(values))) for values in (before, after, half))
    axes.set_ylim(-1.1 * largest, 1.1 * largest)
    axes.axhline(0.0, color=page.GREY, linewidth=0.6)
    if np.any(before != after):
        apart = np.flatnonzero(np.diff(x) > page.GAP * np.median(np.diff(x))) + 1
        if covariate.startswith(wording.TURN_PREFIX):  # line of equality
            axes.plot(x, x, **EFFECT)
        else:
            axes.plot(np.insert(x, apart, np.nan), np.insert(before - after, apart, np.nan), **EFFECT)
        axes.plot(x, before, **BEFORE)
    axes.plot(x, after, **AFTER)
    effect = covariate.removeprefix(wording.SIZE_PREFIX)
    of_size = effect != covariate
    axes.set_ylabel("Size (°)" if of_size else "Residual (°)")
    axes.set_title(wording.display_name(effect) if of_size else curve.get("compared", "residual"))
    if label:
        axes.set_xlabel(label)
    if covariate == "heading":
        page.degrees(axes.xaxis, (0.0, 360.0))


def _follow(axes: Axes, curve: Mapping[str, Any], proven: Sequence[Mapping[str, Any]]) -> None:
    """Draw the slope of held-out residuals against the turn predicted by the other days, and state it in the title."""
    of_it = [entry for entry in proven if curve["covariate"] == f"{wording.TURN_PREFIX}{entry['effect']}"]
    if len(of_it) != 1:  # composed effects share one name
        return
    texts, proof = [], of_it[0]["heldout"]
    if slope := proof.get("slope"):
        centre = _columns(curve)[0]
        x = np.array([min(centre[0], 0.0), 0.0, max(centre[-1], 0.0)])
        axes.fill_between(x, slope["low"] * x, slope["high"] * x, **page.SHADE)
        axes.plot(x, slope["value"] * x, color=page.CORRECTED, linewidth=1.0)
        texts.append("slope {value:.2f} ({low:.2f} to {high:.2f})".format(**slope).replace("-", "−"))
    if (proof.get("placebo") or {}).get("rank_p") is not None:
        texts.append(f"{wording.rank_text(proof['placebo'])} simulations without it")
    if any(texts):
        axes.set_title(f"held-out days: {', '.join(texts)}")


def _columns(curve: Mapping[str, Any]) -> tuple[Floats, ...]:
    """Collect centre, residual before and after, and standard error of the bins, (n,) each, sorted by centre.

    Bins of less than 1/25 of the usual information, which would set the scale and show nothing, are left out.
    """
    names = ("centre", "before_deg", "after_deg", "sigma_deg")
    columns = np.array([curve[name] for name in names], dtype=float)
    columns = columns[:, np.argsort(columns[0], kind="stable")]
    return tuple(columns[:, columns[3] <= 5.0 * np.median(columns[3])])


def _label(covariate: str, names: Mapping[str, str], units: Mapping[str, str]) -> str:
    """Compose an axis label: name of the covariate, and its unit abbreviated."""
    if covariate.startswith(wording.SIZE_PREFIX):
        return ""  # along time
    if covariate.startswith(wording.TURN_PREFIX):
        effect = covariate.removeprefix(wording.TURN_PREFIX)
        return f"Turn by {'the unlisted effect' if effect == 'composed' else wording.display_name(effect)} (°)"
    name = names.get(covariate, covariate.replace("_", " ").capitalize())
    unit = units.get(covariate, "").replace("degrees C", "°C").replace("degrees", "°")
    return f"{name} ({unit})" if unit else name


def _band_sigmas(curves: Sequence[Mapping[str, Any]]) -> float:
    """Compute the half-width, in standard errors, of a simultaneous 95 % band over all bins (Šidák)."""
    bins = sum(len(curve["centre"]) for curve in curves)
    return NormalDist().inv_cdf(0.5 + 0.5 * 0.95 ** (1.0 / max(bins, 1)))


def _sizes(axes: Axes, findings: Sequence[Mapping[str, Any]], rows: page.Rows) -> None:
    """Draw the size of each effect on held-out days and as predicted by others, and the heading error without it."""
    sizes = [entry["heldout"]["amplitude_deg"] for entry in findings]
    axes.hlines(rows.places, [x["low"] for x in sizes], [x["high"] for x in sizes], color=page.BLACK, linewidth=1.3)
    without = [entry.get("heading_error_without_deg") for entry in findings]
    series = ([x["held_out"] for x in sizes], [x["fitted_elsewhere"] for x in sizes], without)
    for (look, _), values, shift in zip(SIZES, series, (0.0, 0.2, -0.2), strict=True):
        axes.plot(np.array(values, dtype=float), np.asarray(rows.places) + shift, **look)
    axes.axvline(0.0, color=page.GREY, linewidth=0.6)
    rows.name(axes)
    axes.set_xlabel("Size (° rms)")
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.margins(0.08, 0.3)


def _held_out(axes: Axes, findings: Sequence[Mapping[str, Any]], rows: page.Rows) -> None:
    """Draw the rms residual on held-out data, without and with each identified effect."""
    before, after = ([entry["heldout"][f"rms_{key}_deg"] for entry in findings] for key in ("before", "after"))
    axes.hlines(rows.places, before, after, color=page.BLACK, linewidth=1.0)
    axes.plot(before, rows.places, **BEFORE)
    axes.plot(after, rows.places, **AFTER)
    rows.name(axes)
    axes.set(xlabel="Rms residual, held-out data (°)", xlim=(0.0, 1.15 * max([*before, *after, 1e-9])))
    axes.xaxis.set_major_locator(MaxNLocator(4))


def _short(entry: Mapping[str, Any]) -> str:
    """Name an effect; of one that is not listed, its driver."""
    name = entry["effect"]
    driver = name.split("/")[1] if name.startswith("composed:") else (entry.get("composition") or {}).get("driver")
    return f"unlisted, by {driver.replace('_', ' ')}" if driver else wording.display_name(name)


ERROR: dict[str, Any] = {"linestyle": "", "marker": "o", "markeredgewidth": 0}


def error_reach(errors_deg: Sequence[Floats]) -> float:
    """Compute a limit of the vertical axis that contains 99 % of the heading errors of several moorings, degrees."""
    known = np.concatenate([np.abs(error[np.isfinite(error)]) for error in errors_deg] or [np.zeros(0)])
    return 5.0 * float(np.ceil(np.quantile(known, 0.99) / 5.0)) if known.size else 5.0


def draw_errors(
    path: str | Path, time_s: Floats, fit_deg: Floats, corrected_deg: Floats, sigma_deg: Floats,
    dates_utc: Sequence[str | None], reach_deg: float,
) -> None:  # fmt: skip
    """Draw heading errors by the fitted coefficients alone and as corrected, and the dates of true changes."""
    day, half = time_s / DAY_S, NORMAL_95 * sigma_deg
    marks = [np.datetime64(date).astype("datetime64[s]").astype(float) / DAY_S for date in dates_utc if date]
    beyond = np.abs(corrected_deg) > half
    with page.create(path, 4.2) as figure:
        panels = figure.subplots(2, 1, sharex=True, sharey=True)
        panels[0].plot(day, np.clip(fit_deg, -reach_deg, reach_deg), color="#555555", **ERROR, markersize=1.5)
        panels[0].set_title("coefficients alone")
        panels[1].fill_between(day, -half, half, **page.SHADE)
        for here, colour in ((~beyond, page.CORRECTED), (beyond, page.VERMILION)):
            panels[1].plot(
                day[here], np.clip(corrected_deg[here], -reach_deg, reach_deg), color=colour, **ERROR, markersize=1.5
            )
        panels[1].set_title("as corrected")
        for axes in panels:
            axes.axhline(0.0, color="#444444", linewidth=0.5)
            axes.set_ylabel("Heading error (°)")
            for mark in marks:
                axes.axvline(mark, color=page.BLACK, linestyle=":")
        panels[1].set_ylim(-1.05 * reach_deg, 1.05 * reach_deg)
        page.dates(panels[1], (float(time_s[0]), float(time_s[-1])))
        handles: list[Artist] = [Patch(**page.SHADE, label="stated 95 % range")]
        if beyond.any():
            handles.append(page.line("errors outside it", color=page.VERMILION, **ERROR, markersize=3.0))
        handles += [page.line("true change", color=page.BLACK, linestyle=":")] if marks else []
        page.legend(figure, handles)
