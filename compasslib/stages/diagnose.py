"""Search moorings and calibrations for unmodelled effects, assess corrections, join the records of a compass."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from compasslib import earthfield
from compasslib.archive import netcdf
from compasslib.archive.files import read_json, write_json
from compasslib.calibrations import at_mooring
from compasslib.deviation import deviation_json, fit_deviation
from compasslib.deviation.assessment import describe_assessment
from compasslib.deviation.constant import ConstantOffset, find_constant_offset, find_declination_error
from compasslib.deviation.exact import start_from_prior
from compasslib.deviation.model import MIN_PAIRS, DeviationFit, estimate_safe_distance, fit_from_json
from compasslib.inference import covariates, joint, joint_compass, kinds
from compasslib.inference import diagnosis as diagnoses
from compasslib.inference.conclusion import Conclusion, conclude
from compasslib.inference.joint import SiblingInformation
from compasslib.inference.joint_compass import Member
from compasslib.inference.product import CorrectionModel
from compasslib.preparation.references import combine_references
from compasslib.records import EarthField, Pairs, Record

if TYPE_CHECKING:
    from compasslib.inference.diagnosis import Diagnosis

DISABLED = "the search was switched off (diagnose: {enabled: false})"


def diagnose(
    mooring: str,
    *,
    record: str,
    references: Sequence[str],
    pairs: str,
    wide: str,
    fit: str,
    field: str,
    observatory: Sequence[str],
    diagnosis: str,
    deviation: str,
    agreement: str,
    options: Mapping[str, Any],
    sphere_distance_m: tuple[float, float] | None,
    say: Callable[[str], None],
    summary: str = "",
    joined: str = "",
    alone: Sequence[str] = (),
) -> None:
    """Write the diagnosis, the fit with the effects found and applied, and the agreement with the reference.

    Args:
        wide: file of pairs with larger separations, from which the shear of the water is estimated.
        observatory: IAGA-2002 files of one observatory, possibly none.
        sphere_distance_m: bounds of the distance from the compass to the iron's centre, where known.
        summary: file to write for other records of the compass, empty if there are none.
        joined: compass.json, from which the other records of the compass are known; empty if this one is taken alone.
        alone: with ``joined``, the same three files of the record by itself.

    Raises:
        InputError: an observatory's file cannot be read.
    """
    files = diagnosis, deviation, agreement
    near, along = combine_references(netcdf.read_pairs(pairs)), earthfield.field_from_json(read_json(field))
    configured, siblings, text = read_json(fit), None, ""
    fitted = fit_from_json(configured)
    if joined:
        siblings, before = joint.read_returned(read_json(joined), mooring), fitted
        if siblings is None:
            for file, same in zip(files, alone, strict=True):
                shutil.copyfile(same, file)
            say(f"{mooring}: no other record is consistent with this one; its own diagnosis is used")
            return
        if before.method != "von_appen":
            upper = netcdf.read_record(record, velocities=False)
            fitted = fit_with_siblings(siblings, near, along, upper)
            configured = deviation_json(fitted, upper)
        text = describe_siblings(siblings, before, fitted)
        say(f"{mooring}: {text}")
    asked = {**options, "share": bool(summary)}
    made = _conclude(near, along, configured, fitted, (record, references, observatory, wide), asked, siblings)
    shared = siblings.block(text) if siblings else None
    _write(made, configured, record, shared, sphere_distance_m, files)
    if summary:
        information = made.diagnosis.information or joint.fit_information(fitted)
        place = float(np.mean(along.horizontal_nT)), float(np.mean(along.vertical_nT))
        bare = Member(mooring, "mooring", None, *place, np.zeros(0), np.zeros(0), why=fitted.why)
        known = bare if information is None else replace(bare, **vars(information), why="")
        write_json(summary, known.to_json())
    say(f"{made.diagnosis.log_line(mooring)}\n{describe_assessment(mooring, made.assessment)}")


def _conclude(
    near: Pairs,
    along: EarthField,
    configured: Mapping[str, Any],
    fitted: DeviationFit,
    evidence: tuple[str, Sequence[str], Sequence[str], str],
    options: Mapping[str, Any],
    siblings: SiblingInformation | None = None,
) -> Conclusion:
    """Search the pairs of a mooring for effects and conclude.

    Args:
        configured: content of the fit's file.
        evidence: files of record, references, observatory and wide pairs.
        siblings: what other records of the same compass tell.
    """
    record, references, observatory, wide = evidence
    series = covariates.logged_series(netcdf.read_record(record), observatory)
    upper = netcdf.read_record(record, velocities=False)  # these take a third of the memory
    biases = netcdf.read_applied_declinations((record, *references))

    def find_constant(fit: DeviationFit) -> ConstantOffset | None:
        if options["constant_confirmed"]:
            return None
        declination_deg = float(np.mean(along.declination_deg))
        return find_declination_error(along) or find_constant_offset(fit, near, declination_deg, biases)

    def search(subset: Pairs) -> Diagnosis:
        if not options["enabled"]:
            return diagnoses.insufficient(DISABLED)
        from compasslib.inference.comparison import Options  # half of the job's imports
        from compasslib.inference.kinds.mooring import diagnose

        apart = ("enabled", "constant_confirmed")
        chosen = Options(**{name: value for name, value in options.items() if name not in apart})
        at = np.searchsorted(upper.time_s, subset.time_s)
        logged = {name: column[at] for name, column in series.items()}
        far, shared = combine_references(netcdf.read_pairs(wide)), siblings.effects if siblings else None
        return diagnose(subset, logged, fitted, along, chosen, wide=far, units=dict(upper.channel_units), shared=shared)

    def with_effects(made: CorrectionModel, searched: bool) -> CorrectionModel:
        if searched or siblings is None or not (siblings.effects and options["enabled"] and options["apply"]):
            return made
        return joint.apply_shared_effects(made, siblings, along, series)

    return conclude(
        search,
        near,
        upper,
        along,
        series,
        fit=fitted,
        find_constant=find_constant,
        calibration=(configured.get("calibration") or {}).get("name", ""),
        with_effects=with_effects,
    )


def _write(
    made: Conclusion,
    configured: Mapping[str, Any],
    record: str,
    shared: Mapping[str, Any] | None,
    sphere_distance_m: tuple[float, float] | None,
    files: tuple[str, str, str],
) -> None:
    """Write diagnosis, the compass that corrects, the configured fit and the distances of the iron, and assessment."""
    diagnosis, deviation, agreement = files
    upper, product = netcdf.read_record(record, velocities=False), made.product
    corrected, fitted = (deviation_json(fit, upper) for fit in (product.fit, fit_from_json(configured)))
    content = {name: value for name, value in configured.items() if name not in fitted}  # the origin of a calibration
    content |= corrected | {
        "warnings": tuple(dict.fromkeys([*fitted["warnings"], *corrected["warnings"]])),
        "averaged": any(member.compass for member in product.applied),
        "fitted": fitted,
        "applied": product.to_json(),
        "shared": shared,
        "safe_distance": estimate_safe_distance(product.fit, sphere_distance_m),
    }
    write_json(diagnosis, made.diagnosis.to_json())
    write_json(deviation, content)
    write_json(agreement, made.assessment)


def fit_with_siblings(siblings: SiblingInformation, pairs: Pairs, field: EarthField, record: Record) -> DeviationFit:
    """Fit a record's compass with the other records as prior; return the prior where the record determines none."""
    if len(pairs) >= MIN_PAIRS and not siblings.prior.precision[0, 0]:
        return fit_deviation("exact", pairs, start_from_prior(siblings.prior, pairs))
    covariance = np.linalg.inv(siblings.prior.precision)
    warning = (
        f"corrected by the compass of {', '.join(siblings.others)}; iron that changed in between is in the uncertainty"
    )
    known = DeviationFit(at_mooring.METHOD, len(pairs), siblings.prior.mean, covariance, warnings=(warning,))
    return replace(at_mooring.evaluate_on_record(known, record, pairs), prior=siblings.prior)


def describe_siblings(siblings: SiblingInformation, alone: DeviationFit, fitted: DeviationFit) -> str:
    """Describe in a sentence which records determine the compass of a record, and how well."""
    others = ", ".join(siblings.others)
    if not alone.fitted:
        return f"the compass is carried by {others} of compass {siblings.compass}; this record alone determines none"
    if fitted.method == "von_appen":
        return f"{others} of compass {siblings.compass} tell of effects only; the published fit is this record's own"
    alone_s, joint_s = (float(np.sqrt(fit.covariance[1, 1] + fit.covariance[2, 2])) for fit in (alone, fitted))
    known = f"B and C are known to {joint_s:.3f} with {others} of compass {siblings.compass}"
    return f"{known}, to {alone_s:.3f} by this record alone"


def combine_records(
    name: str,
    /,
    *,
    summaries: Sequence[str],
    calibrations: Sequence[str],
    spheres: Mapping[str, str | None],
    min_effect_deg: float,
    joined: str,
    diagnosis: str,
    say: Callable[[str], None],
) -> None:
    """Write compass.json and the diagnosis of the compass.

    Args:
        summaries: summary of each mooring's record, see ``Member.to_json``.
        calibrations: calibration.json of each calibration.
        spheres: sphere or frame by name of mooring or calibration, None where not stated.
        min_effect_deg: visible size below which a shared effect is irrelevant.
    """
    moored, calibrated = ([read_json(path) for path in paths] for paths in (summaries, calibrations))
    records = [joint_compass.mooring_member(m, spheres[m["name"]]) for m in moored]
    records += [joint_compass.calibration_member(c, spheres[c["name"]]) for c in calibrated]
    page, result = joint.join_compass(name, records, min_effect_deg)
    write_json(joined, page)
    write_json(diagnosis, result.to_json())
    say(joint.log_line(page, result))


def diagnose_calibration(
    name: str,
    /,
    *,
    raw: Sequence[str],
    diagnosis: str,
    kind: str,
    settings: Mapping[str, Any],
    options: Mapping[str, Any],
    say: Callable[[str], None],
) -> None:
    """Write the diagnosis of a calibration: effects in its readings that its model lacks.

    Raises:
        InputError: a raw file cannot be read.
    """
    result = kinds.diagnose(kind, raw, settings, kinds.chosen(options))
    write_json(diagnosis, result.to_json())
    say(result.log_line(name))
