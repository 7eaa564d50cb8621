"""Write one row a mooring: all results -> results/summary.csv."""

from compasslib.archive import summary
from compasslib.run.job import job

with job(snakemake) as say:
    rows = [summary.row(name, f"results/{name}", roles) for name, roles in snakemake.params.roles.items()]
    rows += [summary.row_of_stopped(name, why) for name, why in snakemake.params.stopped["moorings"].items()]
    rows.sort(key=lambda row: snakemake.params.order.index(row["name"]))
    summary.write(snakemake.output[0], rows)
    say(summary.table(rows))
