"""Correct one instrument."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from compasslib import earthfield
from compasslib.archive import netcdf, provenance, summary
from compasslib.archive.attributes import Site
from compasslib.archive.files import read_json, write_json
from compasslib.deviation.assessment import answer_use
from compasslib.deviation.correction import correct_in_pieces, describe_correction, tabulate_deviation
from compasslib.deviation.histograms import build_histograms
from compasslib.inference import covariates, product
from compasslib.preparation.references import combine_references


def correct(
    mooring: str,
    *,
    record: str,
    references: Sequence[str],
    pairs: str,
    deviation: str,
    diagnosis: str,
    agreement: str,
    field: str,
    observatory: Sequence[str],
    corrected: str,
    overlap: str,
    assessment: str,
    table: str,
    histograms: str,
    site: Mapping[str, Any],
    attributes: Mapping[str, Any],
    superseded: Mapping[str, Any] | None,
    by_hand: Sequence[str],
    say: Callable[[str], None],
) -> None:
    """Write the corrected record, whether it can be used, the table of its compass, and histograms before and after.

    Args:
        agreement: agreement with the reference, to which the answer is added in ``assessment``.
        superseded: the earlier deposit, as returned by ``deposit.describe_superseded``.
        by_hand: descriptions of the flags that a person gave.

    Raises:
        InputError: an observatory's file cannot be read.
    """
    affected, along = netcdf.read_record(record), earthfield.field_from_json(read_json(field))
    whole = replace(affected, profiles=netcdf.read_profiles(record))
    made_by = product.from_json(read_json(deviation))
    at = product.compass_along_record(made_by, affected, along, covariates.logged_series(affected, observatory))
    near = combine_references(netcdf.read_pairs(pairs))
    made = correct_in_pieces(
        whole, made_by.fit, along, near, at, unmodelled_deg=made_by.left_deg, doubts=made_by.doubts
    )
    sources = netcdf.read_sources([record, *references, pairs])
    processing = provenance.processing(made_by, along, sources, superseded, by_hand)
    netcdf.write_corrected(corrected, made, site=Site(**site), attributes=attributes, processing=processing)
    shutil.copyfile(pairs, overlap)
    summary.write_lookup(table, tabulate_deviation(made_by.fit, made_by.left_deg, made_by.doubts))
    judged, written = read_json(agreement), netcdf.read_corrected(corrected, velocities=False)
    use = answer_use(read_json(diagnosis), written.heading_corrected_quality, written.heading_uncertainty_deg)
    write_json(assessment, {**judged, "use": use})
    counted = build_histograms(made.record, made.decision.heading_deg, near, judged["difference_counts"])
    summary.write_histograms(histograms, counted)
    say(describe_correction(mooring, made))
