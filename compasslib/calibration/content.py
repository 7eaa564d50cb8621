"""What calibration.json holds, whatever the kind."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib.calibration import budget, comparison, settled
from compasslib.calibration.result import COVERAGE_FACTOR, LETTERS, Calibration, Source
from compasslib.deviation.transfer import WEAKEST_NT

Floats = NDArray[np.floating]

POSITION = ("latitude", "longitude")


def described(
    name: str, made: Calibration, settings: Mapping[str, Any], earlier: Mapping[str, Mapping[str, Any]]
) -> dict[str, Any]:
    """Return calibration.json: what every kind has, then what only this one has.

    Args:
        name: of the calibration.
        made: the calibration.
        settings: as the kind got them, settled.
        earlier: calibration.json of those that it is to be compared with, by name; at most one.
    """
    common = {
        "name": name,
        "kind": made.kind,
        "model": made.model,
        "coefficients": _named(made.coefficients),
        "covariance": made.covariance if made.coefficients.size else None,
        "residual_rms_deg": made.residual_rms_deg,
        "n": made.n,
        "coverage": made.coverage,
        "uncertainty": _uncertainty(made),
        "exact": {"coefficients": _named(made.exact), "covariance": made.exact_covariance} if made.exact.size else None,
        "place": _place(settings, made.details),
        "comparison": next((comparison.compare(made, told, other) for other, told in earlier.items()), None),
        "why": made.why,
        "warnings": [*made.warnings, *_weak(settings.get("field"))],
    }
    taken = [key for key in made.details if key in common and made.details[key] != common[key]]
    if taken:
        raise ValueError(f"details of kind {made.kind} use the names {taken}, which every calibration has")
    return {**common, **made.details}


def calibration(content: Mapping[str, Any]) -> Calibration:
    """Return the calibration that a calibration.json describes, without its table and points.

    Args:
        content: the file's content.
    """
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


def _numbers(letters: Mapping[str, float | None] | None) -> Floats:
    return np.array([letters[k] for k in LETTERS] if letters else [], dtype=float)


def told(content: Mapping[str, Any]) -> str:
    """Return what the job says of its result.

    Args:
        content: calibration.json.
    """
    name, warnings = content["name"], [f"{content['name']}: warning: {text}" for text in content["warnings"]]
    if content["why"]:
        return "\n".join([f"{name}: no calibration: {content['why']}", *warnings])
    known = {k: x for k, x in (content["coefficients"] or {}).items() if x is not None and np.isfinite(x)}
    letters = ", ".join(f"{k} {x:+.2f}" for k, x in known.items())
    expanded = content["uncertainty"]["expanded_deg"]
    sure = "" if expanded is None else f", expanded uncertainty {expanded:.2f} degrees (k = 2)"
    first = f"{name}: {content['kind']}, {content['n']} readings, model {content['model']}"
    return "\n".join([f"{first}{f', {letters} degrees' if letters else ''}{sure}", *warnings])


def _named(values: Floats) -> dict[str, float] | None:
    return dict(zip(LETTERS, values.tolist(), strict=True)) if values.size else None


def _place(settings: Mapping[str, Any], details: Mapping[str, Any]) -> dict[str, Any]:
    """Return place and date with the earth's field there: as given, else as a log that holds them has them."""
    date = settings.get("date_s")
    day = details.get("date") if date is None else datetime.fromtimestamp(date, UTC).strftime("%Y-%m-%d")
    at = {key: settings.get(key) for key in POSITION}
    at = {key: details.get(key) for key in POSITION} if None in at.values() else at
    date_s = None if day is None else datetime.fromisoformat(day).replace(tzinfo=UTC).timestamp()
    field = settings.get("field") or settled({**at, "date_s": date_s})["field"]
    declination = settings.get("declination_deg", field and field["declination_deg"])
    return {**at, "date": day, "declination_deg": declination, "field": field}


def _uncertainty(made: Calibration) -> dict[str, Any]:
    found = made.sources and (made.coefficients.size or made.exact.size)
    standard = budget.combined(made.sources) if found else None
    return {
        "rows": {row.name: {"standard_deg": row.standard_deg, "how": row.how} for row in made.sources},
        "standard_deg": standard,
        "coverage_factor": COVERAGE_FACTOR,
        "expanded_deg": None if standard is None else COVERAGE_FACTOR * standard,
    }


def _weak(field: Mapping[str, float] | None) -> list[str]:
    if field is None or field["horizontal_nT"] >= WEAKEST_NT:
        return []
    return [f"the horizontal field is {field['horizontal_nT']:.0f} nT; below {WEAKEST_NT:.0f} nT no correction holds"]
