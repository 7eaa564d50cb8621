"""Fit the deviation: pairs and the recorded headings -> results/MOORING/work/fit.json."""

from compasslib.pipeline.job import job
from compasslib.stages.fit import fit

job(snakemake, fit)
