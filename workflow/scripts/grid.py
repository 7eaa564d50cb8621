"""Grid the velocities of one mooring: corrected, records, pairs, deviation, field -> results/MOORING/gridded.nc."""

from compasslib.pipeline.job import run_job
from compasslib.stages.grid import grid

run_job(snakemake, grid)
