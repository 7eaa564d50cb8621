"""Fit the deviation: pairs and the recorded headings -> results/MOORING/work/fit.json."""

from compasslib.pipeline.job import run_job
from compasslib.stages.fit import fit

run_job(snakemake, fit)
