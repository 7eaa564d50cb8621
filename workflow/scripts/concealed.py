"""Compare diagnoses with the truth: concealed/*.json, results -> results/concealed.html."""

from compasslib.pipeline.job import job
from compasslib.stages.concealed import concealed

job(snakemake, concealed)
