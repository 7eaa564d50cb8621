"""Correct one instrument: record, pairs, deviation, assessment, field -> results/MOORING/corrected.nc."""

from compasslib import archive, correction, earthfield, provenance
from compasslib.discrepancy import covariates, product
from compasslib.job import job

with job(snakemake) as say:
    record, pairs = archive.read_record(snakemake.input.record), archive.read_pairs(snakemake.input.pairs)
    field = earthfield.from_json(archive.read_json(snakemake.input.field))
    made_by = product.from_json(archive.read_json(snakemake.input.deviation))
    at = product.along(made_by, record, field, covariates.logged(record, snakemake.input.observatory))
    refuted = bool(archive.read_json(snakemake.input.assessment)["refuted"])
    doubt_deg = correction.doubt(refuted, made_by.left_deg)
    corrected = correction.in_pieces(record, made_by.fit, field, pairs, at, doubt_deg=doubt_deg)
    made = provenance.processing(made_by, field, snakemake.params.sources)
    site, attributes = archive.Site(**snakemake.params.site), snakemake.params.attributes
    archive.write_corrected(snakemake.output[0], corrected, site=site, attributes=attributes, processing=made)
    say(correction.told(snakemake.wildcards.mooring, corrected))
