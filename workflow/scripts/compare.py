"""Compare forms of the deviation curve on held-out pairs: pairs, deviation -> results/MOORING/forms.json."""

from compasslib.pipeline.job import job
from compasslib.stages.correct import compare

job(snakemake, compare)
