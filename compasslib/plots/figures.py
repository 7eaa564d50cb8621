"""The figures of the results, a row each, from which follow the files of the rules and the report.

A new figure is a function in this package and a row here. A row is read without matplotlib, which its function imports.
"""

# ruff: noqa: E501, RUF100 - captions are not wrapped

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from compasslib import plots


@dataclass(frozen=True)
class Figure:
    """A figure of a mooring, of its gridded velocities, of a calibration, a shared compass or the cruise."""

    name: str  # of the file
    draw: Callable[[str, Any], None]  # draws the data of its subject into a file; see ``stages.figures``
    title: str
    caption: str = ""  # template of r, of a calibration or compass c: the results
    note: str = ""  # how it is read, once for all moorings
    of_pairs: bool = False  # whether it is left out where there are neither pairs nor a curve


def names(subject: str) -> list[str]:
    """List the names of the figures of a subject."""
    return [figure.name for figure in FIGURES[subject]]


MOORING = (
    Figure(
        "sticks",
        lambda path, m: plots.timeseries.draw_sticks(path, m.coarser),
        "Currents along time",
        """\
{% set before, after = r.currents.mean[0] | current, r.currents.mean[1] | current %}
{% if before == unknown %}
No bin has a current to show.
{% else %}
Mean at {{ r.currents.depth_m | number(0) }} m: {{ before }} recorded
{{- ", " ~ after ~ " corrected" if after != unknown else "; none is corrected" }}.
{% endif %}""",
        note="Each stick, a mean of one or more days, begins at its date and points where the water flows, north up.",
    ),
    Figure(
        "progressive",
        lambda path, m: plots.timeseries.draw_progressive(path, m.averaged),
        "Progressive vector diagram",
        note="Displacement by the daily mean currents of one place, over the days common to all series; not a trajectory.",
    ),
    Figure(
        "roses",
        lambda path, m: plots.timeseries.draw_roses(path, m.shown, m.reference, m.headings),
        "Direction frequencies",
        note="Share of the samples in sectors of 10°.",
    ),
    Figure(
        "diagnosis",
        lambda path, m: plots.diagnosis.draw_diagnosis(path, m.diagnosis, dated=True),
        "Residual of the fit",
        "{{ about(r.diagnosis) }}",
        note="What the fitted compass leaves of the difference from the reference, in bins, without (orange) and with (blue) the identified effects; the "
        "last quantity is the one that it follows best, which proves nothing. Against a turn: held out days and the prediction of the others, with "
        "slope 1 where form and size are right. Last panel: size on held out days.",
        of_pairs=True,
    ),
    Figure(
        "deviation",
        lambda path, m: plots.deviation.draw_deviation(path, m.pairs, m.fit),
        "Deviation",
        """\
{% set fit = r.fit %}
{% if not fit.coefficients %}
No curve was fitted. {{ r.fit.why | sentence }}
{% else %}
{{ [fit.method != "exact" and methods.get(fit.method, fit.method), not fit.n_pairs and "no pair of this mooring",
  fit.folded and "two correct headings for each recorded one"] | select | join("; ") | sentence }}
{% endif %}""",
        note="Deviation by correct heading β; recorded heading γ by correct heading, and its inverse; bands are 95 % intervals of the fit.",
        of_pairs=True,
    ),
    Figure(
        "histograms",
        lambda path, m: plots.deviation.draw_histograms(path, m.histograms),
        "Histograms",
        of_pairs=True,
    ),
    Figure(
        "scatter",
        lambda path, m: plots.deviation.draw_scatter(path, m.pairs, m.product),
        "Directions compared",
        "{{ '' if r.assessment.before.n else 'There are no pairs: no reference measured near enough to compare.' }}",
        note="All pairs, those of the fit included; the line is equality.",
        of_pairs=True,
    ),
)
SECTIONS = (
    Figure(
        "section",
        lambda path, m: plots.timeseries.draw_section(path, m.means),
        "Sections",
        note="The corrected section includes the reference, which has most values at the depths with a grey edge. Light grey: nothing was measured.",
    ),
    Figure(
        "profile",
        lambda path, m: plots.timeseries.draw_profile(path, m.means),
        "Mean profiles",
        note="Depths measured at least 90 % as often as any, with the 95 % range by the heading's uncertainty; major axes of the variance.",
    ),
    Figure(
        "rotary",
        lambda path, m: plots.moorings.draw_rotary(path, m.series),
        "Rotary spectra",
        note="At the depths with most values, from segments of 15 days. f: inertial frequency; K1, M2: diurnal and semidiurnal tide. A deviation that "
        "changes with the heading spreads power over all frequencies.",
    ),
)


def _calibration(name: str, title: str, caption: str) -> Figure:
    return Figure(name, lambda path, m: plots.calibrations.draw_figure(name, path, m.stored), title, caption)


CALIBRATION = (
    Figure(
        "diagnosis",
        lambda path, m: plots.diagnosis.draw_diagnosis(path, m.diagnosis, dated=False),
        "Residual of the fit",
        "{{ about(d) }}",
    ),
    _calibration(
        "deviation",
        "Deviation of the compass",
        """\
{% if c.coefficients %}
{{ c.n | plural("reading") }}, the curve ({{ models.get(c.model) or c.model | plain }}) with its 95 % band; residuals,
{{ c.residual_rms_deg | degrees(2) }} rms.
{% else %}
{{ c.n }} readings, no curve.
{% endif %}""",
    ),
    _calibration(
        "magnetometer",
        "Magnetometer readings before and after",
        """\
{% set left = c.get("modulus_residual_percent") or {} %}
{% if left.get("after") is none %}{{ c.why | sentence }}{% else %}
The modulus of the field scatters by {{ left.before | number(2) }} % before and {{ left.after | number(2) }} % after the correction.
{% endif %}""",
    ),
    _calibration(
        "series",
        "Declination of the observatory",
        """\
Observed and by the field model; constant between them
{{ c.get("constant_deg") | with_sigma(c.get("constant_sigma_deg"), "°") }} (1σ).""",
    ),
    _calibration(
        "compared",
        "Compared",
        "Shift and change of amplitude of each one's one-cycle part against the first ({{ c.compared[0].name }}), ± k = 2.",
    ),
    _calibration(
        "tilt",
        "Tilt",
        """\
Correction of recorded tilts with its 95 % interval, budget included.
{% for axis, fit in c.get("axes", {}).items() %}
{{ "%s: largest error %s." | format(axis | capitalize, fit.max_error_deg | degrees(2)) if fit.form is defined else "" }}
{% endfor %}""",
    ),
)
COMPASS = (
    Figure(
        "coefficients",
        lambda path, m: plots.deviation.draw_shared_coefficients(path, m),
        "Coefficients",
        "Iron by each record alone, with its 95 % interval, and that of the compass.",
    ),
)
CRUISE = (
    Figure("map", lambda path, m: plots.moorings.draw_map(path, m.array), "Map", "Positions of the moorings."),
    Figure(
        "array",
        lambda path, m: plots.moorings.draw_array(path, m.array),
        "The array",
        "Water depth and nominal depths.",
    ),
    Figure("curves", lambda path, m: plots.moorings.draw_curves(path, m.moorings), "Deviations", "By correct heading."),
    Figure(
        "differences",
        lambda path, m: plots.moorings.draw_differences(path, m.moorings),
        "Differences from the reference",
        "On held out pairs; each row is scaled to its highest bin. Right: rms with its 95 % interval.",
    ),
    Figure(
        "currents",
        lambda path, m: plots.moorings.draw_currents(path, m.moorings),
        "Mean currents and variance ellipses",
        "Mean current at the pairs, from the cross, and ellipse of one standard deviation; corrected: held out pairs.",
    ),
)
FIGURES = {
    "mooring": MOORING,
    "sections": SECTIONS,
    "calibration": CALIBRATION,
    "compass": COMPASS,
    "cruise": CRUISE,
}
