"""Draw a calibration's diagnosis: diagnosis.json -> results/calibrations/NAME/figures/diagnosis.png."""

from compasslib.pipeline.job import job
from compasslib.stages.figures import diagnosis_figure

job(snakemake, diagnosis_figure)
