"""Search for left-out physics: pairs, fit, record, field -> results/MOORING/{diagnosis,deviation}.json."""

from compasslib import archive, deviation, earthfield
from compasslib.discrepancy import covariates, moored, product
from compasslib.job import job

with job(snakemake) as say:
    pairs = archive.read_pairs(snakemake.input.pairs)
    # The record by itself is not kept: its velocities are a third of the memory.
    series = covariates.logged(archive.read_record(snakemake.input.record), snakemake.input.observatory, at=pairs)
    field = earthfield.from_json(archive.read_json(snakemake.input.field))
    configured = archive.read_json(snakemake.input.fit)
    fit = deviation.from_json(configured)
    wide = archive.read_pairs(snakemake.input.wide)
    found = moored.diagnose(pairs, series, fit, field, wide=wide, **snakemake.params.options)
    archive.write_json(snakemake.output.diagnosis, found.to_json())
    archive.write_json(snakemake.output.deviation, configured | {"applied": product.of(fit, found).to_json()})
    say(moored.told(snakemake.wildcards.mooring, found))
