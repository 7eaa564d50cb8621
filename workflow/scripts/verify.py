"""Verify the archive: files of the cruise -> differences from its manifest, one line each."""

from compasslib.pipeline.job import job
from compasslib.stages.cruise import verify

job(snakemake, verify)
