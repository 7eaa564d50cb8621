"""Correct one instrument: record, pairs, deviation, assessment, field -> results/MOORING/corrected.nc."""

from compasslib.pipeline.job import job
from compasslib.stages.correct import correct

job(snakemake, correct)
