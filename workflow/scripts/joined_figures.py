"""Draw one compass: compass.json -> results/compasses/NAME/figures."""

from compasslib.pipeline.job import run_job
from compasslib.stages.figures import joined_figures

run_job(snakemake, joined_figures)
