"""Check the conventions: netCDF files -> what CF, ACDD and OceanSITES say against them, a line each."""

from compasslib import conventions
from compasslib.job import job

with job(snakemake) as say:
    conventions.tell([*snakemake.input.products, *snakemake.input.records], say)
