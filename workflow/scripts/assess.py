"""Assess the correction on pairs held out from the fit: pairs, deviation -> results/MOORING/assessment.json."""

from compasslib.archive import netcdf
from compasslib.core import earthfield
from compasslib.deviation import assessment
from compasslib.run.job import job
from compasslib.search import covariates, product

with job(snakemake) as say:
    record, pairs = netcdf.read_record(snakemake.input.record), netcdf.read_pairs(snakemake.input.pairs)
    field = earthfield.from_json(netcdf.read_json(snakemake.input.field))
    made_by = product.from_json(netcdf.read_json(snakemake.input.deviation))
    plain = product.plain(made_by, pairs, record, field, covariates.logged(record, snakemake.input.observatory))
    verdict = assessment.assess(pairs, made_by.fit, plain)
    netcdf.write_json(snakemake.output[0], verdict)
    say(assessment.told(snakemake.wildcards.mooring, verdict))
