"""Write the manifest with the provenance of all results: job records -> results/ro-crate-metadata.json."""

from compasslib.pipeline.job import run_job
from compasslib.stages.cruise import provenance

run_job(snakemake, provenance)
