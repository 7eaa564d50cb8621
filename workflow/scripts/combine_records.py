"""Join the records of one compass: summaries, calibrations -> results/compasses/NAME/{compass,diagnosis}.json."""

from compasslib.pipeline.job import run_job
from compasslib.stages.diagnose import combine_records

run_job(snakemake, combine_records)
