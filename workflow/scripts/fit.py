"""Fit the deviation: pairs and the recorded headings -> results/MOORING/deviation.json."""

from compasslib import archive, deviation
from compasslib.job import job

with job(snakemake.log[0]) as say:
    fit = deviation.fit(snakemake.params.method, archive.read_pairs(snakemake.input.pairs))
    record = archive.read_record(snakemake.input.record)
    archive.write_json(snakemake.output[0], deviation.described(fit, record))
    say(deviation.told(snakemake.wildcards.mooring, fit))
