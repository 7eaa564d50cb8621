"""All stages of a mooring or calibration, one after the other: raw files -> results/NAME/."""

from compasslib.pipeline.whole import run_jobs

run_jobs(snakemake)
