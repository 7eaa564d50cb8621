"""Compare diagnoses with the truth: concealed/*.json, results -> results/concealed.html."""

from compasslib.pipeline.job import run_job
from compasslib.stages.concealed import concealed

run_job(snakemake, concealed)
