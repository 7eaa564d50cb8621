"""Assess the correction on pairs held out from the fit: pairs, deviation -> results/MOORING/assessment.json."""

from compasslib import archive, assessment, earthfield
from compasslib.discrepancy import covariates, product
from compasslib.job import job

with job(snakemake) as say:
    record, pairs = archive.read_record(snakemake.input.record), archive.read_pairs(snakemake.input.pairs)
    field = earthfield.from_json(archive.read_json(snakemake.input.field))
    made_by = product.from_json(archive.read_json(snakemake.input.deviation))
    plain = product.plain(made_by, pairs, record, field, covariates.logged(record, snakemake.input.observatory))
    verdict = assessment.assess(pairs, made_by.fit, plain)
    archive.write_json(snakemake.output[0], verdict)
    say(assessment.told(snakemake.wildcards.mooring, verdict))
