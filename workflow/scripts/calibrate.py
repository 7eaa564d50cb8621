"""Calibrate a compass without a mooring: raw readings -> results/calibrations/NAME/calibration.json and tables."""

from compasslib.pipeline.job import job
from compasslib.stages.calibrate import calibrate

job(snakemake, calibrate)
