"""Draw a calibration's diagnosis: diagnosis.json -> results/calibrations/NAME/figures/diagnosis.png."""

from compasslib.archive.files import read_json
from compasslib.plots import diagnosis_calibration as plots
from compasslib.run.job import job

with job(snakemake) as say:
    plots.diagnosis(snakemake.output[0], read_json(snakemake.input.diagnosis), snakemake.wildcards.calibration)
    say(f"{snakemake.wildcards.calibration}: figure of the diagnosis")
