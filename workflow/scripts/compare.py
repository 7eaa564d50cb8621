"""Compare forms of the deviation curve on held-out pairs: pairs, deviation -> results/MOORING/forms.json."""

from compasslib.pipeline.job import run_job
from compasslib.stages.correct import compare

run_job(snakemake, compare)
