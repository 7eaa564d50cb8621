"""Calibrate a compass without a mooring: raw readings -> results/calibrations/NAME/calibration.json and tables."""

from compasslib.pipeline.job import run_job
from compasslib.stages.calibrate import calibrate

run_job(snakemake, calibrate, always_ends=True)
