"""Convert a calibration to a mooring's field: calibration.json, field -> results/MOORING/work/fit.json."""

from compasslib.pipeline.job import job
from compasslib.stages.fit import carry

job(snakemake, carry)
