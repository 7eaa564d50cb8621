"""Join the records of one compass: summaries, calibrations -> results/compasses/NAME/{compass,diagnosis}.json."""

from compasslib.pipeline.job import job
from compasslib.stages.diagnose import join

job(snakemake, join)
