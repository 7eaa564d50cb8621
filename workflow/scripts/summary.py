"""Write one row per mooring: all results -> results/summary.csv."""

from compasslib.pipeline.job import run_job
from compasslib.stages.cruise import summary

run_job(snakemake, summary)
