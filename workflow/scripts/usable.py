"""List what can go on: fields of moorings and calibrations -> results/logs/usable.json, and stopped.json of others."""

from compasslib.pipeline.job import run_job
from compasslib.stages.cruise import usable

run_job(snakemake, usable)
