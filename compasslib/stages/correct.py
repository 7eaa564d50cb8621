"""Correct one instrument, and grid the corrected and reference velocities of a mooring."""

import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import earthfield
from compasslib.archive import gridded as archive
from compasslib.archive import netcdf, provenance, sites, summary
from compasslib.archive.attributes import Site
from compasslib.archive.files import read_json, write_json
from compasslib.deviation import correction
from compasslib.deviation.assessment import answer_use, build_histograms
from compasslib.deviation.doubts import evaluate_doubts
from compasslib.deviation.model import declination_sigma, reference_compass
from compasslib.inference import covariates
from compasslib.inference import product as products
from compasslib.inference.product import CorrectionModel
from compasslib.preparation.references import combine_references
from compasslib.product.cells import Source, average_angle, compare_at_seam, describe_seam
from compasslib.product.errors import AffectedHeadings, compass_modes, heading_errors
from compasslib.product.grid import GODIN_H, DailyMeans, GridRules, Survey, describe_parking, make_axes, survey
from compasslib.product.grid import grid as make_grid
from compasslib.records import PROBABLY_BAD, CorrectedRecord, EarthField, Pairs
from compasslib.stages import Files, Say, Settings


def correct(
    mooring: str, files: Files, say: Say, *, site: Settings, attributes: Settings, superseded: Settings | None,
    by_hand: Sequence[str],
) -> None:  # fmt: skip
    """Write the corrected record, its assessment with the answer whether it can be used, table and histograms.

    Args:
        superseded: the earlier deposit, as returned by ``deposit.describe_superseded``.
        by_hand: descriptions of the flags that a person gave.
    """
    affected, along = netcdf.read_record(files.record), earthfield.field_from_json(read_json(files.field))
    whole = replace(affected, profiles=netcdf.read_profiles(files.record))
    made_by = products.from_json(read_json(files.deviation))
    series = covariates.logged_series(affected, files.observatory)
    at = products.compass_along_record(made_by, affected, along, series)
    near = combine_references(netcdf.read_pairs(files.pairs))
    made = correction.correct_in_pieces(
        whole, made_by.fit, along, near, at, unmodelled_deg=made_by.left_deg, doubts=made_by.doubts
    )
    sources = netcdf.read_sources([files.record, *files.references, files.pairs])
    processing = provenance.processing(made_by, along, sources, superseded, by_hand)
    netcdf.write_corrected(files.corrected, made, site=Site(**site), attributes=attributes, processing=processing)
    shutil.copyfile(files.pairs, files.overlap)
    summary.write_lookup(files.table, correction.tabulate_deviation(made_by.fit, made_by.left_deg, made_by.doubts))
    judged, written = read_json(files.agreement), netcdf.read_corrected(files.corrected, velocities=False)
    use = answer_use(read_json(files.diagnosis), written.heading_corrected_quality, written.heading_uncertainty_deg)
    write_json(files.assessment, {**judged, "use": use})
    counted = build_histograms(made.record, made.decision.heading_deg, near, judged["difference_counts"])
    summary.write_histograms(files.histograms, counted)
    say(correction.describe_correction(mooring, made))


@dataclass(frozen=True)
class _Affected:
    """An affected instrument and how it was corrected."""

    source: Source
    survey: Survey
    corrected: CorrectedRecord
    made_by: CorrectionModel
    pairs: Pairs
    headings: AffectedHeadings
    doubtful: bool  # whether velocities of flag 3 are used, as there are no better ones


def grid(
    mooring: str, files: Files, say: Say, *, options: Settings, compasses: Sequence[Settings], rotors: Sequence[bool],
    site: Settings, attributes: Settings, superseded: Settings | None, by_hand: Sequence[str],
) -> None:  # fmt: skip
    """Write velocities on fixed depths and times: gridded.nc, and gridded_daily.nc if configured.

    The files of the affected instruments are lists in one order; ``compasses`` and ``rotors`` are of the references.

    Args:
        compasses: arguments of ``reference_compass`` for each reference.
        rotors: whether each reference counts its speed by a mechanical rotor.
        superseded: the earlier deposit, as for ``correct``.
        by_hand: descriptions of the flags that a person gave.
    """
    along, flags = earthfield.field_from_json(read_json(files.fields[0])), tuple(options["flags"])
    names = [Path(path).stem for path in files.references]
    affected = [
        _read_affected(*paths, along, files.observatory, flags, len(names))
        for paths in zip(files.corrected, files.records, files.pairs, files.deviations, strict=True)
    ]
    slowed = [(k, (begin, end)) for part in affected for k, begin, end, _ in part.pairs.slowed]
    spans = [[span for k, span in slowed if k == n and rotor] for n, rotor in enumerate(rotors)]
    each = [
        archive.reference_source(name, path, netcdf.read_record(path, velocities=False), along, flags, where)
        for name, path, where in zip(names, files.references, spans, strict=True)
    ]
    instruments = [*(part.source for part in affected), *each]
    surveys = [*(part.survey for part in affected), *map(survey, each)]
    rules = GridRules(**options["grid"])
    axes, gap_s = make_axes(instruments, surveys, rules), 60.0 * rules.max_gap_minutes
    trusted = [reference_compass(field=along, **keys) for keys in compasses]
    errors = heading_errors([part.headings for part in affected], trusted, axes, gap_s, declination_sigma(along))
    turned = [np.where(part.headings.used, part.corrected.deviation_deg, np.nan) for part in affected]
    turns = [average_angle(x, part.headings.time_s, axes, gap_s) for x, part in zip(turned, affected, strict=True)]
    depth_m = site["water_depth_m"]
    whole = make_grid(instruments, surveys, axes, rules, errors, np.array(turns), water_depth_m=depth_m)
    seams = [
        compare_at_seam(part.pairs, read_json(file)) for part, file in zip(affected, files.assessments, strict=True)
    ]
    before = sum(int(np.isfinite(part.corrected.record.heading_deg).sum()) for part in affected)
    after = sum(int(np.isfinite(part.corrected.heading_corrected_deg).sum()) for part in affected)
    sources = netcdf.read_sources([*files.records, *files.references, *files.pairs])
    made, also = {}, dict[str, Any]()
    for part, seam in zip(affected, seams, strict=True):
        name = part.source.name
        made[name] = provenance.processing(part.made_by, along, sources, superseded, by_hand)
        prefix = f"seam_{name}_" if len(affected) > 1 else "seam_"
        also |= {f"{prefix}{key}": value for key, value in seam.items() if value is not None}
    processing = made[affected[0].source.name]
    for key in ("method", "effects", "coefficients") if len(made) > 1 else ():
        processing = processing | {key: "; ".join(f"{name}: {each[key]}" for name, each in made.items())}
    described = archive.FileDescription(Site(**site), along, attributes, processing, (before, after), also)
    means = [DailyMeans(axes, errors, running_h) for running_h in ((), GODIN_H)] if files.gridded[1:] else []
    counts = archive.write_gridded(files.gridded[0], whole, described, means)
    if means:
        archive.write_daily(files.gridded[1], whole, described, *means)
    for source in instruments:
        if parked := describe_parking(source):
            say(f"{mooring}: {parked}")
    doubtful = [part.source.name for part in affected if part.doubtful]
    only = f"; all of {', '.join(doubtful)} have flag 3" if doubtful else ""
    say(
        f"{mooring}: {len(axes.time_s)} times of {axes.step_s / 60.0:g} minutes, {len(axes.depth_m)} depths from "
        f"{axes.depth_m[0]:g} to {axes.depth_m[-1]:g} m; {counts['filled']} of {counts['cells']} cells have a "
        f"velocity, {counts['interpolated']} of them interpolated{only}"
    )
    for part, seam in zip(affected, seams, strict=True):
        if sentence := describe_seam(seam):
            say(f"{mooring}: {f'{part.source.name}: ' * (len(affected) > 1)}{sentence}")


def join_site(
    site: str, files: Files, say: Say, *, names: Sequence[str], attributes: Settings, compasses: Sequence[str]
) -> None:
    """Join the daily means of the deployments of a site, ``names`` in order of time, as far as they have any.

    Several deployments share each of the ``compasses``.
    """
    paths = {Path(path).parent.name: path for path in files.daily}
    there = {name: paths[name] for name in names if name in paths}
    common = [
        f"deployments share the compass {name}: errors of its coefficients are partly common to them, and a mean over "
        f"all {len(there)} has up to {len(there) ** 0.5:.1f} times the uncertainty that follows from the modes"
        for name in compasses
    ]
    seams = sites.join_daily(files.joined, there, site, attributes, common)
    say("\n".join([f"{site}: daily means of {', '.join(there)} joined", *(f"{site}: {seam}" for seam in seams)]))


def _read_affected(
    corrected: str, record: str, pairs: str, deviation: str, along: EarthField, observatory: Sequence[str],
    flags: tuple[int, ...], references: int,
) -> _Affected:  # fmt: skip
    """Read an affected instrument and the error of its headings; if no velocity has a given flag, those of flag 3."""
    made_by, product = products.from_json(read_json(deviation)), netcdf.read_corrected(corrected, velocities=False)
    recording, name = netcdf.read_record(record, velocities=bool(made_by.applied)), Path(record).stem
    source = archive.affected_source(name, corrected, product, recording, flags)
    surveyed = survey(source)
    doubtful = surveyed.empty and PROBABLY_BAD not in flags
    if doubtful:
        source = archive.affected_source(name, corrected, product, recording, (PROBABLY_BAD,))
        surveyed = survey(source)
        doubtful = not surveyed.empty
    near = netcdf.read_pairs(pairs)
    series = covariates.logged_series(recording, observatory) if made_by.applied else {}
    at = products.compass_along_record(made_by, recording, along, series)
    index = np.zeros(len(near), dtype=int) if near.reference_index is None else near.reference_index
    weights = np.bincount(index, minlength=references)[:references] / max(len(near), 1)
    readings = correction.record_readings(recording)
    trusted = correction.reference_modes(made_by.fit, product.heading_corrected_deg)
    columns = compass_modes(made_by.fit, at, readings, product.heading_corrected_deg)
    headings = AffectedHeadings(
        name=name,
        time_s=product.record.time_s,
        used=np.isin(product.heading_corrected_quality, (PROBABLY_BAD,) if doubtful else flags),
        heading_deg=product.heading_corrected_deg,
        sigma_deg=product.heading_uncertainty_deg,
        probability=product.branch_probability,
        columns_deg=np.column_stack([columns, trusted[:, 1:]]),
        constant_deg=float(np.max(trusted[:, 0], initial=0.0)),
        doubted_deg=evaluate_doubts(made_by.doubts, product.record.time_s)[1],
        unexplained_deg=made_by.left_deg,
        weights=weights * (made_by.fit.method != "calibration"),
    )
    return _Affected(source, surveyed, product, made_by, near, headings, doubtful)
