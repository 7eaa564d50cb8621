"""Set what was said beside what was planted: concealed/*.json and the results -> results/concealed.html."""

from compasslib.pipeline.job import job
from compasslib.stages.concealed import concealed

job(snakemake, concealed)
