"""Search one calibration for unmodelled effects: raw readings -> results/calibrations/NAME/diagnosis.json."""

from compasslib.pipeline.job import job
from compasslib.stages.diagnose import diagnose_calibration

job(snakemake, diagnose_calibration)
