"""Carry a calibration to a mooring: calibration.json and the mooring's field -> results/MOORING/work/fit.json."""

from compasslib import archive, deviation, earthfield
from compasslib.calibration import at_mooring
from compasslib.job import job

with job(snakemake) as say:
    record, pairs = archive.read_record(snakemake.input.record), archive.read_pairs(snakemake.input.pairs)
    field = earthfield.from_json(archive.read_json(snakemake.input.field))
    elsewhere = archive.read_json(snakemake.input.calibration)
    fit = at_mooring.carried(elsewhere, field, record, pairs)
    archive.write_json(snakemake.output[0], deviation.described(fit, record) | at_mooring.origin(elsewhere, field))
    say(deviation.told(snakemake.wildcards.mooring, fit))
