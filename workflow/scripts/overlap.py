"""Find overlapping measurements: two records and the declination -> results/MOORING/overlap.nc."""

from compasslib import archive, earthfield, overlap
from compasslib.job import job

with job(snakemake.log[0]) as say:
    upper = archive.read_record(snakemake.input.upper)
    lower = [archive.read_record(path) for path in snakemake.input.lower]
    field = earthfield.from_json(archive.read_json(snakemake.input.field))
    rules = overlap.Rules(**snakemake.params.rules)
    pairs = overlap.find(upper, lower, field, rules)
    archive.write_pairs(snakemake.output.pairs, pairs)
    archive.write_pairs(snakemake.output.wide, overlap.find(upper, lower, field, overlap.widened(rules)))
    say(overlap.told(snakemake.wildcards.mooring, pairs))
