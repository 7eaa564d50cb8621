"""Search one calibration for left-out physics: raw readings -> results/calibrations/NAME/diagnosis.json."""

from compasslib.archive.files import write_json
from compasslib.run.job import job
from compasslib.search import kinds

with job(snakemake) as say:
    options = kinds.chosen(snakemake.params.options)
    found = kinds.diagnose(snakemake.params.kind, snakemake.input.raw, snakemake.params.settings, options)
    write_json(snakemake.output[0], found.to_json())
    say(kinds.told(snakemake.wildcards.calibration, found))
