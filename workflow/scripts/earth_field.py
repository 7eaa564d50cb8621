"""Compute the earth's field: position and dates -> results/MOORING/work/field.json."""

from compasslib import archive, earthfield
from compasslib.job import job

with job(snakemake) as say:
    field = earthfield.along_time(**snakemake.params.place)
    archive.write_json(snakemake.output[0], vars(field))
    say(earthfield.told(snakemake.wildcards.mooring, field))
