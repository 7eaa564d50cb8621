"""Correct one instrument: record, pairs, deviation, assessment, field -> results/MOORING/corrected.nc."""

from compasslib.archive import netcdf, provenance
from compasslib.core import earthfield
from compasslib.deviation import correction
from compasslib.run.job import job
from compasslib.search import covariates, product

with job(snakemake) as say:
    record, pairs = netcdf.read_record(snakemake.input.record), netcdf.read_pairs(snakemake.input.pairs)
    field = earthfield.from_json(netcdf.read_json(snakemake.input.field))
    made_by = product.from_json(netcdf.read_json(snakemake.input.deviation))
    at = product.along(made_by, record, field, covariates.logged(record, snakemake.input.observatory))
    refuted = bool(netcdf.read_json(snakemake.input.assessment)["refuted"])
    doubt_deg = correction.doubt(refuted, made_by.left_deg)
    corrected = correction.in_pieces(record, made_by.fit, field, pairs, at, doubt_deg=doubt_deg)
    made = provenance.processing(made_by, field, snakemake.params.sources)
    site, attributes = netcdf.Site(**snakemake.params.site), snakemake.params.attributes
    netcdf.write_corrected(snakemake.output[0], corrected, site=site, attributes=attributes, processing=made)
    say(correction.told(snakemake.wildcards.mooring, corrected))
