"""Draw a calibration's diagnosis: diagnosis.json -> results/calibrations/NAME/figures/diagnosis.png."""

from compasslib.run.job import job
from compasslib.stages import diagnosis_figure

job(snakemake, diagnosis_figure.run)
