"""Carry a calibration to a mooring: calibration.json and the mooring's field -> results/MOORING/work/fit.json."""

from compasslib import deviation
from compasslib.archive import netcdf
from compasslib.calibration import at_mooring
from compasslib.core import earthfield
from compasslib.run.job import job

with job(snakemake) as say:
    record, pairs = netcdf.read_record(snakemake.input.record), netcdf.read_pairs(snakemake.input.pairs)
    field = earthfield.from_json(netcdf.read_json(snakemake.input.field))
    elsewhere = netcdf.read_json(snakemake.input.calibration)
    fit = at_mooring.carried(elsewhere, field, record, pairs)
    netcdf.write_json(snakemake.output[0], deviation.described(fit, record) | at_mooring.origin(elsewhere, field))
    say(deviation.told(snakemake.wildcards.mooring, fit))
