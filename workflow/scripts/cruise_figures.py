"""Draw figures of all moorings: deviation.json and assessment.json of each -> results/figures."""

from compasslib.pipeline.job import run_job
from compasslib.stages.figures import cruise_figures

run_job(snakemake, cruise_figures)
