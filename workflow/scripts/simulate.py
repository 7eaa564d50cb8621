"""Simulate one demonstration mooring: seed -> raw/MOORING/ as its instruments left it, and truth/MOORING.csv."""

from compasslib.run import simulated
from compasslib.run.job import job
from compasslib.simulation import demonstration

with job(snakemake) as say:
    name, truth = snakemake.params.name, snakemake.output.truth
    with simulated.put(name, list(snakemake.output)) as folder:
        demonstration.write_mooring(name, folder / "raw", folder / truth, snakemake.params.seed)
    say(f"{name}: simulated raw files written; the truth stands apart in {truth}")
