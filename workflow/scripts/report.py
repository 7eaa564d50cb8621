"""Write the report: all results -> results/report.html, one page that needs no network."""

from compasslib.pipeline.job import job
from compasslib.stages.report import report

job(snakemake, report)
