"""Run the stage of a rule: the function of compasslib.stages that its parameter ``stage`` names."""

from compasslib.pipeline.job import run_job

run_job(snakemake)
