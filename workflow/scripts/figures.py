"""Draw one mooring: pairs, deviation, product -> results/MOORING/figures/*.png."""

from compasslib.run.job import job
from compasslib.stages import figures

job(snakemake, figures.run)
