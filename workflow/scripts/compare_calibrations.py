"""Compare a calibration with others: work/calibration.json -> calibration.json, table.csv and points.csv."""

from compasslib.pipeline.job import run_job
from compasslib.stages.calibrate import compare_calibrations

run_job(snakemake, compare_calibrations)
