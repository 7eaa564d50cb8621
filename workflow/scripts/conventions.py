"""Check conventions: a mooring's netCDF files -> results/MOORING/conventions.json; any remark fails the job."""

from compasslib.pipeline.job import job
from compasslib.stages.cruise import conventions

job(snakemake, conventions)
