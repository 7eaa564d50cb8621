"""Draw one calibration: calibration.json, table.csv, points.csv -> results/calibrations/NAME/figures/*.png."""

from compasslib.archive import calibrations as archive
from compasslib.plots import calibrations as plots
from compasslib.run.job import job

with job(snakemake) as say:
    files = ("calibration", "table", "points")
    page = archive.read(**{file: snakemake.input[file] for file in files})
    for figure, path in snakemake.output.items():
        plots.draw(figure, path, page)
    say(f"{snakemake.wildcards.calibration}: {len(snakemake.output)} figures")
