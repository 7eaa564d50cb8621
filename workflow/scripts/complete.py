"""End a run: status 1 where a mooring or calibration was stopped."""

from compasslib.pipeline.job import job
from compasslib.stages.cruise import complete

job(snakemake, complete)
