"""Diagnose a record given others of its compass: compass.json, pairs -> results/MOORING/{diagnosis,deviation}.json."""

from compasslib.pipeline.job import job
from compasslib.stages.diagnose import share

job(snakemake, share)
