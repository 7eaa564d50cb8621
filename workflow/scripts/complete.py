"""End a run, with status 1 if a mooring or calibration was stopped."""

from compasslib.pipeline.job import job
from compasslib.stages.cruise import complete

job(snakemake, complete)
