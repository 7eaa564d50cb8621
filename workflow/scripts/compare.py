"""Compare forms of the curve on pairs held out from each: pairs, deviation -> results/MOORING/forms.json."""

from compasslib.archive import netcdf
from compasslib.deviation import assessment
from compasslib.run.job import job
from compasslib.search import product

with job(snakemake) as say:
    pairs = netcdf.read_pairs(snakemake.input.pairs)
    made_by = product.from_json(netcdf.read_json(snakemake.input.deviation))
    compared = assessment.compare_forms(pairs, made_by.fit)
    netcdf.write_json(snakemake.output[0], {"forms": compared})
    say(assessment.told_forms(snakemake.wildcards.mooring, compared))
