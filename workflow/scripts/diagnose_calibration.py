"""Search one calibration for left-out physics: raw readings -> results/calibrations/NAME/diagnosis.json."""

from compasslib.archive_files import write_json
from compasslib.discrepancy import recordings
from compasslib.job import job

with job(snakemake) as say:
    options = recordings.chosen(snakemake.params.options)
    found = recordings.diagnose(snakemake.params.kind, snakemake.input.raw, snakemake.params.settings, options)
    write_json(snakemake.output[0], found.to_json())
    say(recordings.told(snakemake.wildcards.calibration, found))
