"""Draw one mooring: pairs, deviation, product -> results/MOORING/figures/*.png."""

from compasslib.archive import netcdf, pictures
from compasslib.plots import agreement, deviation, diagnosis, timeline
from compasslib.run.job import job
from compasslib.search import product as products

with job(snakemake) as say:
    name, out = snakemake.wildcards.mooring, snakemake.output
    pairs = netcdf.read_pairs(snakemake.input.pairs)
    product = netcdf.read_corrected(snakemake.input.product, velocities=False)
    fit = products.from_json(netcdf.read_json(snakemake.input.deviation)).fit
    deviation.deviation(out.deviation, pairs, fit, name)
    diagnosis.diagnosis(out.diagnosis, netcdf.read_json(snakemake.input.diagnosis), name)
    agreement.histograms(out.histograms, pairs, product, name, method=fit.method)
    agreement.scatter(out.scatter, pairs, product, name, method=fit.method)
    timeline.timeline(out.timeline, product, pairs, name, method=fit.method)
    pictures.write(out.pictures, out[:-1])
    say(f"{name}: {len(out) - 1} figures")
