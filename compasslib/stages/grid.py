"""Put corrected and reference velocities of a mooring on fixed depths and times."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from compasslib import earthfield
from compasslib.archive import gridded as archive
from compasslib.archive import netcdf, provenance
from compasslib.archive.attributes import Site
from compasslib.archive.files import read_json
from compasslib.deviation.correction import record_readings
from compasslib.deviation.doubts import evaluate_doubts
from compasslib.inference import covariates
from compasslib.inference import product as products
from compasslib.inference.product import Product
from compasslib.product.daily import DailyMeans
from compasslib.product.errors import REFERENCE_SIGMA_DEG, compass_modes, declination_sigma
from compasslib.product.grid import GridRules, average_angle, make_axes, survey
from compasslib.product.grid import grid as make_grid
from compasslib.product.headings import AffectedHeadings, ReferenceCompass, heading_errors
from compasslib.product.seam import compare_at_seam, describe_seam
from compasslib.records import PROBABLY_BAD, CorrectedRecord, EarthField, Pairs, Record
from compasslib.types import Floats


def grid(
    mooring: str,
    *,
    corrected: str,
    record: str,
    references: Sequence[str],
    pairs: str,
    deviation: str,
    assessment: str,
    field: str,
    observatory: Sequence[str],
    gridded: Sequence[str],
    options: Mapping[str, Any],
    names: Sequence[str],
    compasses: Sequence[Mapping[str, Any]],
    site: Mapping[str, Any],
    attributes: Mapping[str, Any],
    sources: Sequence[str],
    say: Callable[[str], None],
) -> None:
    """Write velocities on fixed depths and times.

    Args:
        gridded: gridded.nc, and gridded_daily.nc where it is asked for.
        references: records of the reference instruments, perhaps none.
        options: of the mooring's product.
        names: of the affected instrument and the references.
        compasses: ``sigma_deg``, a number or None, and ``magnetic`` of each reference.
        attributes: of the archive, by the YAML files.
        sources: raw files, relative to the cruise folder.

    Raises:
        InputError: an observatory's file cannot be read.
    """
    along, made_by = earthfield.field_from_json(read_json(field)), products.from_json(read_json(deviation))
    product = netcdf.read_corrected(corrected, velocities=False)
    recording = netcdf.read_record(record, velocities=bool(made_by.applied))
    flags = tuple(options["flags"])
    affected = archive.affected_source(names[0], corrected, product, recording, flags)
    surveyed = survey(affected)
    doubtful = surveyed.empty and PROBABLY_BAD not in flags
    if doubtful:
        affected = archive.affected_source(names[0], corrected, product, recording, (PROBABLY_BAD,))
        surveyed = survey(affected)
        doubtful = not surveyed.empty
    each = [
        archive.reference_source(name, path, netcdf.read_record(path, velocities=False), along, flags)
        for name, path in zip(names[1:], references, strict=True)
    ]
    surveys = [surveyed, *map(survey, each)]
    rules = GridRules(**options["grid"])
    axes = make_axes([affected, *each], surveys, rules)
    near, gap_s = netcdf.read_pairs(pairs), 60.0 * rules.max_gap_minutes
    used = (PROBABLY_BAD,) if doubtful else flags
    headings = _affected_headings(product, made_by, near, recording, along, observatory, used)
    trusted = _reference_compasses(names[1:], compasses, near, declination_sigma(along))
    errors = heading_errors(headings, trusted, axes, gap_s, declination_sigma(along))
    turned = np.where(headings.used, product.deviation_deg, np.nan)
    whole = make_grid(
        [affected, *each], surveys, axes, rules, errors,
        average_angle(turned, product.record.time_s, axes, gap_s),
        water_depth_m=site["water_depth_m"],
    )  # fmt: skip
    seam = compare_at_seam(near, read_json(assessment))
    recorded, right = (int(np.isfinite(x).sum()) for x in (product.record.heading_deg, product.heading_corrected_deg))
    described = archive.FileDescription(
        Site(**site), along, attributes, provenance.processing(made_by, along, sources), (recorded, right),
        also={f"seam_{key}": value for key, value in seam.items() if value is not None},
    )  # fmt: skip
    means = DailyMeans(axes, errors) if gridded[1:] else None
    counts = archive.write_gridded(gridded[0], whole, described, means)
    if means is not None:
        archive.write_daily(gridded[1], whole, described, means)
    say(
        f"{mooring}: {len(axes.time_s)} times of {axes.step_s / 60.0:g} minutes, {len(axes.depth_m)} depths from "
        f"{axes.depth_m[0]:g} to {axes.depth_m[-1]:g} m; {counts['filled']} of {counts['cells']} cells have a "
        f"velocity, {counts['interpolated']} of them interpolated{'; all of flag 3' * doubtful}"
    )
    if sentence := describe_seam(seam):
        say(f"{mooring}: {sentence}")


def _affected_headings(
    product: CorrectedRecord, made_by: Product, pairs: Pairs, recording: Record, along: EarthField,
    observatory: Sequence[str], flags: Sequence[int],
) -> AffectedHeadings:  # fmt: skip
    """Collect the corrected headings and the parts of their error."""
    series = covariates.logged_series(recording, observatory) if made_by.applied else {}
    at = products.compass_along_record(made_by, recording, along, series)
    time_s = product.record.time_s
    columns = compass_modes(made_by.fit, at, record_readings(recording), product.heading_corrected_deg)
    return AffectedHeadings(
        time_s=time_s,
        used=np.isin(product.heading_corrected_quality, flags),
        heading_deg=product.heading_corrected_deg,
        sigma_deg=product.heading_uncertainty_deg,
        probability=product.branch_probability,
        columns_deg=columns,
        doubted_deg=evaluate_doubts(made_by.doubts, time_s)[1],
        unexplained_deg=made_by.left_deg,
        veer_deg=pairs.veer_deg if made_by.fit.method == "von_appen" else 0.0,
        of_pairs=made_by.fit.method != "calibration" and len(pairs) > 0,
    )


def _reference_compasses(
    names: Sequence[str], compasses: Sequence[Mapping[str, Any]], pairs: Pairs, declination_deg: float
) -> list[ReferenceCompass]:
    """Return the references' compasses, each with its share of the pairs.

    Directions that were true already were turned by somebody else, with another declination.
    """
    index = np.zeros(len(pairs), dtype=int) if pairs.reference_index is None else pairs.reference_index
    counts: Floats = np.bincount(index, minlength=max(len(names), 1)).astype(float)
    shares = counts / max(counts.sum(), 1.0)
    usual = {True: REFERENCE_SIGMA_DEG, False: float(np.hypot(REFERENCE_SIGMA_DEG, declination_deg))}
    return [
        ReferenceCompass(
            name,
            usual[given["magnetic"]] if given["sigma_deg"] is None else given["sigma_deg"],
            given["magnetic"],
            float(share),
        )
        for name, given, share in zip(names, compasses, shares, strict=False)
    ]
