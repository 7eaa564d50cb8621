"""Fit the deviation: pairs and the recorded headings -> results/MOORING/work/fit.json."""

from compasslib import deviation
from compasslib.archive import netcdf
from compasslib.core import earthfield
from compasslib.run.job import job

with job(snakemake) as say:
    field = earthfield.from_json(netcdf.read_json(snakemake.input.field))
    pairs = netcdf.read_pairs(snakemake.input.pairs)
    fit = deviation.fit(snakemake.params.method, pairs, dip_ratio=snakemake.params.tilt * earthfield.dip_ratio(field))
    record = netcdf.read_record(snakemake.input.record, velocities=False)
    netcdf.write_json(snakemake.output[0], deviation.described(fit, record))
    say(deviation.told(snakemake.wildcards.mooring, fit))
