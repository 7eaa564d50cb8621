"""Search for left-out physics: pairs, fit, record, field -> results/MOORING/{diagnosis,deviation}.json."""

from compasslib import deviation
from compasslib.archive import netcdf
from compasslib.core import earthfield
from compasslib.run.job import job
from compasslib.search import covariates, moored, product

with job(snakemake) as say:
    pairs = netcdf.read_pairs(snakemake.input.pairs)
    # The record by itself is not kept: its velocities are a third of the memory.
    series = covariates.logged(netcdf.read_record(snakemake.input.record), snakemake.input.observatory, at=pairs)
    field = earthfield.from_json(netcdf.read_json(snakemake.input.field))
    configured = netcdf.read_json(snakemake.input.fit)
    fit = deviation.from_json(configured)
    wide = netcdf.read_pairs(snakemake.input.wide)
    found = moored.diagnose(pairs, series, fit, field, wide=wide, **snakemake.params.options)
    netcdf.write_json(snakemake.output.diagnosis, found.to_json())
    netcdf.write_json(snakemake.output.deviation, configured | {"applied": product.of(fit, found).to_json()})
    say(moored.told(snakemake.wildcards.mooring, found))
