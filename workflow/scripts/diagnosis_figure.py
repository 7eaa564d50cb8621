"""Draw a calibration's diagnosis: diagnosis.json -> results/calibrations/NAME/figures/diagnosis.png."""

from compasslib.pipeline.job import run_job
from compasslib.stages.figures import diagnosis_figure

run_job(snakemake, diagnosis_figure)
