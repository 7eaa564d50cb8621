"""Compare forms of the curve on pairs held out from each: pairs, deviation -> results/MOORING/forms.json."""

from compasslib.pipeline.job import job
from compasslib.stages.correct import compare

job(snakemake, compare)
