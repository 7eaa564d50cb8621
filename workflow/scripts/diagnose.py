"""Search for unmodelled effects: pairs, fit, record, field -> results/MOORING/{diagnosis,deviation}.json."""

from compasslib.pipeline.job import job
from compasslib.stages import diagnose

job(snakemake, diagnose.run)
