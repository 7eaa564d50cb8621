"""Write one row a mooring: all results -> results/summary.csv."""

from compasslib.run.job import job
from compasslib.stages import summary

job(snakemake, summary.run)
