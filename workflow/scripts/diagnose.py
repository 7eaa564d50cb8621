"""Search for unmodelled effects: pairs, fit, record, field -> results/MOORING/{diagnosis,deviation}.json."""

from compasslib.pipeline.job import job
from compasslib.stages.diagnose import diagnose

job(snakemake, diagnose)
