"""Assess the correction on pairs held out from the fit: pairs, deviation -> results/MOORING/assessment.json."""

from compasslib.run.job import job
from compasslib.stages import assess

job(snakemake, assess.run)
