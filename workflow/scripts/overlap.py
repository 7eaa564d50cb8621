"""Find overlapping measurements: records, position -> results/MOORING/{overlap,wide/overlap}.nc, work/field.json."""

from compasslib.pipeline.job import run_job
from compasslib.stages.overlap import overlap

run_job(snakemake, overlap, always_ends=True)
