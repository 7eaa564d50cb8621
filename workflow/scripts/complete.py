"""End a run, with status 1 if a mooring or calibration was stopped."""

from compasslib.pipeline.job import run_job
from compasslib.stages.cruise import complete

run_job(snakemake, complete)
