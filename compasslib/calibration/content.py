"""What calibration.json holds, whatever the kind."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib.calibration import budget, comparison
from compasslib.calibration.result import COVERAGE_FACTOR, LETTERS, Calibration
from compasslib.deviation.transfer import WEAKEST_NT

Floats = NDArray[np.floating]


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
        "place": _place(settings),
        "comparison": next((comparison.compare(made, told, other) for other, told in earlier.items()), None),
        "why": made.why,
        "warnings": [*made.warnings, *_weak(settings.get("field"))],
    }
    taken = set(common) & set(made.details)
    if taken:
        raise ValueError(f"details of kind {made.kind} use the names {sorted(taken)}, which every calibration has")
    return {**common, **made.details}


def told(content: Mapping[str, Any]) -> str:
    """Return what the job says of its result.

    Args:
        content: calibration.json.
    """
    name, warnings = content["name"], [f"{content['name']}: warning: {text}" for text in content["warnings"]]
    if content["why"]:
        return "\n".join([f"{name}: no calibration: {content['why']}", *warnings])
    letters = ", ".join(f"{k} {x:+.2f}" for k, x in (content["coefficients"] or {}).items())
    expanded = content["uncertainty"]["expanded_deg"]
    sure = "" if expanded is None else f", expanded uncertainty {expanded:.2f} degrees (k = 2)"
    first = f"{name}: {content['kind']}, {content['n']} readings, model {content['model']}"
    return "\n".join([f"{first}{f', {letters} degrees' if letters else ''}{sure}", *warnings])


def _named(values: Floats) -> dict[str, float] | None:
    return dict(zip(LETTERS, values.tolist(), strict=True)) if values.size else None


def _place(settings: Mapping[str, Any]) -> dict[str, Any]:
    date = settings.get("date_s")
    day = None if date is None else datetime.fromtimestamp(date, UTC).strftime("%Y-%m-%d")
    return {"latitude": settings.get("latitude"), "longitude": settings.get("longitude"), "date": day} | {
        key: settings.get(key) for key in ("declination_deg", "field")
    }


def _uncertainty(made: Calibration) -> dict[str, Any]:
    standard = budget.combined(made.sources) if made.sources and not made.why else None
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
