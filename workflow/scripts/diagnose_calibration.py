"""Search one calibration for unmodelled effects: raw readings -> results/calibrations/NAME/diagnosis.json."""

from compasslib.pipeline.job import run_job
from compasslib.stages.diagnose import diagnose_calibration

run_job(snakemake, diagnose_calibration)
