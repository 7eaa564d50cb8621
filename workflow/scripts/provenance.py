"""Write the manifest: the jobs' records -> results/ro-crate-metadata.json, what was made from what and by what."""

from compasslib.archive import crate
from compasslib.archive.files import write_json
from compasslib.run.job import job

with job(snakemake) as say:
    jobs = crate.lineage(crate.records(), snakemake.input.products)
    given = {key: snakemake.params[key] for key in ("configuration", "attributes", "stopped")}
    page = crate.crate(jobs, **given)
    write_json(snakemake.output[0], page)
    say(crate.told(page))
