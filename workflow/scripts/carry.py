"""Carry a calibration to a mooring: calibration.json and the mooring's field -> results/MOORING/work/fit.json."""

from compasslib.pipeline.job import job
from compasslib.stages.fit import carry

job(snakemake, carry)
