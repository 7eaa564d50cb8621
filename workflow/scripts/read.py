"""Read one instrument: raw files -> results/MOORING/work/ROLE.nc, its record inside the deployment."""

from compasslib.pipeline.job import job
from compasslib.stages import read

job(snakemake, read.run)
