"""Check the conventions: a mooring's netCDF files -> results/MOORING/conventions.json; a remark is a line and fails."""

from compasslib import conventions
from compasslib.archive_files import write_json
from compasslib.job import job

with job(snakemake) as say:
    held = conventions.tell([*snakemake.input.products, *snakemake.input.records], say)
    write_json(snakemake.output[0], held)
