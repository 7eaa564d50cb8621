"""Transfer of a calibration made elsewhere to a mooring's field, as the deviation model of the mooring."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from compasslib import angles, compass
from compasslib.calibrations.curves import EMPIRICAL
from compasslib.calibrations.result import LETTERS
from compasslib.deviation.exact import smooth_density
from compasslib.deviation.likelihood import CELLS
from compasslib.deviation.model import (
    IRON_NT,
    UNKNOWN_COVARIANCE,
    DeviationFit,
    FieldAtPlace,
    PlacedCoefficients,
    ScatterNoise,
    TransferredCoefficients,
    heading_residual,
    observed_heading,
    transfer_coefficients,
)
from compasslib.deviation.series import invert_series, series_range
from compasslib.records import BAD, EarthField, Pairs, Record
from compasslib.statistics.noise import effective_sample_size
from compasslib.types import Floats

METHOD, GIVEN = "calibration", "coefficients"
HEADINGS_DEG = np.arange(0.0, 360.0, 5.0)


def carry_to_mooring(
    contents: Sequence[Mapping[str, Any]],
    field: EarthField,
    record: Record,
    pairs: Pairs,
    *,
    parts: Sequence[str] = (),
    iron_nT: float = IRON_NT,
    min_noise_deg: float = 0.8,
    max_noise_deg: float = 8.0,
) -> DeviationFit:
    """Transfer the exact compass of calibrations to a mooring's field; no coefficients if that is impossible.

    The model is evaluated on the pairs, but not fitted to them.

    Args:
        parts: parts near the mooring's compass.
        iron_nT: prior standard deviation of hard and of induced iron, see ``transfer_coefficients``.
        min_noise_deg, max_noise_deg: bounds of the compass noise for the decision between branches.
    """
    if missing := [f"calibration {each['name']}: {why}" for each in contents if (why := _missing_part(each, field))]:
        return DeviationFit(METHOD, len(pairs), why="; ".join(missing))
    transferred = _transfer(contents, field, iron_nT)
    names = " and ".join(content["name"] for content in contents)
    named = [f"calibration {names}: {transferred.warning}"] if transferred.warning else []
    for content in contents:
        warnings = (*content.get("doubts", ()), other_parts(content.get("parts", ()), parts))
        named += [f"calibration {content['name']}: {warning}" for warning in warnings if warning]
    if len(contents) > 1:
        named.append(_change(contents, transferred.each)["text"])
    scatter = max(content["residual_rms_deg"] or 0.0 for content in contents)
    noise = ScatterNoise(compass_deg=float(np.clip(scatter, min_noise_deg, max_noise_deg)))
    known = transferred.coefficients, transferred.covariance
    fit = DeviationFit(METHOD, len(pairs), *known, noise=noise, warnings=tuple(named))
    return evaluate_on_record(fit, record, pairs)


def other_parts(calibrated: Sequence[str], moored: Sequence[str]) -> str:
    """Report if a compass was calibrated with other parts near it than it is moored with; empty if with the same."""
    there, here = ({part.casefold() for part in parts} for parts in (calibrated, moored))
    if there == here:
        return ""
    differing = [part for part in (*calibrated, *moored) if (part.casefold() in there) != (part.casefold() in here)]
    stated = "with " + ", ".join(calibrated) if calibrated else "without stated parts"
    near = "with " + ", ".join(moored) if moored else "without stated parts"
    return (
        f"calibrated {stated}, moored {near}: {', '.join(differing)} may turn the compass by more than the "
        "stated uncertainty; calibrate with what is moored, or correct parts"
    )


def _change(contents: Sequence[Mapping[str, Any]], coefficients: Floats) -> dict[str, Any]:
    """Describe the change of a compass between two calibrations, both transferred to the mooring."""
    size = angles.rms(angles.difference(*(compass.recorded_heading(each, HEADINGS_DEG) for each in coefficients)))
    before, after = (f"{each['name']} ({each['place']['date'] or 'not dated'})" for each in contents)
    text = (
        f"the compass changed by {size:.1f}° rms between the calibrations {before} and {after}: the mean of both is "
        "used, and the change is in the uncertainty of all headings"
    )
    return {"rms_deg": size, "text": text}


def compass_from_coefficients(
    model: str, coefficients: Mapping[str, float], covariance: Any | None, record: Record, pairs: Pairs
) -> DeviationFit:
    """Build the deviation model from the coefficients given in a mooring's file.

    Args:
        model: ``exact`` (dimensionless) or ``von_appen`` (degrees).
        covariance: (5, 5), None where it is unknown.
    """
    values, unit = np.array([coefficients[k] for k in LETTERS]), 1.0 if model == "exact" else 1.0 / angles.DEGREE
    known, spread = covariance is not None, np.array(covariance or np.diag(np.full(5, unit**2)), dtype=float)
    method = GIVEN if model == "exact" else model
    warnings = () if known else (UNKNOWN_COVARIANCE,)
    fit = DeviationFit(method, len(pairs), values, spread, fixed=True, covariance_known=known, warnings=warnings)
    if method == GIVEN:
        return evaluate_on_record(fit, record, pairs)
    residual = angles.difference(observed_heading(pairs), invert_series(values, pairs.heading_deg))
    seen = np.isfinite(residual)
    recorded_range, folded = series_range(values)
    return replace(
        fit,
        n_effective=effective_sample_size(residual[seen], pairs.time_s[seen]) if seen.any() else 0.0,
        residual_rms_deg=angles.rms(residual),
        recorded_range_deg=recorded_range,
        folded=folded,
    )


def evaluate_on_record(fit: DeviationFit, record: Record, pairs: Pairs) -> DeviationFit:
    """Evaluate a given compass on the record of a mooring, without fitting."""
    off = heading_residual(fit, pairs)
    off, when = off[np.isfinite(off)], pairs.time_s[np.isfinite(off)]
    # Density of the correct headings from the record alone, counting both roots where there are two.
    recorded = record.heading_deg[np.isfinite(record.heading_deg) & (record.heading_quality < BAD)]
    roots = compass.inverse(fit.coefficients, recorded)
    count = np.histogram(roots[np.isfinite(roots)], CELLS, (0.0, 360.0))[0]
    return replace(
        fit,
        n_effective=effective_sample_size(off, when) if len(off) else 0.0,
        residual_rms_deg=angles.rms(off),
        recorded_range_deg=compass.recorded_range(fit.coefficients),
        folded=not compass.turns_full_circle(fit.coefficients),
        heading_density=smooth_density(1e-6 + count),
    )


def origin(contents: Sequence[Mapping[str, Any]], field: EarthField, iron_nT: float = IRON_NT) -> dict[str, Any]:
    """Describe the origin of the model for deviation.json: the calibration, and any after the deployment."""
    sources: list[dict[str, Any]] = [{key: content[key] for key in ("name", "kind", "place")} for content in contents]
    usable = not any(_missing_part(content, field) for content in contents)
    for source, content in zip(sources, contents if usable else (), strict=False):
        source["coefficients"] = content["exact"]["coefficients"]
    after = {"calibration_after": sources[1]} if len(sources) > 1 else {}
    each = _transfer(contents, field, iron_nT).each if usable and len(contents) > 1 else None
    change = {} if each is None else {"calibration_change": _change(contents, each)}
    return {"calibration": sources[0]} | after | change


def _missing_part(content: Mapping[str, Any], field: EarthField, *, same_field: float = 0.05) -> str:
    """Explain why a calibration cannot be carried to a mooring; empty if it can.

    Args:
        same_field: relative change of the horizontal field within which an empirical curve remains valid.
    """
    if content["exact"] is None:
        return content["why"] or "it has no coefficients of the exact compass, its headings do not determine them"
    if not np.isfinite(np.array(content["exact"]["covariance"], dtype=float)).all():
        return "its coefficients of the exact compass are not all determined"
    if content["place"]["field"] is None:
        return "its place or date is unknown, so that its coefficients cannot be carried to the mooring's field"
    ratio = float(np.mean(field.horizontal_nT)) / content["place"]["field"]["horizontal_nT"]
    if content["model"] == EMPIRICAL.name and abs(ratio - 1.0) > same_field:
        return (
            "its curve is empirical, and how much of it iron makes, which the field changes, is unknown: the level "
            f"field of the mooring is {ratio:.2f} of the calibration's; calibrate where it is the same within "
            f"{100.0 * same_field:.0f} %, correct the instrument's table and calibrate again, or fit a reference"
        )
    return ""


def _transfer(contents: Sequence[Mapping[str, Any]], field: EarthField, iron_nT: float) -> TransferredCoefficients:
    away = FieldAtPlace(float(np.mean(field.horizontal_nT)), float(np.mean(field.vertical_nT)))
    return transfer_coefficients([_placed(content) for content in contents], away, iron_nT)


def _placed(content: Mapping[str, Any]) -> PlacedCoefficients:
    given, home = content["exact"], content["place"]["field"]
    covariance = np.array(given["covariance"], dtype=float)
    # Deviations not due to iron, which the selected curve absorbed, remain in the corrected headings.
    exact = content.get("models", {}).get("exact", {}).get("residual_rms_deg")
    covariance[0, 0] += max((exact or 0.0) ** 2 - (content["residual_rms_deg"] or 0.0) ** 2, 0.0) * angles.DEGREE**2
    # At any one heading, the errors of the budget are indistinguishable from a rotation of the whole compass.
    covariance[0, 0] += ((content["uncertainty"]["standard_deg"] or 0.0) * angles.DEGREE) ** 2
    place = FieldAtPlace(home["horizontal_nT"], home["vertical_nT"])
    return PlacedCoefficients(np.array([given["coefficients"][k] for k in LETTERS]), covariance, place)
