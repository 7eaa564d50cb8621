"""Draw one compass: compass.json -> results/compasses/NAME/figures."""

from compasslib.pipeline.job import job
from compasslib.stages.figures import joined_figures

job(snakemake, joined_figures)
