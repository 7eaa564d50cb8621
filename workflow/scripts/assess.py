"""Assess the correction on pairs held out from the fit: pairs, deviation -> results/MOORING/assessment.json."""

from compasslib import archive, assessment, deviation
from compasslib.job import job

with job(snakemake.log[0]) as say:
    fit = deviation.from_json(archive.read_json(snakemake.input.deviation))
    verdict = assessment.assess(archive.read_pairs(snakemake.input.pairs), fit)
    archive.write_json(snakemake.output[0], verdict)
    say(assessment.told(snakemake.wildcards.mooring, verdict))
