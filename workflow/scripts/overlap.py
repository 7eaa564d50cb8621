"""Find overlapping measurements: records, position -> results/MOORING/{overlap,wide/overlap}.nc, work/field.json."""

from compasslib import observatory
from compasslib.archive import netcdf, provenance
from compasslib.core import earthfield
from compasslib.preparation import overlap
from compasslib.run.job import job

with job(snakemake) as say:
    name, out, rules = snakemake.wildcards.mooring, snakemake.output, overlap.Rules(**snakemake.params.rules)
    along = earthfield.along_time(**snakemake.params.place)
    along = observatory.with_observatory(along, snakemake.input.observatory, snakemake.params.place)
    netcdf.write_json(out.field, vars(along))
    say(earthfield.log_line(name, field := earthfield.from_json(netcdf.read_json(out.field))))
    upper, lower = netcdf.read_record(snakemake.input.upper), [netcdf.read_record(x) for x in snakemake.input.lower]
    made = provenance.origin("pairs found", [snakemake.input.upper, *snakemake.input.lower])
    clocks = overlap.clocks(upper, lower, rules)
    for file, each in ((out.wide, overlap.widened(rules)), (out.pairs, rules)):
        netcdf.write_pairs(file, pairs := overlap.find(upper, lower, field, each, clocks), attributes=made)
    say(overlap.log_line(name, pairs))
