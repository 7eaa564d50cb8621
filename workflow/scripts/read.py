"""Read one instrument: raw files -> results/MOORING/work/ROLE.nc, its record inside the deployment."""

from compasslib.pipeline.job import job
from compasslib.stages.read import read

job(snakemake, read)
