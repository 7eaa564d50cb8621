"""Draw one mooring: pairs, deviation, product -> results/MOORING/figures/*.png."""

from compasslib import archive, pictures, plots
from compasslib.discrepancy import product as products
from compasslib.job import job

with job(snakemake) as say:
    name, out = snakemake.wildcards.mooring, snakemake.output
    pairs = archive.read_pairs(snakemake.input.pairs)
    product = archive.read_corrected(snakemake.input.product, velocities=False)
    fit = products.from_json(archive.read_json(snakemake.input.deviation)).fit
    plots.deviation(out.deviation, pairs, fit, name)
    plots.diagnosis(out.diagnosis, archive.read_json(snakemake.input.diagnosis), name)
    plots.histograms(out.histograms, pairs, product, name, method=fit.method)
    plots.scatter(out.scatter, pairs, product, name, method=fit.method)
    plots.timeline(out.timeline, product, pairs, name, method=fit.method)
    pictures.write(out.pictures, out[:-1])
    say(f"{name}: {len(out) - 1} figures")
