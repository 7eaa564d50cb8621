"""Draw the currents of a mooring with several affected instruments: gridded.nc -> results/MOORING/figures/*.png."""

from compasslib.pipeline.job import run_job
from compasslib.stages.figures import sections

run_job(snakemake, sections)
