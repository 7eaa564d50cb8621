"""Write one row per mooring: all results -> results/summary.csv."""

from compasslib.pipeline.job import job
from compasslib.stages.cruise import summary

job(snakemake, summary)
