"""Read one instrument: raw files -> results/MOORING/work/ROLE.nc, its record inside the deployment."""

from pathlib import Path

from compasslib import readers
from compasslib.archive import netcdf, provenance
from compasslib.preparation import deployment
from compasslib.run.job import job

with job(snakemake) as say:
    paths = [Path(file) for file in snakemake.input.raw]
    raw = readers.read(snakemake.params.form, paths, snakemake.params.reader)
    record = deployment.settle(raw, **snakemake.params.deployment)
    made = provenance.origin("record read", snakemake.input.raw)
    netcdf.write_record(snakemake.output[0], record, attributes=made)
    say(deployment.log_line(snakemake.wildcards.mooring, snakemake.wildcards.role, record))
