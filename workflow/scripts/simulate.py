"""Simulate one demonstration mooring: seed -> raw/MOORING/ as its instruments left it, and truth/MOORING.csv."""

from compasslib.pipeline.job import job
from compasslib.stages.simulate import simulate

job(snakemake, simulate)
