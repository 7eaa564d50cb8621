"""Simulate one demonstration mooring: seed -> raw/MOORING/ as its instruments left it, and truth/MOORING.csv."""

from compasslib.job import job
from compasslib.nature import demonstration

with job(snakemake) as say:
    name, truth = snakemake.params.name, snakemake.output.truth
    demonstration.write_mooring(name, "raw", truth, snakemake.params.seed)
    say(f"{name}: simulated raw files written; the truth stands apart in {truth}")
