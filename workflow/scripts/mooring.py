"""Run all stages of a mooring or calibration: raw files -> results/NAME/."""

from compasslib.pipeline.whole import run_jobs

run_jobs(snakemake)
