"""Write the report: all results -> results/report.html, one page that needs no network."""

from compasslib import report
from compasslib.run.job import job

with job(snakemake) as say:
    settings = {key: snakemake.params[key] for key in ("attributes", "moorings", "calibrations", "stopped")}
    page = report.gather("results", **settings)
    report.write(snakemake.output[0], page)
    say(report.told(snakemake.output[0], page))
