"""Calibrate a compass apart from any mooring: raw readings -> results/calibrations/NAME/calibration.json and tables."""

from compasslib import calibration
from compasslib.archive import calibrations as archive
from compasslib.archive import provenance
from compasslib.calibration import content
from compasslib.run.job import job

with job(snakemake) as say:
    name, settings = snakemake.wildcards.calibration, calibration.settled(snakemake.params.settings)
    made = calibration.calibrate(snakemake.params.kind, snakemake.input.raw, settings)
    page = content.described(name, made, settings, archive.named(snakemake.input.earlier))
    page |= provenance.stamp(snakemake.input.raw)
    archive.write(page=page, made=made, **snakemake.output)
    say(content.told(page))
