"""Verify the archive: the files of the cruise -> what differs from its manifest, a line each."""

from compasslib.archive import verification
from compasslib.run.job import job

with job(snakemake) as say:
    verification.tell(".", say)
