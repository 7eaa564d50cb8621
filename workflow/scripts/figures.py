"""Draw one mooring: pairs, deviation, product -> results/MOORING/figures/*.png."""

from compasslib.pipeline.job import job
from compasslib.stages.figures import figures

job(snakemake, figures)
