"""Correct one instrument: record, pairs, diagnosis, field -> results/MOORING/{corrected.nc,assessment.json}."""

from compasslib.pipeline.job import job
from compasslib.stages.correct import correct

job(snakemake, correct)
