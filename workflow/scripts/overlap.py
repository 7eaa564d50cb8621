"""Find overlapping measurements: two records and the declination -> results/MOORING/overlap.nc."""

from compasslib import archive, earthfield, overlap, provenance
from compasslib.job import job

with job(snakemake) as say:
    upper = archive.read_record(snakemake.input.upper)
    lower = [archive.read_record(path) for path in snakemake.input.lower]
    field = earthfield.from_json(archive.read_json(snakemake.input.field))
    pairs = overlap.find(upper, lower, field, overlap.Rules(**snakemake.params.rules))
    made = provenance.origin("pairs found", [snakemake.input.upper, *snakemake.input.lower])
    archive.write_pairs(snakemake.output[0], pairs, attributes=made)
    say(overlap.told(snakemake.wildcards.mooring, pairs))
