"""Check the conventions: a mooring's netCDF files -> results/MOORING/conventions.json; a remark is a line and fails."""

from compasslib.pipeline.job import job
from compasslib.stages.cruise import conventions

job(snakemake, conventions)
