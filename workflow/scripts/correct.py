"""Correct one instrument: record, pairs, diagnosis, field -> results/MOORING/{corrected.nc,assessment.json}."""

from compasslib.pipeline.job import run_job
from compasslib.stages.correct import correct

run_job(snakemake, correct)
