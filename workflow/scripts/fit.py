"""Fit the deviation: pairs and the recorded headings -> results/MOORING/work/fit.json."""

from compasslib import archive, deviation, earthfield
from compasslib.job import job

with job(snakemake) as say:
    field = earthfield.from_json(archive.read_json(snakemake.input.field))
    pairs = archive.read_pairs(snakemake.input.pairs)
    fit = deviation.fit(snakemake.params.method, pairs, dip_ratio=snakemake.params.tilt * earthfield.dip_ratio(field))
    record = archive.read_record(snakemake.input.record, velocities=False)
    archive.write_json(snakemake.output[0], deviation.described(fit, record))
    say(deviation.told(snakemake.wildcards.mooring, fit))
