"""Result of a calibration of any kind, its file calibration.json, and the comparison of two calibrations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import numpy as np

from compasslib import angles
from compasslib.calibrations import budget
from compasslib.calibrations.bench import changes_by_object, describe_object
from compasslib.calibrations.budget import COVERAGE_FACTOR, Source
from compasslib.deviation.model import weak_field_warnings
from compasslib.earthfield import resolve_settings
from compasslib.types import Floats

LETTERS = "ABCDE"
NO_BENCH = "compare_with names no bench without the object, so that its influence is not known"


@dataclass(frozen=True)
class DeviationTable:
    """Deviation by recorded heading."""

    heading_deg: Floats  #: (m,) recorded, magnetic
    deviation_deg: Floats  #: (m,) to be added to the recorded heading
    sigma_deg: Floats  #: (m,) one standard deviation


@dataclass(frozen=True)
class Calibration:
    """Result of one calibration; without coefficients if the data do not suffice, for the reason given in ``why``."""

    kind: str  #: platform | tilt | swing | magnetometer | declination | two_heads
    model: str  #: name of the selected curve or model
    n: int  #: observations used
    coverage: int  #: occupied sectors of 10 degrees of the recorded heading, of 36
    coefficients: Floats = field(default_factory=lambda: np.zeros(0))  #: (5,) A..E of the series, degrees
    covariance: Floats = field(default_factory=lambda: np.zeros(0))  #: (5, 5)
    exact: Floats = field(default_factory=lambda: np.zeros(0))  #: (5,) A..E of the exact compass, dimensionless
    exact_covariance: Floats = field(default_factory=lambda: np.zeros(0))  #: (5, 5)
    residual_rms_deg: float = float("nan")  #: degrees, of the chosen curve; NaN without one
    sources: tuple[Source, ...] = ()  #: rows of the uncertainty budget
    table: DeviationTable | None = None  #: deviation by recorded heading; None if it is unknown
    points: Mapping[str, Floats] = field(default_factory=dict)  #: columns of the observations, (n,) each
    details: Mapping[str, Any] = field(default_factory=dict)  #: entries specific to the kind, ready for JSON
    why: str = ""  #: reason for missing coefficients; empty if there are any
    warnings: tuple[str, ...] = ()  #: sentences for the report


def to_json(name: str, made: Calibration, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Convert a calibration to the content of calibration.json: keys common to all kinds, then those of its kind."""
    # Place and date as given, else as stated in the log, and the earth's field there.
    details, date_s = made.details, settings.get("date_s")
    date = details.get("date") if date_s is None else datetime.fromtimestamp(date_s, UTC).strftime("%Y-%m-%d")
    stated = settings if None not in (settings.get("latitude"), settings.get("longitude")) else details
    at = {key: stated.get(key) for key in ("latitude", "longitude")}
    day_s = None if date is None else datetime.fromisoformat(date).replace(tzinfo=UTC).timestamp()
    field = settings.get("field") or resolve_settings({**at, "date_s": day_s})["field"]
    declination = settings.get("declination_deg", field and field["declination_deg"])
    weak = weak_field_warnings(field["horizontal_nT"]) if field else ()
    standard = budget.combined(made.sources) if made.sources and not made.why else None
    common = {
        "name": name,
        "kind": made.kind,
        "model": made.model,
        "coefficients": _named(made.coefficients),
        "covariance": made.covariance if made.coefficients.size else None,
        "residual_rms_deg": made.residual_rms_deg,
        "n": made.n,
        "coverage": made.coverage,
        "uncertainty": {
            "rows": {row.name: {"standard_deg": row.standard_deg, "how": row.how} for row in made.sources},
            "standard_deg": standard,
            "coverage_factor": COVERAGE_FACTOR,
            "expanded_deg": None if standard is None else COVERAGE_FACTOR * standard,
        },
        "exact": {"coefficients": _named(made.exact), "covariance": made.exact_covariance} if made.exact.size else None,
        "place": {**at, "date": date, "declination_deg": declination, "field": field},
        "parts": list(settings.get("parts") or ()),
        "comparison": None,
        "compared": [],
        "why": made.why,
        "warnings": [*made.warnings, *weak],
    }
    near = {"object": settings["object"]} if settings.get("object") else {}
    return {**common, **details, **near}


def compare_all(name: str, content: Mapping[str, Any], earlier: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Compare a calibration with others, as the keys of calibration.json that need them.

    The curves of several calibrations are described with the change of their one-cycle part from the first; an object
    by its changes relative to the first, the one without it. ``earlier`` has contents by name.
    """
    if not earlier:
        alone = {"object": {**content["object"], "text": NO_BENCH}} if content.get("object") else {}
        return {"comparison": None, "compared": []} | alone
    first, *others = {**earlier, name: content}
    pages = {**earlier, name: content}
    compared = [{"name": first, "coefficients": pages[first]["coefficients"], "amplitude_deg": None, "phase_deg": None}]
    for other in others:
        against = compare(from_json(pages[other]), pages[first], first)
        change = against.get("one_cycle") or {"amplitude_deg": None, "phase_deg": None}
        compared.append({"name": other, "coefficients": pages[other]["coefficients"], **change})
    result: dict[str, Any] = {"comparison": against, "compared": compared}
    if content.get("object"):
        changes = changes_by_object(pages[first], [pages[other] for other in others])
        described = describe_object(changes, content["object"]["size_m"]) if changes else {}
        result["object"] = content["object"] | ({"text": NO_BENCH} if pages[first].get("object") else described)
    return result


def from_json(content: Mapping[str, Any]) -> Calibration:
    """Make a calibration from its calibration.json, without table and points."""
    exact, rms = content["exact"] or {}, content["residual_rms_deg"]
    rows = content["uncertainty"]["rows"].items()
    return Calibration(
        kind=content["kind"],
        model=content["model"],
        n=content["n"],
        coverage=content["coverage"],
        coefficients=_numbers(content["coefficients"]),
        covariance=np.array(content["covariance"] or [], dtype=float),
        exact=_numbers(exact.get("coefficients")),
        exact_covariance=np.array(exact.get("covariance") or [], dtype=float),
        residual_rms_deg=float("nan") if rms is None else rms,
        sources=tuple(Source(name, row["standard_deg"], row["how"]) for name, row in rows),
        details=content,
        why=content["why"],
        warnings=tuple(content["warnings"]),
    )


def log_line(content: Mapping[str, Any]) -> str:
    """Summarize a calibration in one line of the log, followed by its warnings."""
    name = content["name"]
    known = {k: x for k, x in (content["coefficients"] or {}).items() if x is not None and np.isfinite(x)}
    letters = ", ".join(f"{k} {x:+.2f}" for k, x in known.items())
    expanded = content["uncertainty"]["expanded_deg"]
    line = f"{name}: {content['kind']}, {content['n']} readings, model {content['model']}"
    line += f", {letters} degrees" if letters else ""
    line += "" if expanded is None else f", expanded uncertainty {expanded:.2f} degrees (k = 2)"
    first = f"{name}: no calibration: {content['why']}" if content["why"] else line
    return "\n".join([first, *(f"{name}: warning: {text}" for text in content["warnings"])])


def _numbers(letters: Mapping[str, float | None] | None) -> Floats:
    return np.array([letters[k] for k in LETTERS] if letters else [], dtype=float)


def _named(values: Floats) -> dict[str, float] | None:
    return dict(zip(LETTERS, values.tolist(), strict=True)) if values.size else None


def compare(
    after: Calibration,
    before: Mapping[str, Any],
    name: str,
    *,
    significance: float = 0.05,  # p-value below which two calibrations differ significantly
    min_p_value: float = 0.001,  # smaller ones are not printed
    min_amplitude_sigmas: float = 3.0,  # least amplitude, in standard deviations, that has a phase
) -> dict[str, Any]:
    """Compare a calibration with an earlier one of the same compass, such as before its batteries were demagnetised.

    Le Menn et al. 2023, sections 3 and 4, compare curves by eye and by their phase shift. Here the difference of each
    coefficient is given with its uncertainty, and with the p-value (chi square) of no difference. The budgets are
    not included, as errors common to both calibrations cancel.
    """
    if not after.coefficients.size or before["coefficients"] is None:
        missing = name if before["coefficients"] is None else "this calibration"
        return {"with": name, "why": f"{missing} has no coefficients", "differ": None}
    from scipy.special import chdtrc  # imported late: only needed for comparisons

    earlier, earlier_covariance = _numbers(before["coefficients"]), np.array(before["covariance"], dtype=float)
    both = np.isfinite(after.coefficients) & np.isfinite(earlier)
    off, covariance = after.coefficients - earlier, after.covariance + earlier_covariance
    square = off[both] @ np.linalg.pinv(covariance[np.ix_(both, both)]) @ off[both]
    p_value = float(chdtrc(int(both.sum()), square))
    difference = {}
    for k in np.flatnonzero(both):
        value, sigma = float(off[k]), float(np.sqrt(covariance[k, k]))
        z = value / sigma if sigma > 0 else float("nan")
        difference[LETTERS[k]] = {"value_deg": value, "sigma_deg": sigma, "z": z}
    here, there = _polar(after.coefficients, after.covariance), _polar(earlier, earlier_covariance)
    change, sigma = here[0] - there[0], float(np.hypot(here[1], there[1]))
    size = {"after": here[0], "before": there[0], "difference": change, "sigma": sigma}
    phase, moved = None, "it is too small on one side to have a phase"
    if not min(here[0] / here[1], there[0] / there[1]) < min_amplitude_sigmas:
        shift, spread = float(angles.difference(here[2], there[2])), float(np.hypot(here[3], there[3]))
        phase = {"after": here[2], "before": there[2], "shift": shift, "sigma": spread}
        moved = f"its phase moves by {shift:+.0f} ± {2 * spread:.0f} degrees"
    differ = p_value < significance
    chance = f"p = {p_value:.2g}" if p_value >= min_p_value else f"p < {min_p_value}"
    return {
        "with": name,
        "one_cycle": {"amplitude_deg": size, "phase_deg": phase},
        "difference": difference,
        "p_value": p_value,
        "differ": differ,
        "text": f"This calibration and {name} {'differ' if differ else 'do not differ significantly'} ({chance}). "
        f"The one-cycle part goes from {there[0]:.2f} to {here[0]:.2f} degrees, by {change:+.2f} ± {2 * sigma:.2f} "
        f"(k = 2); {moved}.",
    }


def _polar(coefficients: Floats, covariance: Floats) -> tuple[float, float, float, float]:
    """Convert B and C to amplitude, its sigma, phase (where B sin + C cos is largest) and its sigma, degrees."""
    pair, spread = coefficients[1:3], covariance[1:3, 1:3]
    amplitude = max(float(np.hypot(*pair)), 1e-12)
    along = pair / amplitude
    across = np.array([along[1], -along[0]])
    sigmas = [max(float(np.sqrt(x @ spread @ x)), 1e-12) for x in (along, across)]
    return amplitude, sigmas[0], float(angles.direction(*pair)), sigmas[1] / amplitude / angles.DEGREE
