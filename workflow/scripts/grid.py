"""Grid the velocities of one mooring: corrected, records, pairs, deviation, field -> results/MOORING/gridded.nc."""

from compasslib.pipeline.job import job
from compasslib.stages.grid import grid

job(snakemake, grid)
