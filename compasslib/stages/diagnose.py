"""Search moorings and calibrations for unmodelled effects, assess corrections, join the records of a compass."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

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
from compasslib.stages import Files, Say, Settings

if TYPE_CHECKING:
    from compasslib.inference.diagnosis import Diagnosis

DISABLED = "the search was switched off (diagnose: {enabled: false})"


def diagnose(
    mooring: str, files: Files, say: Say, *, options: Settings, sphere_distance_m: tuple[float, float] | None
) -> None:
    """Write the ``diagnosis``, the compass that corrects (``deviation``), and the ``agreement`` with the reference.

    For a shared compass the files also name a ``summary`` to write for its other records; or ``joined``, compass.json,
    from which the other records are known, and ``alone``, the same three files of the record by itself.

    Args:
        sphere_distance_m: bounds of the distance from the compass to the iron's centre, where known.
    """
    near = combine_references(netcdf.read_pairs(files.pairs))
    along, configured = earthfield.field_from_json(read_json(files.field)), read_json(files.fit)
    upper = netcdf.read_record(files.record, velocities=False)  # these take a third of the memory
    fitted, siblings, shared = fit_from_json(configured), None, None
    summary, joined = getattr(files, "summary", ""), getattr(files, "joined", "")
    if joined:
        siblings, before = joint.read_returned(read_json(joined), mooring), fitted
        if siblings is None:
            for file, same in zip((files.diagnosis, files.deviation, files.agreement), files.alone, strict=True):
                shutil.copyfile(same, file)
            say(f"{mooring}: no other record is consistent with this one; its own diagnosis is used")
            return
        if before.method != "von_appen":
            fitted = fit_with_siblings(siblings, near, along, upper)
            configured = deviation_json(fitted, upper)
        text = describe_siblings(siblings, before, fitted)
        shared = siblings.block(text)
        say(f"{mooring}: {text}")
    made = _conclude(files, near, upper, along, configured, fitted, {**options, "share": bool(summary)}, siblings)
    corrected, alone = (deviation_json(fit, upper) for fit in (made.product.fit, fit_from_json(configured)))
    origin = {name: value for name, value in configured.items() if name not in alone}  # of a calibration
    content = corrected | {
        "warnings": tuple(dict.fromkeys([*alone["warnings"], *corrected["warnings"]])),
        # Of a folded compass, the headings with one reading are averaged by their probability.
        "averaged": any(member.compass for member in made.product.applied) or made.product.fit.folded,
        "fitted": alone,
        "applied": made.product.to_json(),
        "shared": shared,
        "safe_distance": estimate_safe_distance(made.product.fit, sphere_distance_m),
    }
    write_json(files.diagnosis, made.diagnosis.to_json())
    write_json(files.deviation, origin | content)
    write_json(files.agreement, made.assessment)
    if summary:
        information = made.diagnosis.information or joint.fit_information(fitted)
        place = float(np.mean(along.horizontal_nT)), float(np.mean(along.vertical_nT))
        bare = Member(mooring, "mooring", None, *place, np.zeros(0), np.zeros(0), why=fitted.why)
        known = bare if information is None else replace(bare, **vars(information), why="")
        write_json(summary, known.to_json())
    say(f"{made.diagnosis.log_line(mooring)}\n{describe_assessment(mooring, made.assessment)}")


def _conclude(
    files: Files, near: Pairs, upper: Record, along: EarthField, configured: Settings, fitted: DeviationFit,
    options: Settings, siblings: SiblingInformation | None,
) -> Conclusion:  # fmt: skip
    """Search the pairs of a mooring for effects and conclude, given what other records of the compass tell."""
    series = covariates.logged_series(netcdf.read_record(files.record), files.observatory)
    biases = netcdf.read_applied_declinations((files.record, *files.references))

    def find_constant(fit: DeviationFit) -> ConstantOffset | None:
        if options["constant_confirmed"]:
            return None
        declination_deg = float(np.mean(along.declination_deg))
        return find_declination_error(along) or find_constant_offset(fit, near, declination_deg, biases)

    def search(subset: Pairs, **further: float) -> Diagnosis:
        if not options["enabled"]:
            return diagnoses.insufficient(DISABLED)
        from compasslib.inference.comparison import Options  # half of the job's imports
        from compasslib.inference.kinds.mooring import diagnose

        apart = ("enabled", "constant_confirmed")
        chosen = Options(**{name: value for name, value in options.items() if name not in apart} | further)
        at = np.searchsorted(upper.time_s, subset.time_s)
        logged = {name: column[at] for name, column in series.items()}
        far, shared = combine_references(netcdf.read_pairs(files.wide)), siblings.effects if siblings else None
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
    name: str, files: Files, say: Say, *, spheres: Mapping[str, str | None], min_effect_deg: float
) -> None:
    """Write compass.json (``joined``) and the diagnosis of a compass, by its ``summaries`` and ``calibrations``.

    Args:
        spheres: sphere or frame by name of mooring or calibration, None where not stated.
        min_effect_deg: visible size below which a shared effect is irrelevant.
    """
    moored, calibrated = ([read_json(path) for path in paths] for paths in (files.summaries, files.calibrations))
    records = [joint_compass.mooring_member(m, spheres[m["name"]]) for m in moored]
    records += [joint_compass.calibration_member(c, spheres[c["name"]]) for c in calibrated]
    page, result = joint.join_compass(name, records, min_effect_deg)
    write_json(files.joined, page)
    write_json(files.diagnosis, result.to_json())
    say(joint.log_line(page, result))


def diagnose_calibration(
    name: str, files: Files, say: Say, *, kind: str, settings: Settings, options: Settings
) -> None:
    """Write the diagnosis of a calibration: effects in its readings that its model lacks."""
    result = kinds.diagnose(kind, files.raw, settings, kinds.chosen(options))
    write_json(files.diagnosis, result.to_json())
    say(result.log_line(name))
