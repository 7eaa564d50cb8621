"""Diagnose a record given others of its compass: compass.json, pairs -> results/MOORING/{diagnosis,deviation}.json."""

from compasslib.pipeline.job import run_job
from compasslib.stages.diagnose import diagnose_jointly

run_job(snakemake, diagnose_jointly)
