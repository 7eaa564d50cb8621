"""Simulate one demonstration mooring: seed -> raw/MOORING/, and truth/MOORING.csv or concealed/MOORING.json."""

from compasslib.pipeline.job import run_job
from compasslib.stages.simulate import simulate

run_job(snakemake, simulate)
