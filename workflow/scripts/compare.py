"""Compare forms of the curve on pairs held out from each: pairs, deviation -> results/MOORING/forms.json."""

from compasslib import archive, assessment
from compasslib.discrepancy import product
from compasslib.job import job

with job(snakemake) as say:
    pairs = archive.read_pairs(snakemake.input.pairs)
    made_by = product.from_json(archive.read_json(snakemake.input.deviation))
    compared = assessment.compare_forms(pairs, made_by.fit)
    archive.write_json(snakemake.output[0], {"forms": compared})
    say(assessment.told_forms(snakemake.wildcards.mooring, compared))
