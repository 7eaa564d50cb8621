"""Draw one mooring: pairs, deviation, product -> results/MOORING/figures/*.png."""

from compasslib.pipeline.job import run_job
from compasslib.stages.figures import figures

run_job(snakemake, figures)
