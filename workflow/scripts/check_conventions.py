"""Check conventions: a mooring's netCDF files -> results/MOORING/conventions.json; any remark fails the job."""

from compasslib.pipeline.job import run_job
from compasslib.stages.cruise import conventions

run_job(snakemake, conventions)
