"""Write the manifest with the provenance of all results: job records -> results/ro-crate-metadata.json."""

from compasslib.pipeline.job import job
from compasslib.stages.cruise import provenance

job(snakemake, provenance)
