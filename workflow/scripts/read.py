"""Read one instrument: raw files -> results/MOORING/work/ROLE.nc, its record inside the deployment."""

from compasslib.pipeline.job import run_job
from compasslib.stages.read import read

run_job(snakemake, read, always_ends=True)
