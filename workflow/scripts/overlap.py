"""Find overlapping measurements: two records, declination -> results/MOORING/{overlap,wide/overlap}.nc."""

from compasslib import archive, earthfield, overlap, provenance
from compasslib.job import job

with job(snakemake) as say:
    upper = archive.read_record(snakemake.input.upper)
    lower = [archive.read_record(path) for path in snakemake.input.lower]
    field = earthfield.from_json(archive.read_json(snakemake.input.field))
    rules = overlap.Rules(**snakemake.params.rules)
    pairs, wide = (overlap.find(upper, lower, field, each) for each in (rules, overlap.widened(rules)))
    made = provenance.origin("pairs found", [snakemake.input.upper, *snakemake.input.lower])
    archive.write_pairs(snakemake.output.pairs, pairs, attributes=made)
    archive.write_pairs(snakemake.output.wide, wide, attributes=made)
    say(overlap.told(snakemake.wildcards.mooring, pairs))
