"""Transfer of a calibration made elsewhere to a mooring's field, as the deviation model of the mooring."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from compasslib import angles, compass
from compasslib.calibrations.curves import CIRCLE_DEG, EMPIRICAL
from compasslib.calibrations.result import LETTERS
from compasslib.deviation import model as models
from compasslib.deviation.exact import smooth_density
from compasslib.deviation.likelihood import CELLS
from compasslib.deviation.model import IRON_NT, DeviationFit, FieldAtPlace, PlacedCoefficients, TransferredCoefficients
from compasslib.deviation.series import invert_series, series_range
from compasslib.records import BAD, EarthField, Pairs, Record
from compasslib.statistics.noise import effective_sample_size
from compasslib.types import Floats

METHOD = "calibration"


def carry_to_mooring(
    contents: Sequence[Mapping[str, Any]],
    field: EarthField,
    record: Record,
    pairs: Pairs,
    *,
    parts: Sequence[str] = (),  # parts near the mooring's compass
    iron_nT: float = IRON_NT,  # prior standard deviation of hard and of induced iron, see ``transfer_coefficients``
) -> tuple[DeviationFit, dict[str, Any]]:
    """Transfer one calibration, or one before and one after, to a mooring's field: the model and its origin."""
    sources = [{key: content[key] for key in ("name", "kind", "place")} for content in contents]
    origin: dict[str, Any] = dict(zip(("calibration", "calibration_after"), sources, strict=False))
    if missing := [f"calibration {each['name']}: {why}" for each in contents if (why := _missing_part(each, field))]:
        return DeviationFit(METHOD, len(pairs), why="; ".join(missing)), origin
    transferred = _transfer(contents, field, iron_nT)
    names = " and ".join(content["name"] for content in contents)
    warnings = [f"calibration {names}: {transferred.warning}"] if transferred.warning else []
    for content, source in zip(contents, sources, strict=True):
        source["coefficients"] = content["exact"]["coefficients"]
        doubts = [*content.get("doubts", ()), *_other_parts(content.get("parts", ()), parts)]
        warnings += [f"calibration {content['name']}: {doubt}" for doubt in doubts]
    if len(contents) > 1:
        headings = (compass.recorded_heading(each, CIRCLE_DEG) for each in transferred.each)
        size = angles.rms(angles.difference(*headings))
        before, after = (f"{each['name']} ({each['place']['date'] or 'not dated'})" for each in contents)
        text = (
            f"the compass changed by {size:.1f}° rms between the calibrations {before} and {after}: the mean of both "
            "is used, and the change is in the uncertainty of all headings"
        )
        origin["calibration_change"] = {"rms_deg": size, "text": text}
        warnings.append(text)
    scatter = max(content["residual_rms_deg"] or 0.0 for content in contents)
    noise = models.ScatterNoise(compass_deg=float(np.clip(scatter, 0.8, 8.0)))
    known = transferred.coefficients, transferred.covariance
    fit = DeviationFit(METHOD, len(pairs), *known, noise=noise, warnings=tuple(warnings))
    return evaluate_on_record(fit, record, pairs), origin


def _other_parts(calibrated: Sequence[str], moored: Sequence[str]) -> list[str]:
    """Warn of parts that are near the compass in the calibration or at the mooring only."""
    there, here = ({part.casefold() for part in parts} for parts in (calibrated, moored))
    differing = [part for part in (*calibrated, *moored) if (part.casefold() in there) != (part.casefold() in here)]
    if not differing:
        return []
    stated, near = (f"with {', '.join(parts)}" if parts else "without stated parts" for parts in (calibrated, moored))
    return [
        f"calibrated {stated}, moored {near}: {', '.join(differing)} may turn the compass by more than the stated "
        "uncertainty; calibrate with what is moored, or correct parts"
    ]


def compass_from_coefficients(
    model: str, coefficients: Mapping[str, float], covariance: Any | None, record: Record, pairs: Pairs
) -> DeviationFit:
    """Build the model from the coefficients (exact: dimensionless; von_appen: degrees) of a mooring's file."""
    exact, known = model == "exact", covariance is not None
    values, unit = np.array([coefficients[k] for k in LETTERS]), 1.0 if exact else 1.0 / angles.DEGREE
    spread = np.array(covariance or np.diag(np.full(5, unit**2)), dtype=float)
    fit = DeviationFit(
        "coefficients" if exact else model,
        len(pairs),
        values,
        spread,
        fixed=True,
        covariance_known=known,
        warnings=() if known else (models.UNKNOWN_COVARIANCE,),
    )
    if exact:
        return evaluate_on_record(fit, record, pairs)
    recorded_range, folded = series_range(values)
    residual = angles.difference(models.observed_heading(pairs), invert_series(values, pairs.heading_deg))
    return _with_residual(fit, residual, pairs, recorded_range_deg=recorded_range, folded=folded)


def evaluate_on_record(fit: DeviationFit, record: Record, pairs: Pairs) -> DeviationFit:
    """Evaluate a given compass on the record of a mooring, without fitting."""
    # Density of the correct headings from the record alone, counting both roots where there are two.
    recorded = record.heading_deg[np.isfinite(record.heading_deg) & (record.heading_quality < BAD)]
    roots = compass.inverse(fit.coefficients, recorded)
    count = np.histogram(roots[np.isfinite(roots)], CELLS, (0.0, 360.0))[0]
    return _with_residual(
        fit,
        models.heading_residual(fit, pairs),
        pairs,
        recorded_range_deg=compass.recorded_range(fit.coefficients),
        folded=not compass.turns_full_circle(fit.coefficients),
        heading_density=smooth_density(1e-6 + count),
    )


def _with_residual(fit: DeviationFit, residual: Floats, pairs: Pairs, **more: Any) -> DeviationFit:
    seen = np.isfinite(residual)
    effective = effective_sample_size(residual[seen], pairs.time_s[seen]) if seen.any() else 0.0
    return replace(fit, n_effective=effective, residual_rms_deg=angles.rms(residual), **more)


def _missing_part(content: Mapping[str, Any], field: EarthField) -> str:
    """Explain why a calibration cannot be carried to a mooring; empty if it can."""
    if content["exact"] is None:
        return content["why"] or "it has no coefficients of the exact compass, its headings do not determine them"
    if not np.isfinite(np.array(content["exact"]["covariance"], dtype=float)).all():
        return "its coefficients of the exact compass are not all determined"
    if content["place"]["field"] is None:
        return "its place or date is unknown, so that its coefficients cannot be carried to the mooring's field"
    ratio = float(np.mean(field.horizontal_nT)) / content["place"]["field"]["horizontal_nT"]
    if content["model"] == EMPIRICAL.name and abs(ratio - 1.0) > 0.05:
        return (
            "its curve is empirical, and how much of it iron makes, which the field changes, is unknown: the level "
            f"field of the mooring is {ratio:.2f} of the calibration's; calibrate where it is the same within "
            "5 %, correct the instrument's table and calibrate again, or fit a reference"
        )
    return ""


def _transfer(contents: Sequence[Mapping[str, Any]], field: EarthField, iron_nT: float) -> TransferredCoefficients:
    placed = []
    for content in contents:
        given, home = content["exact"], content["place"]["field"]
        covariance = np.array(given["covariance"], dtype=float)
        # Deviations not due to iron, which the selected curve absorbed, remain in the corrected headings.
        exact = content.get("models", {}).get("exact", {}).get("residual_rms_deg") or 0.0
        covariance[0, 0] += max(exact**2 - (content["residual_rms_deg"] or 0.0) ** 2, 0.0) * angles.DEGREE**2
        # At any one heading, the errors of the budget are indistinguishable from a rotation of the whole compass.
        covariance[0, 0] += ((content["uncertainty"]["standard_deg"] or 0.0) * angles.DEGREE) ** 2
        coefficients = np.array([given["coefficients"][k] for k in LETTERS])
        placed.append(
            PlacedCoefficients(coefficients, covariance, FieldAtPlace(home["horizontal_nT"], home["vertical_nT"]))
        )
    away = FieldAtPlace(float(np.mean(field.horizontal_nT)), float(np.mean(field.vertical_nT)))
    return models.transfer_coefficients(placed, away, iron_nT)
