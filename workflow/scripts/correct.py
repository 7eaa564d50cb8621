"""Correct one instrument: record, pairs, deviation, field -> results/MOORING/corrected.nc."""

from compasslib import archive, correction, deviation, earthfield, provenance
from compasslib.job import job

with job(snakemake.log[0]) as say:
    record, pairs = archive.read_record(snakemake.input.record), archive.read_pairs(snakemake.input.pairs)
    fit = deviation.from_json(archive.read_json(snakemake.input.deviation))
    field = earthfield.from_json(archive.read_json(snakemake.input.field))
    product = correction.correct(record, fit, field, pairs)
    site, made = archive.Site(**snakemake.params.site), provenance.processing(fit, field, snakemake.params.sources)
    archive.write_corrected(
        snakemake.output[0], product, site=site, attributes=snakemake.params.attributes, processing=made
    )
    say(correction.told(snakemake.wildcards.mooring, product))
