"""Write the report: all results -> results/report.html, one page that needs no network."""

from compasslib.pipeline.job import run_job
from compasslib.stages.report import report

run_job(snakemake, report)
