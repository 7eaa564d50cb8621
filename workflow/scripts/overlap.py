"""Find overlapping measurements: records, position -> results/MOORING/{overlap,wide/overlap}.nc, work/field.json."""

from compasslib.pipeline.job import job
from compasslib.stages.overlap import overlap

job(snakemake, overlap)
