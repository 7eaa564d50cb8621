"""Write the manifest: the jobs' records -> results/ro-crate-metadata.json, what was made from what and by what."""

from compasslib.pipeline.job import job
from compasslib.stages.cruise import provenance

job(snakemake, provenance)
