"""Verify the archive: the files of the cruise -> what differs from its manifest, a line each."""

from compasslib.pipeline.job import job
from compasslib.stages.cruise import verify

job(snakemake, verify)
