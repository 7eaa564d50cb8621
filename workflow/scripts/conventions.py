"""Check the conventions: a mooring's netCDF files -> results/MOORING/conventions.json; a remark is a line and fails."""

from compasslib.archive import conventions
from compasslib.archive.files import write_json
from compasslib.run.job import job

with job(snakemake) as say:
    held = conventions.tell([*snakemake.input.products, *snakemake.input.records], say)
    write_json(snakemake.output[0], held)
