"""Search for unmodelled effects: pairs, fit, record, field -> results/MOORING/{diagnosis,deviation}.json."""

from compasslib.pipeline.job import run_job
from compasslib.stages.diagnose import diagnose

run_job(snakemake, diagnose)
