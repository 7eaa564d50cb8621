"""Draw one calibration: calibration.json, table.csv, points.csv -> results/calibrations/NAME/figures/*.png."""

from compasslib.pipeline.job import run_job
from compasslib.stages.figures import calibration_figures

run_job(snakemake, calibration_figures)
