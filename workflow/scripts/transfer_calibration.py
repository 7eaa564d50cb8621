"""Convert a calibration to a mooring's field: calibration.json, field -> results/MOORING/work/fit.json."""

from compasslib.pipeline.job import run_job
from compasslib.stages.fit import transfer_calibration

run_job(snakemake, transfer_calibration)
