"""Judge a record with what the others tell: compass.json, pairs -> results/MOORING/{diagnosis,deviation}.json."""

from compasslib.pipeline.job import job
from compasslib.stages.diagnose import share

job(snakemake, share)
